"""What effects on steering, pedals and forces do to a signal and to the car."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.effects.shared import EFFECTS, KINDS, SCALAR, START, STRONG, through, weave
from tests.plant.drives import DT_S, car, command, drive, rest_of
from tunefree_hil.base.contracts import BodyChange, Effect, make_effect
from tunefree_hil.base.course import Start
from tunefree_hil.base.kernel import run
from tunefree_hil.base.units import G_MPS2


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


@pytest.mark.parametrize("name", ["powertrain_lag", "brake_pressure_lag"])
def test_a_lag_of_the_car_lets_a_ramp_come_exactly_its_time_later(name: str) -> None:
    effect = EFFECTS[name]
    rest = rest_of(effect.port)
    ramp = [rest + 0.1 * DT_S * k for k in range(300)]
    out = run(make_effect(effect, {"tau_s": 0.1}, rest=rest), ramp, DT_S)
    assert out[-1] == pytest.approx(ramp[-1] - 0.1 * 0.1, abs=1e-9)


@given(st.floats(1e-9, 2.0), st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=40))
def test_a_lag_of_the_car_stays_between_the_values_it_has_seen(tau_s: float, values: list[float]) -> None:
    out = run(make_effect(EFFECTS["powertrain_lag"], {"tau_s": tau_s}), values, DT_S)
    assert min(0.0, *values) - 1e-12 <= min(out) and max(out) <= max(0.0, *values) + 1e-12


def test_effects_begin_at_rest() -> None:
    for name in SCALAR:
        if name != "steer_offset":
            rest = rest_of(EFFECTS[name].port)
            assert set(run(make_effect(EFFECTS[name], STRONG[name], rest=rest), [rest] * 30, DT_S)) == {rest}


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


def test_a_rate_limit_is_a_ramp_and_then_the_input() -> None:
    out = through("steer_rate_limit", {"rate_radps": 10.0}, [0.35] * 5 + [0.0] * 5)
    assert out == pytest.approx([0.1, 0.2, 0.3, 0.35, 0.35, 0.25, 0.15, 0.05, 0.0, 0.0])


def test_dead_bands_lose_their_half_width_and_do_not_rescale() -> None:
    out = through("steer_dead_band", {"half_width_rad": 0.1}, [0.05, 0.3, -0.05, -0.3])
    assert out == pytest.approx([0.0, 0.2, 0.0, -0.2])
    for name in ("throttle_dead_band", "brake_dead_band"):
        out = through(name, {"half_width_frac": 0.03}, [0.15, 0.17, 0.18, 0.25], rest=0.15)
        assert out == pytest.approx([0.15, 0.15, 0.15, 0.22])


def test_pedal_gains_act_about_rest() -> None:
    for name in ("throttle_gain", "brake_gain"):
        assert through(name, {"gain_frac": 0.5}, [0.15, 0.35], rest=0.15) == pytest.approx([0.15, 0.25])


def test_backlash_is_its_whole_width_at_a_reversal_and_friction_its_level_each_way() -> None:
    up_and_down = [0.1 * k for k in range(11)] + [1.0 - 0.1 * k for k in range(1, 11)]
    for name, params in (("steer_backlash", {"width_rad": 0.4}), ("steer_friction", {"level_rad": 0.2})):
        out = through(name, params, up_and_down)
        assert out[1] == 0.0 and out[10] == pytest.approx(0.8)
        assert out[14] == pytest.approx(0.8) and out[15] == pytest.approx(0.7)


def test_saturation_holds_both_sides() -> None:
    assert through("steer_saturation", {"limit_rad": 2.0}, [1.0, 3.0, -3.0]) == [1.0, 2.0, -2.0]


@given(st.lists(st.floats(-10.0, 10.0), max_size=40), st.floats(0.01, 2.0))
def test_play_never_leaves_its_width(values: list[float], width: float) -> None:
    out = through("steer_backlash", {"width_rad": width}, values)
    assert all(abs(y - x) <= 0.5 * width + 1e-12 for x, y in zip(values, out, strict=True))


@pytest.mark.parametrize("kind", KINDS)
def test_power_limit_caps_force_times_speed(kind: str) -> None:
    def gained(effects: tuple[tuple[Effect, dict[str, float]], ...], speed_mps: float) -> float:
        outputs = drive(car(kind, effects=effects), lambda t: command(0.45), 1.0, start=Start(speed_mps=speed_mps))
        return outputs[-1].motion.speed_mps - outputs[0].motion.speed_mps

    limit = ((EFFECTS["power_limit"], {"power_w": 15e3}),)
    assert gained(limit, 12.0) < 0.7 * gained((), 12.0)
    assert gained(limit, 0.5) == pytest.approx(gained((), 0.5), rel=0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_brakes_fade_with_what_they_have_dissipated(kind: str) -> None:
    def braking(effects: tuple[tuple[Effect, dict[str, float]], ...]) -> list[float]:
        outputs = drive(car(kind, effects=effects), lambda t: command(brake=0.28), 2.0, start=Start(speed_mps=20.0))
        return [out.motion.speed_rate_mps2 for out in outputs]

    cold, fading = braking(()), braking(((EFFECTS["brake_fade"], {"loss_per_mj": 4.0}),))
    assert fading[20] == pytest.approx(cold[20], rel=0.3)
    assert fading[-1] > 0.7 * cold[-1]  # both negative: there is less of it
    spent = braking(((EFFECTS["brake_fade"], {"loss_per_mj": 1e6}),))
    assert spent[-1] < 0.25 * cold[-1] < 0.0  # the floor: 0.3 of the gain stays


@pytest.mark.parametrize("kind", KINDS)
def test_brake_drag_is_a_force_against_the_motion_only(kind: str) -> None:
    def end(effects: tuple[tuple[Effect, dict[str, float]], ...], start: Start) -> float:
        return drive(car(kind, effects=effects), lambda t: command(brake=0.2), 1.0, start=start)[-1].motion.speed_mps

    drag = ((EFFECTS["brake_drag"], {"force_n": 500.0}),)
    mass = car(kind).block.params.chassis.constants.mass_kg
    assert end((), START) - end(drag, START) == pytest.approx(500.0 / mass, rel=0.05)
    assert end(drag, Start(speed_mps=0.0)) >= 0.0
