"""Projection on the path table."""

from __future__ import annotations

import math

import pytest

from tunefree_hil.control.path import cell_of, heading_at, make_path, project

RADIUS_M = 12.0


@pytest.fixture
def circle(kit):
    """A left-hand circle about (0, 12) from station 0."""
    return make_path(kit.course(20.0, lambda t: 3.0, lambda station: 1.0 / RADIUS_M))


def beside(station_m, lateral_m):
    """The point `lateral_m` to the left of the circle at a station."""
    angle = station_m / RADIUS_M
    radius = RADIUS_M - lateral_m
    return radius * math.sin(angle), RADIUS_M - radius * math.cos(angle)


@pytest.mark.parametrize("lateral_m", [0.0, 0.5, -0.5, 2.0, -2.0])
def test_foot_on_a_circle_is_exact(circle, lateral_m):
    cell = cell_of(circle, 0.0)
    for i in range(1, 1500):
        station_m = 0.031 * i
        foot = project(circle, cell, *beside(station_m, lateral_m))
        cell = foot.cell
        assert foot.lateral_m == pytest.approx(lateral_m, abs=1e-6)
        assert foot.station_m == pytest.approx(station_m, abs=1e-6)
        assert foot.heading_rad == pytest.approx(station_m / RADIUS_M, abs=1e-6)
        assert foot.curvature_1pm == pytest.approx(1.0 / RADIUS_M)


def test_foot_is_continuous_where_curvature_changes(kit):
    path = make_path(kit.course(8.0, lambda t: 5.0, lambda s: 0.1 * math.sin(s / 2.0) + (0.03 if s > 20.0 else 0.0)))
    cell, last, last_point = cell_of(path, 0.0), None, (0.0, 0.0)
    for i in range(16000):
        # A smooth line that winds about the path in steps of a few millimetres.
        at = 0.025 * i
        node, share = math.floor(at), at - math.floor(at)
        side_m = 0.8 * math.sin(0.1 * at)
        here, after = 200 + node, 201 + node
        x_m = path.x_m[here] + share * (path.x_m[after] - path.x_m[here]) - side_m * math.sin(path.heading_rad[here])
        y_m = path.y_m[here] + share * (path.y_m[after] - path.y_m[here]) + side_m * math.cos(path.heading_rad[here])
        foot = project(path, cell, x_m, y_m)
        cell = foot.cell
        if last is not None:
            moved_m = math.dist((x_m, y_m), last_point)
            assert abs(foot.station_m - last.station_m) < 1.3 * moved_m + 1e-6
            assert abs(foot.lateral_m - last.lateral_m) < 1.1 * moved_m + 1e-6
            assert abs(foot.heading_rad - last.heading_rad) < 0.2 * moved_m + 1e-6
        last, last_point = foot, (x_m, y_m)


def test_beyond_the_ends_it_goes_straight_on(kit):
    path = make_path(kit.course(5.0, lambda t: 2.0))
    before, after = project(path, 0, -30.0, 1.0), project(path, cell_of(path, 29.0), 35.0, -1.0)
    assert (before.station_m, before.lateral_m) == (pytest.approx(-30.0), pytest.approx(1.0))
    assert (after.station_m, after.lateral_m) == (pytest.approx(35.0), pytest.approx(-1.0))


def test_u_turn_keeps_the_branch_that_is_driven(kit):
    # Out for 20 m, half a circle of radius 2 m, back 4 m beside the way out.
    length_m = 2.0 * math.pi
    course = kit.course(23.0, lambda t: 2.0, lambda s: 0.5 if 20.0 <= s < 20.0 + length_m else 0.0)
    path = make_path(course)
    cell = cell_of(path, 0.0)
    for i in range(2000):
        foot = project(path, cell, 0.01 * i, 1.9)  # almost half way to the way back
        cell = foot.cell
        assert foot.station_m == pytest.approx(0.01 * i, abs=1e-6)
        assert foot.lateral_m == pytest.approx(1.9, abs=1e-3)  # the table smears the step of curvature
    back = project(path, cell_of(path, 36.0), 10.5, 2.2)
    assert back.station_m > 35.0
    assert back.lateral_m == pytest.approx(1.8, abs=0.01)


def test_walk_is_bounded(kit):
    path = make_path(kit.course(30.0, lambda t: 5.0))
    assert project(path, 100, 100.0, 0.0).cell == 100 + path.walk_cells


def test_heading_at_a_station(circle):
    assert heading_at(circle, 6.05)[0] == pytest.approx(6.05 / RADIUS_M)
    assert heading_at(circle, -100.0) == (circle.heading_rad[0], circle.curvature_1pm[0])
    assert heading_at(circle, 1000.0) == (circle.heading_rad[-1], circle.curvature_1pm[-1])
    assert cell_of(circle, -100.0) == 0
    assert cell_of(circle, 1000.0) == len(circle.x_m) - 2
