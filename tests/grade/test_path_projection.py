"""Feet in bulk against the follower's kernel, one by one: whatever the vehicle does beside the path."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.grade.straight import straight
from tunefree_hil.base.course import Course
from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec
from tunefree_hil.control.path import cell_of, make_path, project
from tunefree_hil.episode.recording import make_recording
from tunefree_hil.episode.scenario import build_course
from tunefree_hil.grade.path_projection import course_arrays, estimate_stations, project_points, rear_axle_stations

DT_S = 0.01


def bends() -> Course:
    """A U-turn of 7 m radius, a stop, a bend back."""
    spec = ScenarioSpec(
        schema="tunefree.scenario/1",
        name="bends",
        speed=ProfileSpec(t_s=[0, 6, 8, 9, 11, 16], value=[4.0, 4.0, 0.0, 0.0, 5.0, 5.0]),
        curvature=ProfileSpec(t_s=[0, 1, 2, 5, 6, 10, 12, 14, 16], value=[0, 0, 0.14, 0.14, 0, 0, -0.1, 0.05, 0]),
    )
    return build_course(spec, DT_S)


COURSE = bends()
TABLES = course_arrays(COURSE)


def weave(side_m: float, omega_radps: float, late_m: float, ahead_m: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Points beside the path, a row a tick."""
    where = COURSE.first_station_m + np.arange(len(COURSE.path_x_m)) * COURSE.spacing_m
    time = np.arange(COURSE.ticks) * DT_S
    station = np.asarray(COURSE.station_m[:-1]) - late_m * np.minimum(time / 4.0, 1.0) + ahead_m
    heading, side = np.interp(station, where, COURSE.path_heading_rad), side_m * np.sin(omega_radps * time)
    x = np.interp(station, where, COURSE.path_x_m) - side * np.sin(heading)
    return x, np.interp(station, where, COURSE.path_y_m) + side * np.cos(heading)


def one_by_one(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The same feet by the kernel that the follower uses."""
    path, found = make_path(COURSE), []
    cell = cell_of(path, 0.0)
    for point in zip(x.tolist(), y.tolist(), strict=True):
        foot = project(path, cell, *point)
        cell = foot.cell
        found.append((foot.station_m, foot.heading_rad, foot.curvature_1pm, foot.lateral_m))
    return np.array(found)


@settings(max_examples=15, deadline=None)
@given(side_m=st.floats(-2.5, 2.5), omega_radps=st.floats(0.1, 2.0), late_m=st.floats(-3.0, 3.0))
def test_feet_are_those_of_the_follower(side_m: float, omega_radps: float, late_m: float) -> None:
    x, y = weave(side_m, omega_radps, late_m)
    np.testing.assert_allclose(np.stack(project_points(TABLES, x, y), axis=1), one_by_one(x, y), atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(side_m=st.floats(-2.5, 2.5), omega_radps=st.floats(0.1, 2.0), first=st.integers(0, 1599))
def test_where_the_search_starts_changes_no_bit(side_m: float, omega_radps: float, first: int) -> None:
    """The middle's feet are looked for from the rear axle's, and only from the first re-plan on."""
    x, y = weave(side_m, omega_radps, 0.5, ahead_m=1.4)
    whole = np.stack(project_points(TABLES, x, y), axis=1)
    rear = estimate_stations(TABLES, *weave(side_m, omega_radps, 0.5))
    part = np.stack(project_points(TABLES, x, y, rear + 1.4, first), axis=1)
    np.testing.assert_array_equal(part[first:], whole[first:])
    assert np.isnan(part[:first]).all()


def test_what_is_not_known_stays_unknown() -> None:
    x, y = weave(0.5, 0.7, 0.0)
    x[:7] = math.nan
    y[500] = math.inf
    known = np.isfinite(x + y)
    feet = np.stack(project_points(TABLES, x, y), axis=1)
    assert np.isnan(feet[~known]).all()
    np.testing.assert_allclose(feet[known], one_by_one(x[known], y[known]), atol=1e-9)
    nothing = np.full(9, math.nan)
    assert np.isnan(np.stack(project_points(TABLES, nothing, nothing))).all()
    np.testing.assert_array_equal(estimate_stations(TABLES, nothing, nothing), np.zeros(9))


def test_stations_of_a_straight_drive() -> None:
    course = straight(5.0)
    x = 0.05 * np.arange(course.ticks)
    recording = make_recording({"x_m": x, "y_m": 0.0 * x + 0.3}, DT_S)
    stations = rear_axle_stations(recording, course)
    assert stations is not None
    np.testing.assert_allclose(stations, x, atol=1e-9)
    assert rear_axle_stations(make_recording({"speed_mps": x}, DT_S), course) is None


def test_a_course_is_made_into_arrays_once() -> None:
    tables = course_arrays(COURSE)  # others may have been kept since the module's own were made
    assert course_arrays(COURSE) is tables
    assert pytest.approx(COURSE.ticks * DT_S) == tables.plan_s[-1]
