"""What a model's data covered is what a drive stays inside of: rest and all on the pedals, to either side alike."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import pytest

from tests.collect.cars import DT_S, Car, Row, drive
from tunefree_hil.collect.bounds import CREEP_SPEED_MPS, bounds_from_valid_region, limit_envelope
from tunefree_hil.collect.cells import CELL_COUNT, FIRST_THROTTLE
from tunefree_hil.collect.envelope import LATERAL_SHARE, envelope_from_vehicle
from tunefree_hil.collect.features import APPROACH, GENTLE, HOLD, TURN
from tunefree_hil.collect.pedals import PedalState, push_for_acceleration
from tunefree_hil.collect.plan import TOO_STRONG, DrivePlan, make_planner_params, plannable_cells, plannable_stretches
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.config.schema import ValidSpec

MKZ = load_vehicle("mkz_bywire")
REST = MKZ.nominal.rest_pedal_frac
VALID = ValidSpec(
    speed_mps=[0.0, 14.0], accel_mps2=[-2.4, 1.5], lateral_accel_mps2=[-2.1, 1.2], steer_rad=[-1.0, 3.0],
    pedals=[-0.29, 0.42],
)  # fmt: skip
PLAN = DrivePlan(10.0, 400.0, 14.0, None, (0,) * CELL_COUNT, 0, 60.0)


def test_where_nothing_is_said_the_vehicle_folder_is_all_there_is() -> None:
    bounds, envelope = bounds_from_valid_region(MKZ, ValidSpec()), envelope_from_vehicle(MKZ)
    limits = MKZ.limits
    assert bounds[1:6] == (limits.speed_mps, limits.lateral_accel_mps2, limits.steer_rad, *limits.accel_mps2)
    assert limit_envelope(envelope, bounds) == envelope._replace(throttle_release_mps2=limits.accel_mps2[1])


def test_the_region_cuts_the_limits_and_counts_pedals_over_rest() -> None:
    bounds = bounds_from_valid_region(MKZ, VALID)
    assert bounds == pytest.approx((CREEP_SPEED_MPS, 14.0, 2.1, 3.0, -2.4, 1.5, 0.42 - REST, 0.29 - REST))
    envelope = limit_envelope(envelope_from_vehicle(MKZ), bounds)
    assert LATERAL_SHARE * envelope.lateral_mps2 == pytest.approx(2.1) and envelope.steer_rad == 3.0
    assert envelope.max_throttle_push == pytest.approx((0.42 - REST) / (MKZ.limits.throttle_frac - REST))
    assert envelope.max_brake_push == pytest.approx((0.29 - REST) / (MKZ.limits.brake_frac - REST))


def test_more_than_the_vehicle_may_is_never_asked_for() -> None:
    wide = ValidSpec(speed_mps=[0.0, 90.0], accel_mps2=[-20.0, 20.0], steer_rad=[-40.0, 40.0], pedals=[-1.0, 1.0])
    assert bounds_from_valid_region(MKZ, wide) == bounds_from_valid_region(MKZ, ValidSpec())


@pytest.mark.parametrize(
    "valid", [ValidSpec(pedals=[0.0, 0.4]), ValidSpec(pedals=[-0.3, REST]), ValidSpec(accel_mps2=[0.1, 1.0])]
)
def test_data_without_a_pedal_or_a_braking_leave_nothing_to_drive(valid: ValidSpec) -> None:
    assert bounds_from_valid_region(MKZ, VALID).is_drivable and not bounds_from_valid_region(MKZ, valid).is_drivable


def test_cells_and_stretches_beyond_are_left_out_and_creeping_is_no_driving() -> None:
    bounds = bounds_from_valid_region(
        MKZ, ValidSpec(pedals=[-0.20, 0.25])
    )  # a seventh of either way: neither of the hardest bands
    targets = plannable_cells(MKZ, None, bounds)
    left_out = {one.index.pedal for one in targets if one.excluded == TOO_STRONG}
    assert left_out == {0, 1, FIRST_THROTTLE + 1, FIRST_THROTTLE + 2}
    assert min(one.low_mps for one in targets if not one.excluded) == CREEP_SPEED_MPS
    assert min(one.low_mps for one in plannable_cells(MKZ, None) if not one.excluded) < 1.0
    some = plannable_stretches(MKZ, 10.0, 110.0, 400.0, None, bounds)
    every = plannable_stretches(MKZ, 10.0, 110.0, 400.0, None)
    quick = [one for one in every if one.speed_mps >= CREEP_SPEED_MPS]
    assert some == tuple(one._replace(max_mps=bounds.speed_mps) for one in quick) and len(quick) < len(every)


@pytest.mark.parametrize("accel_mps2", [-2.0, -1.0, 0.5, 1.0])
def test_how_much_a_pedal_does_is_the_vehicles_however_little_the_data_covered(accel_mps2: float) -> None:
    whole = envelope_from_vehicle(MKZ)
    some = limit_envelope(whole, bounds_from_valid_region(MKZ, VALID))
    assert some.accel_high_mps2 < whole.accel_high_mps2 and some.accel_low_mps2 > whole.accel_low_mps2
    (_, push), (_, wanted) = (push_for_acceleration(PedalState(), one, accel_mps2, DT_S) for one in (some, whole))
    assert push == pytest.approx(wanted)


@pytest.mark.parametrize("seed", [1, 2, 7])
def test_a_speed_that_is_held_is_not_varied_beyond(seed: int) -> None:
    bounds = bounds_from_valid_region(MKZ, VALID)
    speeds = [one.speed_mps for one in plannable_stretches(MKZ, 4.0, 300.0, 500.0, 14.0, bounds)]
    number = speeds.index(max(speeds))
    assert 1.15 * speeds[number] > 14.0 + 0.5  # so varied without an end it is beyond by more than the feedback misses
    plan = DrivePlan(4.0, 500.0, 14.0, None, (10**6,) * CELL_COUNT, 0, 300.0, (number, number + 1), bounds)
    rows, _, ended = drive(make_planner_params(MKZ, plan, DT_S), Car(envelope_from_vehicle(MKZ), seed))
    assert ended and 13.0 < max(row.speed_mps for row in rows if row.mode == GENTLE) < 14.5


@cache
def driven(seed: int) -> tuple[tuple[Row, ...], bool]:
    params = make_planner_params(MKZ, PLAN._replace(bounds=bounds_from_valid_region(MKZ, VALID)), DT_S)
    rows, _, ended = drive(params, Car(envelope_from_vehicle(MKZ), seed))
    return tuple(rows), ended


@pytest.mark.parametrize("seed", [1, 2, 7])
def test_a_drive_stays_inside(seed: int) -> None:
    rows, ended = driven(seed)
    assert ended and max(row.speed_mps for row in rows) < 14.5
    assert max(abs(row.lateral_mps2) for row in rows) < 1.15 * 2.1 and max(abs(row.steer_rad) for row in rows) < 3.05
    commands = [row.command for row in rows if row.mode in (APPROACH, HOLD, TURN)]
    assert max(one.throttle_frac for one in commands) <= 0.42 + 1e-9
    assert max(one.brake_frac for one in commands) <= 0.29 + 1e-9
    holds = [row.speed_mps for row in rows if row.mode == HOLD]
    assert len(holds) * DT_S > 15.0 and min(holds) > CREEP_SPEED_MPS - 0.2


@pytest.mark.parametrize("seed", [1, 2, 7])
def test_a_throttle_that_quickens_too_much_is_let_go_of(seed: int) -> None:
    free, _, _ = drive(make_planner_params(MKZ, PLAN, DT_S), Car(envelope_from_vehicle(MKZ), seed))
    some, every = (lively_share(rows) for rows in (driven(seed)[0], free))
    assert every > 0.05 and some < 0.4 * every


def lively_share(rows: Sequence[Row]) -> float:
    """Of a drive, in which it quickens by more than the data did and a fifth."""
    change = [b.speed_mps - a.speed_mps for a, b in zip(rows, rows[20:], strict=False)]
    return sum(one > 1.2 * 1.5 * 20 * DT_S for one in change) / len(change)
