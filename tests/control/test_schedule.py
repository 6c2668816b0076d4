"""The speed plan: look-ups, stops, shifting the clock, blends."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.control import schedule as sch

ZERO = sch.no_blend()


def stop_and_go(t):
    """2 m/s, to rest at 6 s, waits until 9 s, off again to 2 m/s at 11 s."""
    if t < 4.0:
        return 2.0
    if t < 6.0:
        return 6.0 - t
    if t < 9.0:
        return 0.0
    return min(2.0, t - 9.0)


@pytest.fixture(scope="module")
def plan(kit):
    return sch.make_schedule(kit.course(15.0, stop_and_go))


def test_look_ups_interpolate_and_go_on_beyond_the_end(plan):
    assert sch.plan_at(plan, 4.505) == (pytest.approx(1.495), pytest.approx(-1.0))
    assert sch.station_at(plan, 1.2345) == pytest.approx(2.469)
    assert sch.station_at(plan, 17.0) == pytest.approx(plan.station_m[-1] + 4.0)
    assert sch.plan_at(plan, 17.0) == (2.0, plan.accel_mps2[-1])
    assert sch.station_at(plan, -1.0) == 0.0


def test_stops_are_found(plan):
    end_m = 20.0 + 20.0
    assert plan.stop_station_m[0] == pytest.approx(10.0)
    assert plan.stop_station_m[899] == pytest.approx(10.0)
    assert plan.stop_station_m[900] == pytest.approx(end_m)  # pulls away
    assert plan.stop_station_m[-1] == pytest.approx(end_m)


@pytest.mark.parametrize(
    ("now_s", "station_m", "expected_s"),
    [
        (3.0, 6.0, 3.0),
        (3.0, 3.5, 1.75),  # behind: the clock goes back
        (1.0, 5.0, 2.5),  # ahead: it goes on
        (2.0, 12.5, 6.0),  # overran the stop: the wait begins
        (7.5, 12.5, 7.5),  # overran it while waiting: the wait goes on
        (7.5, 8.0, 4.0),  # stands short of it: approaches it again
        (7.5, 10.0, 7.5),
        (10.0, 9.0, 6.0 - 2.0**0.5),  # fell behind while pulling away: has it all before it
        (13.0, 22.0, 16.0),  # beyond the end of the plan
        (0.5, -3.0, 0.0),  # rolled back behind the start
    ],
)
def test_clock_is_set_to_where_the_vehicle_is(plan, now_s, station_m, expected_s):
    assert sch.time_of(plan, now_s, station_m) == pytest.approx(expected_s, abs=1e-3)


@given(st.floats(0.0, 15.0), st.floats(0.0, 20.0))
def test_clock_and_station_are_inverse_where_the_plan_moves(plan, now_s, station_m):
    found_s = sch.time_of(plan, now_s, station_m)
    rest_m = station_m - sch.station_at(plan, found_s)
    standing = 6.0 - 0.011 <= found_s < 9.0
    assert rest_m == pytest.approx(0.0, abs=1e-9) or (standing and rest_m > 0.0)


def test_speed_offset_fades_smoothly():
    blend = ZERO._replace(from_s=1.0, speed_mps=-2.0)
    assert sch.speed_blend(blend, 3.0, 1.0) == (-2.0, 0.0)
    assert sch.speed_blend(blend, 3.0, 2.5) == (pytest.approx(-1.0), pytest.approx(1.0))
    assert sch.speed_blend(blend, 3.0, 4.0) == (0.0, 0.0)
    low, high = sch.speed_blend(blend, 3.0, 1.8)[0], sch.speed_blend(blend, 3.0, 1.8 + 1e-6)[0]
    assert (high - low) / 1e-6 == pytest.approx(sch.speed_blend(blend, 3.0, 1.8)[1], rel=1e-4)


def test_reference_never_runs_backwards(plan):
    blend = ZERO._replace(from_s=5.9, speed_mps=-1.0)
    assert sch.reference_at(plan, blend, 3.0, 6.5) == (0.0, 0.0)
    assert sch.reference_at(plan, ZERO, 3.0, 3.0) == (pytest.approx(2.0), pytest.approx(0.0, abs=1e-9))


@given(st.floats(-0.6, 0.6), st.floats(-0.3, 0.3), st.floats(6.0, 60.0), st.floats(0.001, 0.999))
def test_lateral_quintic(lateral_m, slope, length_m, share):
    blend = ZERO._replace(from_station_m=7.0, length_m=length_m, lateral_m=lateral_m, slope=slope)
    assert sch.lateral_blend(blend, 7.0) == (pytest.approx(lateral_m), pytest.approx(slope), 0.0)
    assert sch.lateral_blend(blend, 7.0 + length_m) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    at_m, h = 7.0 + share * length_m, 1e-4 * length_m
    low, middle, high = (sch.lateral_blend(blend, at_m + d) for d in (-h, 0.0, h))
    if share > 1e-3 and share < 1.0 - 1e-3:
        assert (high[0] - low[0]) / (2.0 * h) == pytest.approx(middle[1], abs=1e-5)
        assert (high[1] - low[1]) / (2.0 * h) == pytest.approx(middle[2], abs=1e-5)
