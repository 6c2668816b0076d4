"""The words by which every effect of the catalogue is told apart can be driven, and show what the effect needs."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests import other_vehicle
from tests.collect.cars import DT_S, Car, Row, drive
from tunefree_hil.base.contracts import QUANTITIES, Effect, Need, Port
from tunefree_hil.collect.bounds import bounds_of
from tunefree_hil.collect.cells import place_of
from tunefree_hil.collect.envelope import LATERAL_SHARE, envelope_of
from tunefree_hil.collect.plan import as_dict, params_of, plan_of
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.schema import ValidSpec
from tunefree_hil.effects import catalogue
from tunefree_hil.gap.experiment_design import AREA_M, GIVEN_BY, MENU, MOST, SAID, manoeuvres_of, plan_for, to_drive
from tunefree_hil.gap.measured.chain import Opened
from tunefree_hil.gap.measured.excitation import excitation, held_by

EFFECTS = catalogue()
VEHICLES = ("mkz_bywire", other_vehicle.NAME)
SEEDS = {"mkz_bywire": 3, other_vehicle.NAME: 4}


def own(words: str, *needs: Need) -> Effect:
    """An effect of somebody's own."""
    return Effect(Port.STEER_B, {}, {}, lambda params, rest: None, "", manoeuvre=words, needs=needs)


def answer(verdict: str, names: list[str] | None = None, lacking: tuple[str, ...] = ()) -> dict[str, Any]:
    return {
        "verdict": verdict, "set": names or [],
        "excitation": {name: {"enough": name not in lacking} for name in EFFECTS} if lacking else {},
    }  # fmt: skip


def names_of(*effects: str) -> list[str]:
    return list(dict.fromkeys(one.name for name in effects for one in manoeuvres_of(EFFECTS[name])))


@pytest.mark.parametrize("name", EFFECTS)
def test_the_words_of_every_effect_are_on_the_menu(name: str) -> None:
    asked = EFFECTS[name].manoeuvre.partition(":")[0].lower()
    assert [words for words, _ in SAID if words in asked], f"{name}: {asked!r} is nothing that can be driven"


def test_every_entry_of_the_menu_is_asked_for_and_every_quantity_is_given() -> None:
    assert {one.name for effect in EFFECTS.values() for one in manoeuvres_of(effect)} == set(MENU)
    assert GIVEN_BY.keys() == QUANTITIES.keys() and set(GIVEN_BY.values()) <= set(MENU)


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("name", MENU)
def test_every_entry_has_a_plan_that_asks_for_its_cells_only(name: str, vehicle: str) -> None:
    spec, one = load_vehicle(vehicle), MENU[name]
    plan = plan_for(spec, one, DT_S)
    assert plan is not None and plan_of(as_dict(plan), "x") == plan
    params = params_of(spec, plan, DT_S)
    lacking = [place_of(i) for i, (had, need) in enumerate(zip(params.have, params.need, strict=True)) if had < need]
    assert bool(lacking) is not one.gentle and bool(params.stretches) is one.gentle
    for place in lacking:
        assert place.steer in one.steers and place.speed in one.speeds and place.pedal in one.pedals


def test_a_plan_stays_inside_what_a_models_data_covered() -> None:
    spec = load_vehicle("mkz_bywire")
    bounds = bounds_of(spec, ValidSpec(speed_mps=[0.0, 11.0], pedals=[-0.30, 0.40]))
    plan = plan_for(spec, MENU["throttle_steps"], DT_S, bounds)
    assert plan is not None and plan.bounds == bounds and plan.top_mps == 11.0
    free = plan_for(spec, MENU["throttle_steps"], DT_S)
    assert free is not None and free.bounds is None and (free.top_mps or 0.0) > 11.0


@pytest.mark.parametrize(
    ("valid", "left"),
    [
        (ValidSpec(pedals=[-0.30, 0.2]), {"full_throttle"}),  # a bit of throttle
        (ValidSpec(pedals=[-0.20, 0.5]), {"stops"}),
        (ValidSpec(speed_mps=[0.0, 2.9]), set(MENU)),  # creeps
        (ValidSpec(steer_rad=[-0.1, 0.1]), set(MENU)),  # a motorway: no turning back inside the area
        (ValidSpec(accel_mps2=[0.0, 1.0]), set(MENU)),  # never slowed down
    ],
)
def test_what_is_impossible_inside_has_no_plan(valid: ValidSpec, left: set[str]) -> None:
    spec = load_vehicle("mkz_bywire")
    bounds = bounds_of(spec, valid)
    assert {name for name, one in MENU.items() if plan_for(spec, one, DT_S, bounds) is None} == left


@cache
def driven(vehicle: str, name: str) -> tuple[tuple[Row, ...], bool]:
    """A manoeuvre on a car with drawn constants."""
    spec = load_vehicle(vehicle)
    plan = plan_for(spec, MENU[name], DT_S)
    assert plan is not None
    rows, _, ended = drive(params_of(spec, plan, DT_S), Car(envelope_of(spec), SEEDS[vehicle]), plan.stop_s + 60.0)
    return tuple(rows), ended


def opened(rows: tuple[Row, ...]) -> Opened:
    """What `held_by` looks at of a drive."""
    commands = np.array([row.command[:3] for row in rows])
    speed = np.array([row.speed_mps for row in rows])
    yaw_rate = np.array([row.lateral_mps2 for row in rows]) / np.maximum(speed, 0.1)
    inputs = SimpleNamespace(commands=commands, speed_mps=speed, yaw_rate_radps=yaw_rate)
    return cast(Opened, SimpleNamespace(inputs=inputs, dt_s=DT_S, moving=speed > 0.1, pace=1.0))


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("name", MENU)
def test_a_drive_stays_inside_and_ends_standing(name: str, vehicle: str) -> None:
    rows, ended = driven(vehicle, name)
    envelope = envelope_of(load_vehicle(vehicle))
    assert ended and rows[-1].speed_mps < 0.1 and max(row.speed_mps for row in rows) > 2.0
    assert max(row.speed_mps for row in rows) < envelope.speed_mps
    assert max(abs(row.lateral_mps2) for row in rows) < envelope.lateral_mps2
    assert max(max(abs(row.x_m), abs(row.y_m)) for row in rows) < 0.5 * AREA_M


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("name", EFFECTS)
def test_what_is_driven_for_an_effect_shows_it(name: str, vehicle: str) -> None:
    spec = load_vehicle(vehicle)
    drives = [opened(driven(vehicle, one.name)[0]) for one in manoeuvres_of(EFFECTS[name])]
    effect, planned_mps2 = EFFECTS[name], LATERAL_SHARE * spec.limits.lateral_accel_mps2
    allowed = tuple(  # a folder may not allow as much sideways as an effect would need
        one for one in effect.needs if one.quantity != "lateral_accel_mps2" or one.least <= planned_mps2
    )
    assert allowed == effect.needs or (vehicle, name) == (other_vehicle.NAME, "friction")
    found = excitation({name: effect._replace(needs=allowed)}, held_by(drives, spec))[name]
    assert found.enough, found.lacks


def test_a_set_is_driven_name_by_name_until_nothing_is_left() -> None:
    names = ["steer_dead_time", "brake_lag"]
    first = to_drive(answer("set", names), (), EFFECTS)
    assert [one.name for one in first] == names_of("steer_dead_time")
    second = to_drive(answer("set", names), {one.name for one in first}, EFFECTS)
    assert [one.name for one in second] == names_of("brake_lag")
    assert to_drive(answer("set", names), {one.name for one in (*first, *second)}, EFFECTS) == ()
    assert to_drive(answer("set", ["of_nobody"]), (), EFFECTS) == ()


def test_once_all_that_tells_apart_is_driven_what_the_names_need_comes() -> None:
    names = ["payload", "brake_gain"]
    first = {one.name for one in to_drive(answer("set", names), (), EFFECTS)}
    assert first == set(names_of(*names)) == {"throttle_steps", "brake_levels"}
    second = [one.name for one in to_drive(answer("set", names), first, EFFECTS)]
    assert second == ["full_throttle", "stops"]
    assert to_drive(answer("set", names), first | set(second), EFFECTS) == ()


@pytest.mark.parametrize("verdict", ["one", "several", "none_missing", "none_of_these"])
def test_what_is_decided_is_not_driven(verdict: str) -> None:
    assert to_drive(answer(verdict, ["steer_lag"], ("steer_lag",)), (), EFFECTS) == ()


def test_where_nothing_could_be_told_what_most_effects_lack_comes_first() -> None:
    one = to_drive(answer("cannot_test", lacking=("brake_lag", "brake_dead_time", "steer_lag")), (), EFFECTS)
    assert [found.name for found in one] == ["brake_levels", "steer_steps"]
    driven_now: set[str] = set()
    while some := to_drive(answer("cannot_test"), driven_now, EFFECTS):
        assert 0 < len(some) <= MOST and not driven_now & {found.name for found in some}
        driven_now |= {found.name for found in some}
    assert driven_now == set(MENU)


def test_an_effect_of_ones_own_is_driven_by_its_words_or_by_what_it_needs() -> None:
    needs = (Need("brake_moves", 3.0), Need("curve_s", 2.0))
    assert [one.name for one in manoeuvres_of(own("Circles, as many as you like: coasting shows nothing"))] == [
        "circles"
    ]
    assert [one.name for one in manoeuvres_of(own("sing to it", *needs))] == ["brake_levels", "circles"]
    assert manoeuvres_of(own("")) == ()
