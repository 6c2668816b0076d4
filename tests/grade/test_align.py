"""Where a reference begins in a log: moved, late, turned, or without positions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec
from tunefree_hil.episode.recording import Recording, make_recording
from tunefree_hil.episode.scenario import build_course
from tunefree_hil.grade.align import (
    add_longitudinal_reference,
    find_start_by_speed,
    move_course,
    place_course,
    pose_at_start,
)

DT_S = 0.01


def course() -> Course:
    """10 s with a bend and changing speed."""
    return build_course(
        ScenarioSpec(
            schema="tunefree.scenario/1",
            name="test",
            speed=ProfileSpec(t_s=[0.0, 3.0, 6.0, 10.0], value=[5.0, 3.0, 6.0, 4.0]),
            curvature=ProfileSpec(t_s=[0.0, 2.0, 10.0], value=[0.0, 0.05, 0.05]),
        ),
        DT_S,
    )


COURSE = course()


def log(before_s: float, plan: Course = COURSE) -> Recording:
    """The plan driven exactly, after a straight approach of `before_s` at 5 m/s."""
    lead = round(before_s / DT_S)
    at = plan.first_station_m + np.arange(len(plan.path_x_m)) * plan.spacing_m
    station = np.concatenate([-5.0 * DT_S * np.arange(lead, 0, -1), np.asarray(plan.station_m)[: plan.ticks]])
    columns = {
        "x_m": np.interp(station, at, plan.path_x_m),
        "y_m": np.interp(station, at, plan.path_y_m),
        "heading_rad": np.interp(station, at, plan.path_heading_rad),
        "speed_mps": np.concatenate([np.full(lead, 5.0), np.asarray(plan.speed_mps)[: plan.ticks]]),
    }
    return make_recording(columns, DT_S)


def test_a_log_of_ours_begins_with_its_first_tick() -> None:
    placed = place_course(log(0.0), COURSE)
    assert placed.row == 0 and placed.course is COURSE and "first tick" in placed.text


def test_a_log_that_begins_earlier() -> None:
    placed = place_course(log(3.0), COURSE)
    assert placed.row == pytest.approx(300, abs=1) and "begins at 3.00 s" in placed.text
    assert place_course(log(3.0), COURSE, start_s=1.0).row == 100


@given(st.floats(-500.0, 500.0), st.floats(-500.0, 500.0), st.floats(-3.0, 3.0))
def test_a_course_laid_on_a_pose(x_m: float, y_m: float, heading_rad: float) -> None:
    moved = move_course(COURSE, x_m, y_m, heading_rad)
    assert pose_at_start(moved) == pytest.approx((x_m, y_m, heading_rad), abs=1e-9)
    lengths = [np.hypot(np.diff(one.path_x_m), np.diff(one.path_y_m)) for one in (COURSE, moved)]
    np.testing.assert_allclose(*lengths, atol=1e-9)
    assert moved.path_curvature_1pm is COURSE.path_curvature_1pm


def test_a_log_somewhere_else_in_the_world() -> None:
    world = move_course(COURSE, 300.0, -40.0, 2.0)
    placed = place_course(log(0.0, world), COURSE)
    assert placed.row == 0 and "moved to the vehicle's pose at 0.00 s" in placed.text
    np.testing.assert_allclose(placed.course.path_x_m, world.path_x_m, atol=1e-6)
    with pytest.raises(InputError, match=r"never comes nearer"):
        place_course(log(0.0, world), COURSE, align="recorded")
    later = place_course(log(2.0, world), COURSE, align="start", start_s=2.0)
    assert later.row == 200
    np.testing.assert_allclose(later.course.path_y_m, world.path_y_m, atol=1e-6)


def test_a_start_after_the_end() -> None:
    with pytest.raises(InputError, match=r"ends before"):
        place_course(log(0.0), COURSE, align="start", start_s=99.0)


@given(st.integers(0, 400))
def test_without_positions_the_speed_finds_the_start(lead: int) -> None:
    speed = np.concatenate(
        [np.linspace(9.0, 5.0, lead), np.asarray(COURSE.speed_mps)[: COURSE.ticks], np.full(50, 2.0)]
    )
    row, words = find_start_by_speed(speed, COURSE, DT_S)
    assert row == lead and "RMS 0.00 m/s" in words


def test_a_log_that_ends_early_is_found_too() -> None:
    speed = np.concatenate([np.full(100, 8.0), np.asarray(COURSE.speed_mps)[:800]])
    assert find_start_by_speed(speed, COURSE, DT_S)[0] == 100
    with pytest.raises(InputError, match=r"neither positions nor a speed"):
        find_start_by_speed(np.full(10, np.nan), COURSE, DT_S)


@given(st.integers(1, 900), st.integers(500, 1000), st.integers(0, 2**32 - 1))
def test_a_longer_log_that_ends_within_the_plan_is_found_too(lead: int, held: int, seed: int) -> None:
    """Whatever comes before, and though the whole plan would fit into the log, too: with 0.1 m/s of noise."""
    speed = np.concatenate([np.full(lead, 5.0), np.asarray(COURSE.speed_mps)[:held]])
    row, words = find_start_by_speed(speed + np.random.default_rng(seed).normal(0.0, 0.1, len(speed)), COURSE, DT_S)
    assert row == pytest.approx(lead, abs=5)
    assert ("the log ends after" in words) == (len(speed) - row < COURSE.ticks)


@pytest.mark.parametrize("seconds", [5, 6, 7])
def test_a_short_piece_that_fits_by_chance_does_not_win(seconds: int) -> None:
    """The plan's first part again at the log's end, exactly; the whole of it before, 0.3 m/s off, as a car is."""
    plan = np.asarray(COURSE.speed_mps)[: COURSE.ticks]
    off = 0.3 * math.sqrt(2.0) * np.sin(2.0 * math.pi * DT_S * np.arange(len(plan)))
    speed = np.concatenate([np.full(200, 9.0), plan + off, plan[: 100 * seconds]])
    row, words = find_start_by_speed(speed, COURSE, DT_S)
    assert row == pytest.approx(200, abs=5) and "RMS 0.30 m/s)" in words


def test_longitudinal_errors_from_speed_alone() -> None:
    """0.2 m/s too slow throughout: the station error grows by 0.2 m a second."""
    speed: Any = np.asarray(COURSE.speed_mps)[: COURSE.ticks] - 0.2
    found = add_longitudinal_reference(make_recording({"speed_mps": speed}, DT_S), COURSE)
    np.testing.assert_allclose(found.columns["speed_error_mps"], 0.2)
    np.testing.assert_allclose(found.columns["station_error_m"], 0.2 * DT_S * np.arange(COURSE.ticks), atol=0.01)
    assert found.get("lateral_error_m") is None and found.get("replan") is None
