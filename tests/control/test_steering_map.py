"""Steering map: the data sheet's terms, odd and continuous, its inverse to axle stiffness, dead zone and offset."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.control.contract import VehicleConstants
from tunefree_hil.control.steering_map import (
    SteeringMap,
    data_sheet_map,
    odd_cubic,
    steady_road_wheel_rad,
    stiffness_of,
    wheel_rad,
    with_geometry,
)

MKZ = VehicleConstants()
SOFT_FRONT = MKZ._replace(front_stiffness_n_per_rad=110_000.0)


def test_the_data_sheet_map_is_eq_3():
    steering = data_sheet_map(SOFT_FRONT)
    load = SOFT_FRONT.mass_kg / SOFT_FRONT.wheelbase_m
    gradient = load * (SOFT_FRONT.rear_axle_m / 110_000.0 - SOFT_FRONT.front_axle_m / 155494.663)
    for speed, curvature in ((3.0, 0.1), (15.0, -0.01), (30.0, 0.003)):
        expected = (2.8448 + gradient * speed * speed) * curvature
        assert steady_road_wheel_rad(steering, speed, curvature) == pytest.approx(expected, rel=1e-12)


def test_stiffness_comes_back_from_the_map():
    assert stiffness_of(data_sheet_map(SOFT_FRONT), SOFT_FRONT) == pytest.approx((110_000.0, 155494.663))
    odd = data_sheet_map(MKZ)._replace(rear_slip_s2pm=-0.001)
    assert stiffness_of(odd, MKZ) == (MKZ.front_stiffness_n_per_rad, MKZ.rear_stiffness_n_per_rad)


@pytest.mark.parametrize("radius_m", [5.5, 8.0, 15.0, 60.0])
def test_the_geometry_is_that_of_a_wheel_about_its_axle(radius_m):
    exact = math.atan(2.8448 / math.sqrt(radius_m * radius_m - 1.4224 * 1.4224))
    assert steady_road_wheel_rad(with_geometry(data_sheet_map(MKZ)), 0.0, 1.0 / radius_m) == pytest.approx(
        exact, rel=0.01
    )


@given(st.floats(-3.0, 3.0), st.floats(-1.0, 1.0), st.floats(0.0, 2.0), st.floats(0.1, 3.0))
def test_the_cubic_is_odd_and_goes_on_straight(x, cubic, bound, slope):
    value = odd_cubic(x, slope, cubic, bound)
    assert value == pytest.approx(-odd_cubic(-x, slope, cubic, bound), abs=1e-12)
    if abs(x) <= bound:
        assert value == pytest.approx(slope * x + cubic * x * x * x, abs=1e-9)
    else:
        step = math.copysign(0.5, x)
        grown = odd_cubic(x + step, slope, cubic, bound) - value
        assert grown == pytest.approx(step * (slope + 3.0 * cubic * bound * bound), abs=1e-9)


def test_offset_and_dead_zone_act_at_the_steering_wheel():
    steering: SteeringMap = data_sheet_map(MKZ)._replace(offset_rad=0.05, dead_zone_rad=0.02)
    assert wheel_rad(steering, 0.0) == pytest.approx(0.05)
    assert wheel_rad(steering, 0.1) == pytest.approx(1.6 + 0.02 + 0.05)
    assert wheel_rad(steering, -0.1) == pytest.approx(-1.6 - 0.02 + 0.05)
    near = [wheel_rad(steering, angle / 1e4) for angle in range(-40, 41)]
    steps = [after - before for before, after in itertools.pairwise(near)]
    assert max(steps) < 2.0 * min(steps)  # no step that would shake the wheel on a straight
