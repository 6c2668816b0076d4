"""Align a log with its reference: in which row, and where on the ground, the reference path begins."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import table
from tunefree_hil.episode.recording import Recording, make_recording

Array = np.ndarray
AlignMode = Literal["auto", "recorded", "start"]


class AlignmentCriteria(NamedTuple):
    """Thresholds of the alignment (docs/reference/grading.md)."""

    near_m: float = 3.0  # distance to the path's start within which a log counts as given in the path's coordinates
    near_rad: float = 0.5  # and the difference of heading there
    at_start_m: float = 1.0  # a log whose first fix is this near to station 0 begins with the reference
    min_overlap: float = 0.5  # share of the plan that a log without positions must contain


CRITERIA = AlignmentCriteria()


class PlacedCourse(NamedTuple):
    """The course in the log's coordinates, the row of the log at which it begins, and how both were found."""

    course: Course
    row: int
    text: str


class PathPose(NamedTuple):
    """Position and heading of a point of a path."""

    x_m: float
    y_m: float
    heading_rad: float


def place_course(
    recording: Recording, course: Course, *, align: AlignMode = "auto", start_s: float | None = None
) -> PlacedCourse:
    """Find the start of a course in a log with positions.

    Args:
        align: 'recorded': the path has the log's coordinates. 'start': the path is moved to the vehicle's pose at its
            start, so the first errors are 0 by definition. 'auto': 'recorded' where the log passes the path's start.
        start_s: start given by the user, in seconds from the first frame of the log.

    Raises:
        InputError: The log never comes near the path.
    """
    fixes = _find_fixes(recording)
    first = int(np.flatnonzero(fixes)[0])
    row = first if start_s is None else round(start_s / recording.dt_s)
    if align == "auto":
        align = "recorded" if _starts_near_path(recording, course, first) else "start"
    if align == "start":
        row = _first_fix_after(fixes, row)
        moved = move_course(course, *(float(recording.columns[name][row]) for name in ("x_m", "y_m", "heading_rad")))
        text = f"the path is moved to the vehicle's pose at {row * recording.dt_s:.2f} s of the log"
        return PlacedCourse(moved, _start_row(row, first, start_s), text + ": the first errors are 0 by definition")
    if start_s is not None:
        return PlacedCourse(course, row, f"path as recorded, started at {start_s:g} s of the log (--start-s)")
    row, text = _row_at_path_start(recording, course, first)
    return PlacedCourse(course, row, f"path as recorded; {text}")


def _find_fixes(recording: Recording) -> Array:
    fixes = np.isfinite(sum(recording.columns[name] for name in ("x_m", "y_m", "heading_rad")))
    if not fixes.any():
        hint = "grade it without positions"
        raise InputError("the INS never reports a complete position", code="no_position", hint=hint)
    return fixes


def _first_fix_after(fixes: Array, row: int) -> int:
    rows = np.flatnonzero(fixes)
    later = rows[rows >= row]
    if len(later) == 0:
        raise InputError("the log ends before its start", code="bad_start", key="--start-s", hint="give a smaller one")
    return int(later[0])


def _start_row(row: int, first: int, start_s: float | None) -> int:
    """Row 0 where the first fix is the start, so that no row of the log is dropped."""
    return 0 if start_s is None and row == first else row


def _starts_near_path(recording: Recording, course: Course, row: int) -> bool:
    """Whether the vehicle passes station 0 of the path from this row on."""
    x0, y0, heading0 = pose_at_start(course)
    x, y, heading = (recording.columns[name] for name in ("x_m", "y_m", "heading_rad"))
    with np.errstate(invalid="ignore"):
        turn = np.abs(np.arctan2(np.sin(heading - heading0), np.cos(heading - heading0)))
        near = (np.hypot(x - x0, y - y0) < CRITERIA.near_m) & (turn < CRITERIA.near_rad)
    return bool(near[row:].any())


def _row_at_path_start(recording: Recording, course: Course, first: int) -> tuple[int, str]:
    """The row at which the rear axle passes station 0."""
    x0, y0, _ = pose_at_start(course)
    distance = np.hypot(recording.columns["x_m"] - x0, recording.columns["y_m"] - y0)
    if distance[first] < CRITERIA.at_start_m:
        return 0, "it begins with the log's first tick"
    near = np.flatnonzero(distance < CRITERIA.near_m)
    if len(near) == 0:
        raise InputError(
            f"the vehicle never comes nearer than {np.nanmin(distance):.1f} m to the start of the path",
            code="not_on_path",
            key="--path",
            hint="does the path use the INS coordinates? --align start moves the path to the vehicle's first pose",
        )
    passage = near[: int(np.argmax(np.append(np.diff(near) > 1, True))) + 1]
    row = int(passage[np.argmin(distance[passage])])
    return row, f"it begins at {row * recording.dt_s:.2f} s of the log, {distance[row]:.2f} m from station 0"


def pose_at_start(course: Course) -> PathPose:
    """Pose of the path at station 0."""
    i = round(-course.first_station_m / course.spacing_m)
    return PathPose(float(course.path_x_m[i]), float(course.path_y_m[i]), float(course.path_heading_rad[i]))


def move_course(course: Course, x_m: float, y_m: float, heading_rad: float) -> Course:
    """The course with its path turned and shifted so that station 0 has this pose."""
    x0, y0, heading0 = pose_at_start(course)
    turn = heading_rad - heading0
    cos, sin = math.cos(turn), math.sin(turn)
    x, y = np.asarray(course.path_x_m) - x0, np.asarray(course.path_y_m) - y0
    return course._replace(
        path_x_m=table(x_m + cos * x - sin * y),
        path_y_m=table(y_m + sin * x + cos * y),
        path_heading_rad=table(np.asarray(course.path_heading_rad) + turn),
    )


def find_start_by_speed(speed_mps: Array, course: Course, dt_s: float) -> tuple[int, str]:
    """Find the row of a log without positions at which the planned speed fits best.

    Candidates are local minima of the mean square difference, with at least half of the plan inside the log. The part
    of the plan after the end of the log counts with the variance of the planned speed, so that a short piece that fits
    by chance does not win.

    Returns:
        The row, and a text with the quality of the fit.

    Raises:
        InputError: The log has no speed.
    """
    plan = np.asarray(course.speed_mps)[: course.ticks]
    known = np.flatnonzero(np.isfinite(speed_mps))
    if len(known) == 0:
        raise InputError("the log has neither positions nor a speed", code="nothing_to_align", key="--path")
    filled = np.interp(np.arange(len(speed_mps)), known, speed_mps[known])
    min_rows = max(1, math.ceil(min(CRITERIA.min_overlap * len(plan), len(filled))))
    variance = float(np.var(plan))
    squares, shares = _fit_speed_at_each_row(filled, plan, len(filled) - min_rows + 1)
    padded = np.concatenate([[math.inf], squares, [math.inf]])
    is_minimum = (squares <= padded[:-2]) & (squares <= padded[2:])
    row = int(np.argmin(np.where(is_minimum, shares * squares + (1.0 - shares) * variance, math.inf)))
    part = "" if shares[row] >= 1.0 else f", the log ends after {math.floor(100.0 * shares[row])} % of the plan"
    return (
        row,
        f"no positions: the start was found by the speed, {row * dt_s:.2f} s into the log"
        f" (RMS {math.sqrt(squares[row]):.2f} m/s{part})",
    )


def _fit_speed_at_each_row(speed_mps: Array, plan_mps: Array, starts: int) -> tuple[Array, Array]:
    """Mean square difference and share of the plan inside the log, for a start at each of the first `starts` rows."""
    squares, shares = np.empty(starts), np.empty(starts)
    for row in range(starts):
        measured = speed_mps[row : row + len(plan_mps)]
        error = measured - plan_mps[: len(measured)]
        squares[row], shares[row] = np.mean(error * error), len(measured) / len(plan_mps)
    return squares, shares


def add_longitudinal_reference(recording: Recording, course: Course) -> Recording:
    """Add references, speed error and station error to a drive without positions.

    The station error is the integral of the speed error from 0, so it contains the scale error of the speed signal.
    """
    ticks = np.minimum(np.arange(recording.ticks), course.ticks)
    columns = {name: values for name, values in recording.columns.items() if name not in ("t_s", "tick", "replan")}
    ref_speed = np.asarray(course.speed_mps)[ticks]
    path_m = course.first_station_m + np.arange(len(course.path_curvature_1pm)) * course.spacing_m
    columns |= {"ref_speed_mps": ref_speed, "ref_accel_mps2": np.asarray(course.accel_mps2)[ticks]}
    station = np.asarray(course.station_m)[ticks]
    columns["ref_curvature_1pm"] = np.interp(station, path_m, np.asarray(course.path_curvature_1pm))
    speed = recording.get("speed_mps")
    if speed is not None:
        distance = np.concatenate([[0.0], np.nancumsum(0.5 * (speed[1:] + speed[:-1]) * recording.dt_s)])
        columns |= {"speed_error_mps": ref_speed - speed, "station_error_m": station - distance}
    return make_recording(columns, recording.dt_s, dict(recording.instead))
