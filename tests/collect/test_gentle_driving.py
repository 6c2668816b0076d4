"""Gentle stretches: they fit vehicle and area, are driven as asked for, calmly, and go on after turning back."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import other_vehicle
from tests.collect.cars import DT_S, Car, Row, drive
from tunefree_hil.collect.cells import CELL_COUNT, max_planned_speed_mps
from tunefree_hil.collect.envelope import Envelope, envelope_from_vehicle
from tunefree_hil.collect.features import GENTLE, STAND, TURN, PlannerParams
from tunefree_hil.collect.gentle_driving import (
    ACCEL_SHARE,
    COAST,
    LATERAL_SHARE,
    SLOW,
    STEER_RATE_SHARE,
    GentleState,
    GentleStretch,
    advance_stage,
    area_side_for_holding_m,
    gentle_curvature_1pm,
    plan_stretches,
)
from tunefree_hil.collect.plan import DrivePlan, make_planner_params, plannable_stretches
from tunefree_hil.config.load import load_vehicle

FULL = (10**6,) * CELL_COUNT  # no cell is missing
PLAN = DrivePlan(10.0, 400.0, None, None, FULL, 0, 110.0, (0, 3))
CASES = [("mkz_bywire", 1), ("mkz_bywire", 2), (other_vehicle.NAME, 3), (other_vehicle.NAME, 4)]
KART = Envelope(6.0, 3.0, 0.5, 1.5, -3.0, 2.0, 1.0, 1.0, 0.0, 1.1, 1.0)


@cache
def driven(name: str, seed: int, first: int = 0) -> tuple[tuple[Row, ...], PlannerParams, bool]:
    own = make_planner_params(load_vehicle(name), PLAN._replace(stretches=(first, first + 3)), DT_S)
    rows, _, ended = drive(own, Car(own.envelope, seed))
    return tuple(rows), own, ended


def of_mode(rows: tuple[Row, ...], mode: int, name: str) -> np.ndarray:
    return np.array([getattr(row, name) for row in rows if row.mode == mode])


@given(
    quota_s=st.floats(0.1, 60.0), drive_s=st.floats(5.0, 300.0), area_m=st.floats(20.0, 900.0), top=st.floats(0.5, 60.0)
)
def test_stretches_fit_vehicle_area_and_drive(quota_s: float, drive_s: float, area_m: float, top: float) -> None:
    for envelope in (envelope_from_vehicle(load_vehicle("mkz_bywire")), KART):
        found = plan_stretches(envelope, quota_s, drive_s, area_m, top)
        assert len(found) % 2 == 0 and sum(one.is_curved for one in found) == len(found) // 2
        for one in found:
            assert 0.0 < one.speed_mps <= max_planned_speed_mps(envelope, top) < envelope.speed_mps
            assert area_side_for_holding_m(envelope, one.speed_mps) <= area_m
            assert 5.0 <= one.hold_s <= min(1.5 * quota_s, 0.15 * drive_s)
            felt = one.speed_mps**2 * gentle_curvature_1pm(envelope, one.speed_mps)
            assert felt <= LATERAL_SHARE * envelope.lateral_mps2 * 1.001


def test_every_speed_is_driven_straight_and_bent_and_a_short_quota_has_none() -> None:
    found = plannable_stretches(load_vehicle("mkz_bywire"), 10.0, 110.0, 400.0, None)
    speeds = {one.speed_mps for one in found}
    assert speeds == {2.0, 4.0, 6.0, 8.0, 11.0, 14.0}
    assert {(one.speed_mps, one.is_curved) for one in found} == {(v, bent) for v in speeds for bent in (False, True)}
    assert plannable_stretches(load_vehicle("mkz_bywire"), 2.0, 110.0, 400.0, None) == ()
    assert max(one.speed_mps for one in plan_stretches(KART, 10.0, 110.0, 60.0, None)) < 4.0


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_each_speed_is_held_and_gently(name: str, seed: int) -> None:
    rows, own, ended = driven(name, seed)
    assert ended and rows[-1].mode == STAND
    speed = of_mode(rows, GENTLE, "speed_mps")
    for one in own.stretches:
        near = np.abs(speed - one.speed_mps) < 0.12 * one.speed_mps + 0.1
        assert near.sum() * DT_S > 0.6 * one.hold_s
    accel = np.abs(np.convolve(np.diff(speed) / DT_S, np.ones(50) / 50.0, "valid"))
    assert np.quantile(accel, 0.99) < 2.0 * ACCEL_SHARE * own.envelope.accel_high_mps2
    assert np.quantile(accel, 0.5) < 0.5 * ACCEL_SHARE * own.envelope.accel_high_mps2


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_pedals_and_wheel_move_calmly_and_all_stays_inside(name: str, seed: int) -> None:
    rows, own, _ = driven(name, seed, 3)
    e = own.envelope
    assert max(max(abs(row.x_m), abs(row.y_m)) for row in rows) < 200.0
    assert max(abs(row.lateral_mps2) for row in rows) < 0.8 * e.lateral_mps2
    for before, after in pairwise(rows):
        if before.mode == after.mode == GENTLE:
            assert abs(after.command.throttle_frac - before.command.throttle_frac) < 0.005
            assert abs(after.command.brake_frac - before.command.brake_frac) < 0.005
            turned = abs(after.command.steer_rad - before.command.steer_rad)
            assert turned <= STEER_RATE_SHARE * e.steer_rate_radps * DT_S + 1e-9
    brake = of_mode(rows, GENTLE, "brake_frac") - e.rest_frac
    assert min(brake) < 1e-6 and 0.01 < max(brake) < 0.35 * (e.brake_frac - e.rest_frac)


def test_near_the_border_it_turns_back_and_goes_on_with_the_stretch() -> None:
    own = make_planner_params(load_vehicle("mkz_bywire"), PLAN._replace(stretches=(4, 6), centre=(0.0, 0.0)), DT_S)
    car = Car(own.envelope, 6)
    car.x_m, car.y_m, car.heading_rad = 150.0, 150.0, 0.7
    rows, _, ended = drive(own, car)
    modes = [row.mode for row in rows]
    back = next(k for k, (mode, after) in enumerate(pairwise(modes)) if (mode, after) == (TURN, GENTLE))
    assert ended and TURN in modes[:back] and modes[back:].count(GENTLE) * DT_S > 15.0
    assert max(max(abs(row.x_m), abs(row.y_m)) for row in rows) < 200.0


def test_what_is_never_reached_is_given_up() -> None:
    envelope = envelope_from_vehicle(load_vehicle("mkz_bywire"))
    gait, seconds = GentleState(), 0.0
    while gait.number == 0 and seconds < 200.0:
        gait = advance_stage(gait, GentleStretch(10.0, 15.0, False), envelope, 3.0, DT_S)
        seconds += DT_S
    assert gait.number == 1 and 40.0 < seconds < 80.0


def test_a_kart_on_a_small_place_does_it_too() -> None:
    own = make_planner_params(load_vehicle("mkz_bywire"), PLAN, DT_S)
    own = own._replace(
        envelope=KART, half_m=30.0, stretches=plan_stretches(KART, 10.0, 110.0, 60.0, None)[:3], need=own.have
    )
    rows, _, ended = drive(own, Car(KART, 2))
    assert ended and max(max(abs(row.x_m), abs(row.y_m)) for row in rows) < 30.0
    assert max(of_mode(tuple(rows), GENTLE, "speed_mps")) < KART.speed_mps


def test_it_coasts_as_long_as_it_is_told_unless_it_stands_before() -> None:
    envelope = envelope_from_vehicle(load_vehicle("mkz_bywire"))
    coasting = GentleState(stage=COAST, time_s=5.0, target_mps=8.0)
    usual = GentleStretch(10.0, 15.0, False)
    assert advance_stage(coasting, usual, envelope, 8.0, DT_S).stage == SLOW
    assert advance_stage(coasting, usual._replace(coast_s=12.0), envelope, 8.0, DT_S).stage == COAST
    assert advance_stage(coasting, usual._replace(coast_s=12.0), envelope, 0.05, DT_S).stage == SLOW
