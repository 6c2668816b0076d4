"""The chain behind the inner loop."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.control import limits
from tunefree_hil.control.contract import Settings, Setup, VehicleConstants
from tunefree_hil.control.steering_map import data_sheet_map, steady_road_wheel_rad, wheel_rad

DT_S = 0.01


def make(vehicle=VehicleConstants()):  # noqa: B008 - frozen
    return limits.make(Setup({}, vehicle, None, Settings(), DT_S))


def run(block, inputs):
    state, out = block.init(block.params, DT_S), []
    for x in inputs:
        state, y = block.step(block.params, state, x, DT_S)
        out.append(y)
    return out


def setup_of(vehicle, **others):
    return Setup({}, vehicle, None, Settings(), DT_S, **others)


def test_bound_by_lateral_acceleration():
    bound = limits.steer_bound_of(setup_of(VehicleConstants()))
    assert limits.steer_bound(bound, 0.0) == 8.20305
    assert limits.steer_bound(bound, 3.0) == 8.20305
    assert limits.steer_bound(bound, 10.0) == pytest.approx(math.atan(5.0 * 2.8448 / 100.0) * 16.0)
    assert limits.steer_bound(bound, -10.0) == limits.steer_bound(bound, 10.0)


def test_bound_of_a_part_that_knows_the_steering_gives_the_lateral_acceleration():
    steering = data_sheet_map(VehicleConstants())._replace(understeer_s2pm=0.004)
    bound = limits.steer_bound_of(setup_of(VehicleConstants(), steering=steering, is_bound_by_map=True))
    for speed_mps in (15.0, 27.0):
        steady_rad = wheel_rad(steering, steady_road_wheel_rad(steering, speed_mps, 5.0 / speed_mps**2))
        assert limits.steer_bound(bound, speed_mps) == pytest.approx(steady_rad, rel=2e-3)  # atan(x) for x
    published = limits.steer_bound_of(setup_of(VehicleConstants(), steering=steering))
    assert limits.steer_bound(published, 27.0) == pytest.approx(math.atan(5.0 * 2.8448 / 27.0**2) * 16.0)


def test_oversteer_narrows_no_bound():
    steering = data_sheet_map(VehicleConstants())._replace(understeer_s2pm=-0.002)
    bound = limits.steer_bound_of(setup_of(VehicleConstants(), steering=steering, is_bound_by_map=True))
    assert bound == limits.steer_bound_of(setup_of(VehicleConstants()))


def test_settles_at_the_bound_with_the_filter_behind_it():
    out = run(make(VehicleConstants(steer_rate_radps=math.inf)), [(5.0, 10.0)] * 100)
    assert out[-1] == pytest.approx(math.atan(0.14224) * 16.0)
    assert max(out) > out[-1] * 1.01  # the low-pass behind the clamp overshoots: the order matters


def test_held_near_standstill():
    out = run(make(), [(1.0, 5.0)] * 100 + [(-2.0, 0.08)] * 50 + [(-2.0, 0.082)])
    assert set(out[100:150]) == {out[99]}
    assert out[150] < out[149]


def test_rate_is_the_vehicles():
    out = run(make(VehicleConstants(steer_rate_radps=2.0)), [(6.0, 3.0)] * 100)
    assert max(b - a for a, b in itertools.pairwise(out)) == pytest.approx(0.02)
    free = run(make(VehicleConstants(steer_rate_radps=math.inf)), [(6.0, 3.0)] * 100)
    assert free[10] > 2.0 * out[10]


@given(st.lists(st.tuples(st.floats(-50.0, 50.0), st.floats(0.0, 40.0)), min_size=1, max_size=60))
def test_command_keeps_within_limit_and_rate(inputs):
    out = [0.0, *run(make(), inputs)]
    assert all(abs(value) <= 8.20305 for value in out)
    assert all(abs(b - a) <= 8.55211 * DT_S + 1e-12 for a, b in itertools.pairwise(out))
