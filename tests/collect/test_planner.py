"""The planner on cars with drawn constants: it stays inside, fills cells, ends at standstill, and repeats itself."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import pytest

from tests import other_vehicle
from tests.collect.cars import DT_S, Car, Row, drive
from tunefree_hil.collect.cells import CELL_COUNT, CellCounter, CellSignals, classify_cell
from tunefree_hil.collect.plan import DrivePlan, make_planner_params
from tunefree_hil.collect.planner import HOLD, STAND, PlannerParams
from tunefree_hil.config.load import load_vehicle

PLAN = DrivePlan(10.0, 400.0, None, None, (0,) * CELL_COUNT, 0, 40.0)
CASES = [("mkz_bywire", 1), ("mkz_bywire", 2), (other_vehicle.NAME, 3), (other_vehicle.NAME, 4)]


def params(name: str, plan: DrivePlan = PLAN) -> PlannerParams:
    return make_planner_params(load_vehicle(name), plan, DT_S)


@cache
def driven(name: str, seed: int) -> tuple[tuple[Row, ...], tuple[int, ...], bool]:
    own = params(name)
    rows, have, ended = drive(own, Car(own.envelope, seed))
    return tuple(rows), tuple(have), ended


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_it_never_leaves_envelope_or_area(name: str, seed: int) -> None:
    rows, _, _ = driven(name, seed)
    envelope = params(name).envelope
    assert max(row.speed_mps for row in rows) < envelope.speed_mps
    assert max(abs(row.lateral_mps2) for row in rows) < envelope.lateral_mps2
    assert max(max(abs(row.x_m), abs(row.y_m)) for row in rows) < 200.0
    steers = [row.command.steer_rad for row in rows]
    assert max(abs(b - a) for a, b in pairwise(steers)) <= envelope.steer_rate_radps * DT_S
    assert max(map(abs, steers)) <= envelope.steer_rad
    rest = envelope.rest_frac
    for row in rows:
        throttle, brake = row.command.throttle_frac, row.command.brake_frac
        assert rest <= throttle <= envelope.throttle_frac and rest <= brake <= envelope.brake_frac
        assert throttle == rest or brake == rest


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_it_ends_at_standstill_after_its_time_and_has_filled_cells(name: str, seed: int) -> None:
    rows, have, ended = driven(name, seed)
    assert ended and rows[-1].mode == STAND and 0.0 <= rows[-1].speed_mps < 0.1
    assert 40.0 < len(rows) * DT_S < 70.0
    assert sum(have) * DT_S > 10.0 and sum(count > 0 for count in have) >= 8
    assert len({row.cell for row in rows if row.mode == HOLD}) >= 3


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_it_counts_as_brute_force_counts_what_it_saw(name: str, seed: int) -> None:
    """The car's own values are without noise, so that counts at the edges of cells may differ a little."""
    rows, have, _ = driven(name, seed)
    own = params(name)
    counter = CellCounter(own.need)
    for row in rows:
        seen = CellSignals(4.0, row.speed_mps, row.steer_rad, row.throttle_frac, row.brake_frac)
        counter.count_frame(classify_cell(own.bands, seen))
    assert sum(abs(a - b) for a, b in zip(counter.have, have, strict=True)) < 0.1 * sum(have)


def test_it_repeats_itself_and_the_next_drive_is_another_one() -> None:
    own = params("mkz_bywire", PLAN._replace(stop_s=8.0))
    first, again = (drive(own, Car(own.envelope, 5)) for _ in range(2))
    assert first == again
    other = params("mkz_bywire", PLAN._replace(stop_s=8.0, first_hold=7))
    assert drive(other, Car(own.envelope, 5))[0] != first[0]


def test_nothing_to_do_is_a_drive_that_stands() -> None:
    own = params("mkz_bywire")._replace(have=tuple(params("mkz_bywire").need))
    rows, _, ended = drive(own, Car(own.envelope, 1))
    assert ended and len(rows) * DT_S < 15.0 and max(row.speed_mps for row in rows) < 3.0


def test_towards_the_border_it_turns_back_and_from_a_place_outside_it_comes_back_in() -> None:
    own = params("mkz_bywire", PLAN._replace(centre=(0.0, 0.0)))
    car = Car(own.envelope, 6)
    car.x_m, car.y_m, car.heading_rad = 185.0, 0.0, 0.0
    rows, _, ended = drive(own, car)
    assert ended and max(row.x_m for row in rows) < 200.0
    assert min(row.x_m for row in rows) < 100.0
