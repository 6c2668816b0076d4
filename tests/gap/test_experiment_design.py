"""Every catalogue effect has manoeuvres that can be driven, and that excite it as it needs."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests import other_vehicle
from tests.collect.cars import DT_S, Car, Row, drive
from tunefree_hil.base.contracts import QUANTITIES, Effect, Need, Port
from tunefree_hil.collect.bounds import bounds_from_valid_region
from tunefree_hil.collect.cells import cell_index
from tunefree_hil.collect.envelope import LATERAL_SHARE, envelope_from_vehicle
from tunefree_hil.collect.plan import make_planner_params, plan_as_dict, plan_from_dict
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.schema import ValidSpec
from tunefree_hil.effects import catalogue
from tunefree_hil.gap.experiment_design import (
    AREA_M,
    MANOEUVRE_BY_QUANTITY,
    MANOEUVRES,
    MANOEUVRES_BY_PHRASE,
    MAX_MANOEUVRES,
    manoeuvres_for_effect,
    next_manoeuvres,
    plan_manoeuvre,
)
from tunefree_hil.gap.measured.chain import MeasuredDrive
from tunefree_hil.gap.measured.excitation import assess_excitation, measure_quantities

EFFECTS = catalogue()
VEHICLES = ("mkz_bywire", other_vehicle.NAME)
SEEDS = {"mkz_bywire": 3, other_vehicle.NAME: 4}


def own(words: str, *needs: Need) -> Effect:
    """An effect of a user."""
    return Effect(Port.STEER_B, {}, {}, lambda params, rest: None, "", manoeuvre=words, needs=needs)


def answer(verdict: str, names: list[str] | None = None, lacking: tuple[str, ...] = ()) -> dict[str, Any]:
    return {
        "verdict": verdict, "set": names or [],
        "excitation": {name: {"enough": name not in lacking} for name in EFFECTS} if lacking else {},
    }  # fmt: skip


def names_of(*effects: str) -> list[str]:
    return list(dict.fromkeys(one.name for name in effects for one in manoeuvres_for_effect(EFFECTS[name])))


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_names_known_manoeuvres(name: str) -> None:
    asked = EFFECTS[name].manoeuvre.partition(":")[0].lower()
    assert [words for words, _ in MANOEUVRES_BY_PHRASE if words in asked], f"{name}: {asked!r} has no known manoeuvre"


def test_every_manoeuvre_is_used_and_every_quantity_has_one() -> None:
    assert {one.name for effect in EFFECTS.values() for one in manoeuvres_for_effect(effect)} == set(MANOEUVRES)
    assert MANOEUVRE_BY_QUANTITY.keys() == QUANTITIES.keys() and set(MANOEUVRE_BY_QUANTITY.values()) <= set(MANOEUVRES)


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("name", MANOEUVRES)
def test_every_manoeuvre_has_a_plan_of_its_cells_only(name: str, vehicle: str) -> None:
    spec, one = load_vehicle(vehicle), MANOEUVRES[name]
    plan = plan_manoeuvre(spec, one, DT_S)
    assert plan is not None and plan_from_dict(plan_as_dict(plan), "x") == plan
    params = make_planner_params(spec, plan, DT_S)
    lacking = [cell_index(i) for i, (had, need) in enumerate(zip(params.have, params.need, strict=True)) if had < need]
    assert bool(lacking) is not one.is_gentle and bool(params.stretches) is one.is_gentle
    for place in lacking:
        assert place.steer in one.steers and place.speed in one.speeds and place.pedal in one.pedals


def test_a_plan_stays_inside_what_a_models_data_covered() -> None:
    spec = load_vehicle("mkz_bywire")
    bounds = bounds_from_valid_region(spec, ValidSpec(speed_mps=[0.0, 11.0], pedals=[-0.30, 0.40]))
    plan = plan_manoeuvre(spec, MANOEUVRES["throttle_steps"], DT_S, bounds)
    assert plan is not None and plan.bounds == bounds and plan.top_mps == 11.0
    free = plan_manoeuvre(spec, MANOEUVRES["throttle_steps"], DT_S)
    assert free is not None and free.bounds is None and (free.top_mps or 0.0) > 11.0


@pytest.mark.parametrize(
    ("valid", "left"),
    [
        (ValidSpec(pedals=[-0.30, 0.2]), {"full_throttle"}),  # a bit of throttle
        (ValidSpec(pedals=[-0.20, 0.5]), {"stops"}),
        (ValidSpec(speed_mps=[0.0, 2.9]), set(MANOEUVRES)),  # creeps
        (ValidSpec(steer_rad=[-0.1, 0.1]), set(MANOEUVRES)),  # a motorway: no turning back inside the area
        (ValidSpec(accel_mps2=[0.0, 1.0]), set(MANOEUVRES)),  # never slowed down
    ],
)
def test_a_manoeuvre_impossible_within_bounds_has_no_plan(valid: ValidSpec, left: set[str]) -> None:
    spec = load_vehicle("mkz_bywire")
    bounds = bounds_from_valid_region(spec, valid)
    assert {name for name, one in MANOEUVRES.items() if plan_manoeuvre(spec, one, DT_S, bounds) is None} == left


@cache
def driven(vehicle: str, name: str) -> tuple[tuple[Row, ...], bool]:
    """A manoeuvre on a car with drawn constants."""
    spec = load_vehicle(vehicle)
    plan = plan_manoeuvre(spec, MANOEUVRES[name], DT_S)
    assert plan is not None
    rows, _, ended = drive(
        make_planner_params(spec, plan, DT_S), Car(envelope_from_vehicle(spec), SEEDS[vehicle]), plan.stop_s + 60.0
    )
    return tuple(rows), ended


def opened(rows: tuple[Row, ...]) -> MeasuredDrive:
    """The part of a drive that `measure_quantities` uses."""
    commands = np.array([row.command[:3] for row in rows])
    speed = np.array([row.speed_mps for row in rows])
    yaw_rate = np.array([row.lateral_mps2 for row in rows]) / np.maximum(speed, 0.1)
    inputs = SimpleNamespace(commands=commands, speed_mps=speed, yaw_rate_radps=yaw_rate)
    return cast(MeasuredDrive, SimpleNamespace(inputs=inputs, dt_s=DT_S, is_moving=speed > 0.1, size_scale=1.0))


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("name", MANOEUVRES)
def test_a_drive_stays_inside_and_ends_standing(name: str, vehicle: str) -> None:
    rows, ended = driven(vehicle, name)
    envelope = envelope_from_vehicle(load_vehicle(vehicle))
    assert ended and rows[-1].speed_mps < 0.1 and max(row.speed_mps for row in rows) > 2.0
    assert max(row.speed_mps for row in rows) < envelope.speed_mps
    assert max(abs(row.lateral_mps2) for row in rows) < envelope.lateral_mps2
    assert max(max(abs(row.x_m), abs(row.y_m)) for row in rows) < 0.5 * AREA_M


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("name", EFFECTS)
def test_the_manoeuvres_for_an_effect_excite_it(name: str, vehicle: str) -> None:
    spec = load_vehicle(vehicle)
    drives = [opened(driven(vehicle, one.name)[0]) for one in manoeuvres_for_effect(EFFECTS[name])]
    effect, planned_mps2 = EFFECTS[name], LATERAL_SHARE * spec.limits.lateral_accel_mps2
    allowed = tuple(  # a folder may not allow as much sideways as an effect would need
        one for one in effect.needs if one.quantity != "lateral_accel_mps2" or one.least <= planned_mps2
    )
    assert allowed == effect.needs or (vehicle, name) == (other_vehicle.NAME, "friction")
    found = assess_excitation({name: effect._replace(needs=allowed)}, measure_quantities(drives, spec))[name]
    assert found.is_sufficient, found.shortages


def test_a_set_is_driven_effect_by_effect_until_nothing_is_left() -> None:
    names = ["steer_dead_time", "brake_lag"]
    first = next_manoeuvres(answer("set", names), (), EFFECTS)
    assert [one.name for one in first] == names_of("steer_dead_time")
    second = next_manoeuvres(answer("set", names), {one.name for one in first}, EFFECTS)
    assert [one.name for one in second] == names_of("brake_lag")
    assert next_manoeuvres(answer("set", names), {one.name for one in (*first, *second)}, EFFECTS) == ()
    assert next_manoeuvres(answer("set", ["of_nobody"]), (), EFFECTS) == ()


def test_after_the_separating_manoeuvres_those_for_the_needs_follow() -> None:
    names = ["payload", "brake_gain"]
    first = {one.name for one in next_manoeuvres(answer("set", names), (), EFFECTS)}
    assert first == set(names_of(*names)) == {"throttle_steps", "brake_levels"}
    second = [one.name for one in next_manoeuvres(answer("set", names), first, EFFECTS)]
    assert second == ["full_throttle", "stops"]
    assert next_manoeuvres(answer("set", names), first | set(second), EFFECTS) == ()


@pytest.mark.parametrize("verdict", ["one", "several", "none_missing", "none_of_these"])
def test_a_decided_answer_needs_no_drive(verdict: str) -> None:
    assert next_manoeuvres(answer(verdict, ["steer_lag"], ("steer_lag",)), (), EFFECTS) == ()


def test_where_excitation_is_insufficient_the_manoeuvres_of_most_effects_come_first() -> None:
    one = next_manoeuvres(answer("cannot_test", lacking=("brake_lag", "brake_dead_time", "steer_lag")), (), EFFECTS)
    assert [found.name for found in one] == ["brake_levels", "steer_steps"]
    driven_now: set[str] = set()
    while some := next_manoeuvres(answer("cannot_test"), driven_now, EFFECTS):
        assert 0 < len(some) <= MAX_MANOEUVRES and not driven_now & {found.name for found in some}
        driven_now |= {found.name for found in some}
    assert driven_now == set(MANOEUVRES)


def test_a_users_effect_is_driven_by_its_text_or_by_its_needs() -> None:
    needs = (Need("brake_moves", 3.0), Need("curve_s", 2.0))
    assert [one.name for one in manoeuvres_for_effect(own("Circles, as many as you like: coasting shows nothing"))] == [
        "circles"
    ]
    assert [one.name for one in manoeuvres_for_effect(own("sing to it", *needs))] == ["brake_levels", "circles"]
    assert manoeuvres_for_effect(own("")) == ()
