"""The area: room ahead, whole circles, and the corner to aim at, each against walking it step by step."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tunefree_hil.collect.area import DrivingArea, Pose, bearing_rad, farthest_corner, is_circle_inside, room_m
from tunefree_hil.collect.envelope import BORDER_M

GROUND = DrivingArea(30.0, -20.0, 100.0)
INNER = 100.0 - BORDER_M
places = st.builds(Pose, st.floats(-59.0, 119.0), st.floats(-109.0, 69.0), st.floats(-math.pi, math.pi))


def inside(x_m: float, y_m: float) -> bool:
    return max(abs(x_m - GROUND.x_m), abs(y_m - GROUND.y_m)) <= INNER


@given(places)
def test_the_room_ahead_ends_at_the_inner_border(pose: Pose) -> None:
    room = room_m(GROUND, pose)
    ahead = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    assert inside(pose.x_m + 0.999 * room * ahead[0], pose.y_m + 0.999 * room * ahead[1])
    assert not inside(pose.x_m + (1.001 * room + 0.01) * ahead[0], pose.y_m + (1.001 * room + 0.01) * ahead[1])


def test_beyond_the_border_there_is_no_room_outwards_and_all_of_it_inwards() -> None:
    assert room_m(GROUND, Pose(30.0 + INNER + 2.0, -20.0, 0.0)) == pytest.approx(-2.0)
    assert room_m(GROUND, Pose(30.0 + INNER + 2.0, -20.0, math.pi)) == pytest.approx(2.0 * INNER + 2.0)


@given(places, st.floats(-0.15, 0.15))
def test_a_circle_that_fits_stays_inside_all_the_way_round(pose: Pose, curvature: float) -> None:
    assume(abs(curvature) > 0.005)
    fits = is_circle_inside(GROUND, pose, curvature)
    radius = 1.0 / curvature
    turns = [0.02 * math.pi * i for i in range(100)]
    around = [
        (
            pose.x_m + radius * (math.sin(pose.heading_rad + turn) - math.sin(pose.heading_rad)),
            pose.y_m - radius * (math.cos(pose.heading_rad + turn) - math.cos(pose.heading_rad)),
        )
        for turn in turns
    ]
    if fits:
        assert all(inside(*place) for place in around)
    elif abs(radius) < 15.0:
        assert not all(
            inside(x + 10.0 * dx, y + 10.0 * dy) for x, y in around for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))
        )


@given(places)
def test_the_far_corner_lies_inside_and_no_other_is_farther(pose: Pose) -> None:
    x, y = farthest_corner(GROUND, pose)
    assert inside(x, y)
    others = [(GROUND.x_m + a * (x - GROUND.x_m), GROUND.y_m + b * (y - GROUND.y_m)) for a in (-1, 1) for b in (-1, 1)]
    assert math.dist((x, y), pose[:2]) >= max(math.dist(one, pose[:2]) for one in others) - 1e-9
    assert math.cos(bearing_rad(pose, x, y)) * (x - pose.x_m) >= 0.0
