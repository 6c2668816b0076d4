"""Every effect keeps the contract (interfaces 4), and does to the car what it says."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.plant.drives import DT_S, PLANTS, REST, car, command, drive
from tunefree_hil.base import parts
from tunefree_hil.base.contracts import BodyChange, Effect, Port, make_effect
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import run
from tunefree_hil.base.units import G_MPS2

EFFECTS: dict[str, Effect] = {
    name: parts.load("tunefree_hil.effects", name, "EFFECT") for name in parts.names("tunefree_hil.effects")
}
KINDS = sorted(PLANTS)
START = Start(speed_mps=9.0)
STRONG: dict[str, dict[str, float]] = {
    "steer_dead_time": {"delay_s": 0.08},
    "steer_lag": {"tau_s": 0.15},
    "steer_gain": {"gain_frac": 0.8},
    "payload": {"mass_kg": 400.0, "ahead_m": -1.0},
    "friction": {"friction_frac": 0.3},
    "grade": {"grade_rad": 0.05},
}
SCALAR = [name for name, effect in EFFECTS.items() if effect.port not in (Port.BODY, Port.REPORT, Port.INS)]


def weave(t: float) -> Any:
    return command(0.3 if t < 1.0 else REST, REST if t < 1.0 else 0.26, 4.0 * math.sin(3.0 * t))


def test_the_tests_know_every_effect() -> None:
    assert set(STRONG) == set(EFFECTS)


@pytest.mark.parametrize("name", EFFECTS)
def test_contract(name: str) -> None:
    effect = EFFECTS[name]
    assert isinstance(effect, Effect) and effect.symptom
    assert set(effect.units) == set(effect.neutral) and effect.neutral
    assert all(key.endswith(("_s", "_frac", "_kg", "_m", "_rad")) for key in effect.neutral)
    with pytest.raises(InputError) as caught:
        make_effect(effect, {"wrong": 1.0}, name=name)
    assert name in str(caught.value) and next(iter(effect.neutral)) in caught.value.hint


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", EFFECTS)
def test_neutral_is_the_identity_bit_for_bit(kind: str, name: str) -> None:
    without = drive(car(kind), weave, 1.6, start=START)
    effect = EFFECTS[name]
    for neutral in ({}, dict(effect.neutral)):
        with_it = drive(car(kind, effects=((effect, neutral),)), weave, 1.6, start=START)
        assert [out.motion for out in with_it] == [out.motion for out in without]
        assert [out.actuation for out in with_it] == [out.actuation for out in without]


@pytest.mark.parametrize("name", SCALAR)
@given(st.lists(st.floats(-10.0, 10.0), max_size=40), st.sampled_from([0.0, 0.15]))
def test_neutral_passes_any_signal(name: str, values: list[float], rest: float) -> None:
    assert run(make_effect(EFFECTS[name], {}, rest=rest), values, DT_S) == values


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_shows_where_its_port_says(kind: str, name: str) -> None:
    """Port A in the report; B and BODY in the motion only."""
    without = drive(car(kind), weave, 1.6, start=START)
    with_it = drive(car(kind, effects=((EFFECTS[name], STRONG[name]),)), weave, 1.6, start=START)
    assert with_it[-1].motion != without[-1].motion
    same = [out.actuation for out in with_it] == [out.actuation for out in without]
    assert same is not EFFECTS[name].port.value.endswith(" A")


def test_dead_time_shifts_also_by_parts_of_a_tick() -> None:
    ramp = [0.1 * k for k in range(30)]
    out = run(make_effect(EFFECTS["steer_dead_time"], {"delay_s": 0.034}), ramp, DT_S)
    assert out[10] == pytest.approx(0.1 * (10 - 3.4)) and out[2] == 0.0
    exact = run(make_effect(EFFECTS["steer_dead_time"], {"delay_s": 0.03}), ramp, DT_S)
    assert exact == [0.0] * 3 + ramp[:27]


def test_dead_times_add_up() -> None:
    effect = EFFECTS["steer_dead_time"]
    once = drive(car("physics", effects=((effect, {"delay_s": 0.05}),)), weave, 1.0, start=START)
    twice = drive(
        car("physics", effects=((effect, {"delay_s": 0.02}), (effect, {"delay_s": 0.03}))), weave, 1.0, start=START
    )
    assert [out.motion for out in twice] == [out.motion for out in once]


def test_lag_is_first_order() -> None:
    out = run(make_effect(EFFECTS["steer_lag"], {"tau_s": 0.1}), [1.0] * 30, DT_S)
    assert out == pytest.approx([1.0 - math.exp(-0.1 * (k + 1)) for k in range(30)])


def test_effects_begin_at_rest() -> None:
    for name, params in (("steer_lag", {"tau_s": 0.1}), ("steer_dead_time", {"delay_s": 0.055})):
        assert set(run(make_effect(EFFECTS[name], params, rest=0.15), [0.15] * 30, DT_S)) == {0.15}


@pytest.mark.parametrize("kind", KINDS)
def test_gain_turns_less(kind: str) -> None:
    def turned(effects: tuple[tuple[Effect, dict[str, float]], ...]) -> float:
        return drive(car(kind, effects=effects), lambda t: command(steer=0.6), 2.0, start=START)[-1].motion.heading_rad

    assert turned(((EFFECTS["steer_gain"], {"gain_frac": 0.8}),)) == pytest.approx(0.8 * turned(()), rel=0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_payload_brakes_longer(kind: str) -> None:
    def braked(effects: tuple[tuple[Effect, dict[str, float]], ...]) -> float:
        return drive(car(kind, effects=effects), lambda t: command(brake=0.27), 0.8, start=START)[
            -1
        ].motion.speed_rate_mps2

    mass = car(kind).block.params.chassis.constants.mass_kg
    loaded = braked(((EFFECTS["payload"], {"mass_kg": 500.0}),))
    assert loaded == pytest.approx(braked(()) * mass / (mass + 500.0), rel=0.03)


def test_two_payloads_are_two_masses() -> None:
    change = BodyChange()
    for mass_kg, ahead_m in ((100.0, 1.0), (50.0, -2.0)):
        change = make_effect(EFFECTS["payload"], {"mass_kg": mass_kg, "ahead_m": ahead_m})(change)
    assert change[:3] == (150.0, 0.0, 300.0)


@pytest.mark.parametrize("kind", KINDS)
def test_grade_is_a_slope(kind: str) -> None:
    def speed(effects: tuple[tuple[Effect, dict[str, float]], ...]) -> float:
        return drive(car(kind, effects=effects), lambda t: command(), 1.0, start=START)[-1].motion.speed_mps

    slowed = speed(()) - speed(((EFFECTS["grade"], {"grade_rad": 0.05}),))
    assert slowed == pytest.approx(G_MPS2 * math.sin(0.05), rel=0.05)


@pytest.mark.parametrize("kind", KINDS)
def test_friction_caps_the_turn(kind: str) -> None:
    def most(effects: tuple[tuple[Effect, dict[str, float]], ...]) -> float:
        outputs = drive(car(kind, effects=effects), lambda t: command(steer=7.0), 1.5, start=START)
        return max(abs(out.motion.lateral_accel_mps2) for out in outputs)

    assert most(((EFFECTS["friction"], {"friction_frac": 0.3}),)) < 0.35 * G_MPS2 < 0.6 * G_MPS2 < most(())


@pytest.mark.parametrize(
    ("name", "params"),
    [
        ("steer_dead_time", {"delay_s": -0.1}),
        ("steer_lag", {"tau_s": math.inf}),
        ("steer_gain", {"gain_frac": 0.0}),
        ("friction", {"friction_frac": math.nan}),
        ("grade", {"grade_rad": 2.0}),
    ],
)
def test_impossible_values(name: str, params: dict[str, float]) -> None:
    with pytest.raises(InputError) as caught:
        make_effect(EFFECTS[name], params)
    assert caught.value.key in params
