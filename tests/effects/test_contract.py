"""Every effect keeps the contract (docs/reference/effects.md): complete, neutral when it is, seen where its port
says."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.effects.shared import (
    EFFECTS,
    FORCES,
    KINDS,
    SCALAR,
    SIZES,
    driven,
    fixes,
    motions,
    reports,
    same,
    strong,
)
from tests.plant.drives import DT_S, REST, command
from tunefree_hil.base.contracts import (
    QUANTITIES,
    Block,
    BodyChange,
    Effect,
    Link,
    Port,
    Prior,
    links_of,
    make_effect,
    place_of,
    prior_of,
)
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import run
from tunefree_hil.base.records import Command
from tunefree_hil.plant.measurement.sensors import noise_table

NAMES = list(EFFECTS)
UNITS = {"_s": "s", "_frac": "1", "_kg": "kg", "_m": "m", "_m2": "m2", "_rad": "rad", "_radps": "rad/s",
         "_per_s": "1/s", "_n": "N", "_w": "W", "_per_mj": "1/MJ", "_mps": "m/s", "_mps2": "m/s2"}  # fmt: skip
NEXT = list(zip(NAMES, [*NAMES[1:], NAMES[0]], strict=True))


def rough(t: float) -> Command:
    """Hard driving: what any effect of a usual size changes."""
    return command(0.7 if t < 1.0 else REST, REST if t < 1.2 else 0.3, 6.0 * math.sin(4.0 * t))


def typical(name: str) -> dict[str, float]:
    return {key: prior_of(EFFECTS[name], key, SIZES).typical for key in EFFECTS[name].neutral}


@pytest.mark.parametrize("name", NAMES)
def test_what_a_bench_needs(name: str) -> None:
    effect = EFFECTS[name]
    assert isinstance(effect, Effect)
    assert set(effect.units) == set(effect.neutral) and effect.neutral
    for key, unit in effect.units.items():
        assert unit == UNITS[max((end for end in UNITS if key.endswith(end)), key=len)]
    with pytest.raises(InputError) as caught:
        make_effect(effect, {"wrong": 1.0}, name=name)
    assert name in str(caught.value) and next(iter(effect.neutral)) in caught.value.hint


@pytest.mark.parametrize("name", NAMES)
def test_what_a_search_needs(name: str) -> None:
    effect = EFFECTS[name]
    assert min(len(effect.symptom), len(effect.manoeuvre)) > 20, "in words"
    assert set(effect.priors) == set(effect.neutral)
    for key, prior in effect.priors.items():
        assert isinstance(prior, Prior) and prior.times in ("", *SIZES)
        assert prior.low < prior.typical < prior.high and all(map(math.isfinite, prior[:3]))
        assert prior.scale in ("log", "linear") and (prior.scale == "linear" or prior.low > 0.0)
        assert prior.typical != effect.neutral[key], "not the value that changes nothing"
    assert effect.needs and all(need.quantity in QUANTITIES and need.least > 0.0 for need in effect.needs)
    assert len({need.quantity for need in effect.needs}) == len(effect.needs)


@pytest.mark.parametrize("name", NAMES)
def test_impostors_are_effects_and_take_each_others_names(name: str) -> None:
    impostors = EFFECTS[name].impostors
    assert impostors and name not in impostors and len(set(impostors)) == len(impostors)
    assert all(name in EFFECTS[other].impostors for other in impostors)


LINKS = {
    "grade": (Link.REPORT_TO_MOTION, Link.ACCEL_VS_DVDT),
    "road_bank": (Link.REPORT_TO_MOTION, Link.ACCEL_VS_DVDT),
    "speed_scale": (Link.WHEEL_VS_INS,),
    "yaw_rate_bias": (Link.YAW_VS_INS,),
    "yaw_rate_scale": (Link.YAW_VS_INS,),
    "yaw_rate_filter": (Link.YAW_VS_INS,),
    "accel_bias": (Link.ACCEL_VS_DVDT,),
    "steer_report_offset": (Link.COMMAND_TO_REPORT,),
    "report_latency": (Link.CLOCK,),
    "ins_latency": (Link.CLOCK,),
}  # docs/reference/effects.md; of all others the port says it


@pytest.mark.parametrize("name", NAMES)
def test_place_and_links(name: str) -> None:
    effect = EFFECTS[name]
    place = place_of(effect)
    assert place == ("" if effect.port in (Port.BODY, Port.REPORT, Port.INS) else effect.port.value[-1])
    by_port = (Link.COMMAND_TO_REPORT,) if place == "A" else (Link.REPORT_TO_MOTION,)
    assert links_of(effect) == LINKS.get(name, by_port)


def test_a_prior_is_of_the_vehicles_size() -> None:
    payload = EFFECTS["payload"]
    light, heavy = (prior_of(payload, "mass_kg", {"mass_kg": mass_kg}) for mass_kg in (2.0, 3000.0))
    assert light.high == 2.0 * payload.priors["mass_kg"].high and heavy.typical == 1500.0 * light.typical
    assert light.times == "" and prior_of(EFFECTS["steer_lag"], "tau_s", {}) == EFFECTS["steer_lag"].priors["tau_s"]
    for sizes in ({}, {"mass_kg": 0.0}, {"mass_kg": math.nan}):
        with pytest.raises(InputError) as caught:
            prior_of(payload, "mass_kg", sizes)
        assert caught.value.key == "mass_kg" and caught.value.code == "unknown_size"
    with pytest.raises(InputError, match="no prior for wings"):
        prior_of(payload, "wings", {})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", NAMES)
def test_neutral_is_the_identity_bit_for_bit(kind: str, name: str) -> None:
    """Everything: motion, outputs, what is measured, with noise."""
    noise = noise_table({"report.speed_mps": 0.02, "ins.x_m": 0.01, "report.yaw_rate_radps": 0.01}, {}, 200, 1)
    without = driven(kind, {}, noise=noise)
    for neutral in ({}, dict(EFFECTS[name].neutral)):
        assert same(driven(kind, {name: neutral}, noise=noise), without)


@pytest.mark.parametrize("name", SCALAR)
@given(st.lists(st.floats(-10.0, 10.0), max_size=40), st.sampled_from([0.0, 0.15]))
def test_neutral_passes_any_signal(name: str, values: list[float], rest: float) -> None:
    assert run(make_effect(EFFECTS[name], {}, rest=rest), values, DT_S) == values


@pytest.mark.parametrize("name", NAMES)
def test_a_typical_value_changes_a_drive_on_both_physics(name: str) -> None:
    for kind in KINDS:
        assert not same(driven(kind, {name: typical(name)}, rough), driven(kind, {}, rough))


@pytest.mark.parametrize("name", NAMES)
def test_an_end_of_the_prior_changes_a_drive(name: str) -> None:
    """Both ends can be driven; a search over the prior has something to find."""
    priors = {key: prior_of(EFFECTS[name], key, SIZES) for key in EFFECTS[name].neutral}
    without = driven("physics", {}, rough)
    low, high = (
        driven("physics", {name: {key: getattr(prior, end) for key, prior in priors.items()}}, rough)
        for end in ("low", "high")
    )
    assert not same(low, high) and not (same(low, without) and same(high, without))


@pytest.mark.parametrize(("name", "other"), NEXT)
def test_one_on_and_one_off_in_series(name: str, other: str) -> None:
    """In either order, and beside itself, an effect that is neutral changes nothing of what another does."""
    alone = driven("physics", {name: strong(name)})
    assert same(driven("physics", {name: strong(name), other: {}}), alone)
    assert same(driven("physics", {other: {}, name: strong(name)}), alone)
    both = driven("physics", {name: strong(name), other: strong(other)})
    assert not same(both, alone) and not same(both, driven("physics", {other: strong(other)}))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", NAMES)
def test_an_effect_shows_where_its_port_says(kind: str, name: str) -> None:
    """Port A in the output; B and BODY in the motion only; REPORT and INS in their own frames only."""
    without, with_it = driven(kind, {}), driven(kind, {name: strong(name)})
    port = EFFECTS[name].port
    seen_only = port in (Port.REPORT, Port.INS)
    assert (motions(with_it) == motions(without)) is seen_only
    assert ([out.actuation for out in with_it] == [out.actuation for out in without]) is (
        place_of(EFFECTS[name]) != "A"
    )
    if seen_only:
        assert same(reports(with_it), reports(without)) is (port is Port.INS)
        assert same(fixes(with_it), fixes(without)) is (port is Port.REPORT)


def test_what_needs_the_plants_forces_is_no_block() -> None:
    for name, effect in EFFECTS.items():
        made: Any = make_effect(effect, strong(name), name=name)
        assert isinstance(made, Block) is not (effect.port is Port.BODY or name in FORCES)
        if not isinstance(made, Block):
            assert made(BodyChange()) != BodyChange()
            assert make_effect(effect, {}, name=name)(BodyChange()) == BodyChange()


SIGNED = {"payload", "grade", "steer_offset", "head_wind", "side_wind", "road_bank", "aero_drag", "rolling_resistance",
          "yaw_rate_bias", "accel_bias", "steer_report_offset"}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "params"),
    [
        *((name, {key: -1.0}) for name, effect in EFFECTS.items() for key in effect.neutral if name not in SIGNED),
        *((name, {key: math.nan}) for name, effect in EFFECTS.items() for key in effect.neutral if name != "payload"),
        ("steer_dead_time", {"delay_s": -0.1}),
        ("steer_lag", {"tau_s": math.inf}),
        ("steer_gain", {"gain_frac": 0.0}),
        ("friction", {"friction_frac": math.nan}),
        ("grade", {"grade_rad": 2.0}),
        ("road_bank", {"bank_rad": -2.0}),
        ("rolling_resistance", {"extra_frac": -1.1}),
        ("side_wind", {"force_n": math.inf}),
        ("report_latency", {"delay_s": math.inf}),
    ],
)
def test_impossible_values(name: str, params: dict[str, float]) -> None:
    with pytest.raises(InputError) as caught:
        make_effect(EFFECTS[name], params)
    assert caught.value.key in params
