"""Where and when in a log the reference begins: said in words, because every error depends on it."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import table
from tunefree_hil.episode.recording import Recording, make_recording

Array = np.ndarray
Align = Literal["auto", "recorded", "start"]

NEAR_M = 3.0  # a first fix this near to the path's start (and NEAR_RAD) counts as given in the path's coordinates
NEAR_RAD = 0.5
AT_START_M = 1.0  # a log whose first fix is this near to station 0 begins with the reference
LEAST_OVERLAP = 0.5  # of the plan that a log without INS must hold


class Placed(NamedTuple):
    """The course in the log's coordinates, the row of the log at which it begins, and how both were found."""

    course: Course
    row: int
    words: str


def place_course(
    recording: Recording, course: Course, *, align: Align = "auto", start_s: float | None = None
) -> Placed:
    """Find the start of `course` in a log of positions. start_s: where a person says it is, seconds into the log.

    'recorded': the path's coordinates are the log's. 'start': the path is laid with its beginning at the pose at which
    it begins, so the first errors are 0 by choice. 'auto': recorded where the first fix is near the path's start.
    Raises InputError where the log never comes near the path.
    """
    fixes = _fixes(recording)
    first = int(np.flatnonzero(fixes)[0])
    row = first if start_s is None else round(start_s / recording.dt_s)
    if align == "auto":
        align = "recorded" if _is_near(recording, course, first) else "start"
    if align == "start":
        row = _first_fix_from(fixes, row)
        moved = move_course(course, *(float(recording.columns[name][row]) for name in ("x_m", "y_m", "heading_rad")))
        where = f"the path is laid on the vehicle's pose at {row * recording.dt_s:.2f} s of the log"
        return Placed(moved, _whole_from(row, first, start_s), where + ": the first errors are 0 by choice")
    if start_s is not None:
        return Placed(course, row, f"path as recorded, started at {start_s:g} s of the log as asked for")
    row, words = _passing(recording, course, first)
    return Placed(course, row, f"path as recorded; {words}")


def _fixes(recording: Recording) -> Array:
    found = np.isfinite(sum(recording.columns[name] for name in ("x_m", "y_m", "heading_rad")))
    if not found.any():
        raise InputError("the INS never gives a whole position", code="no_position", hint="grade it without")
    return found


def _first_fix_from(fixes: Array, row: int) -> int:
    rows = np.flatnonzero(fixes)
    later = rows[rows >= row]
    if len(later) == 0:
        raise InputError("the log ends before its start", code="bad_start", key="--start-s", hint="give a smaller one")
    return int(later[0])


def _whole_from(row: int, first: int, start_s: float | None) -> int:
    """The log's own beginning where its first fix is the start: nothing of it is thrown away."""
    return 0 if start_s is None and row == first else row


def _is_near(recording: Recording, course: Course, row: int) -> bool:
    """Whether the pose of a row is near to station 0 of the path, or any pose is (a log that begins before it)."""
    x0, y0, heading0 = origin_of(course)
    x, y, heading = (recording.columns[name] for name in ("x_m", "y_m", "heading_rad"))
    with np.errstate(invalid="ignore"):
        turn = np.abs(np.arctan2(np.sin(heading - heading0), np.cos(heading - heading0)))
        near = (np.hypot(x - x0, y - y0) < NEAR_M) & (turn < NEAR_RAD)
    return bool(near[row:].any())


def _passing(recording: Recording, course: Course, first: int) -> tuple[int, str]:
    """The row at which the rear axle passes station 0."""
    x0, y0, _ = origin_of(course)
    distance = np.hypot(recording.columns["x_m"] - x0, recording.columns["y_m"] - y0)
    if distance[first] < AT_START_M:
        return 0, "it begins with the log's first tick"
    near = np.flatnonzero(distance < NEAR_M)
    if len(near) == 0:
        raise InputError(
            f"the vehicle never comes nearer than {np.nanmin(distance):.1f} m to the path's beginning",
            code="not_on_path",
            key="--path",
            hint="are its coordinates those of the INS? --align start lays the path on the vehicle's first pose",
        )
    spell = near[: int(np.argmax(np.append(np.diff(near) > 1, True))) + 1]
    row = int(spell[np.argmin(distance[spell])])
    return row, f"it begins at {row * recording.dt_s:.2f} s of the log, {distance[row]:.2f} m from station 0"


def origin_of(course: Course) -> tuple[float, float, float]:
    """(x, y, heading) of the path at station 0."""
    i = round(-course.first_station_m / course.spacing_m)
    return float(course.path_x_m[i]), float(course.path_y_m[i]), float(course.path_heading_rad[i])


def move_course(course: Course, x_m: float, y_m: float, heading_rad: float) -> Course:
    """The course with its path turned and shifted so that station 0 has this pose."""
    x0, y0, heading0 = origin_of(course)
    turn = heading_rad - heading0
    cos, sin = math.cos(turn), math.sin(turn)
    x, y = np.asarray(course.path_x_m) - x0, np.asarray(course.path_y_m) - y0
    return course._replace(
        path_x_m=table(x_m + cos * x - sin * y),
        path_y_m=table(y_m + sin * x + cos * y),
        path_heading_rad=table(np.asarray(course.path_heading_rad) + turn),
    )


def find_by_speed(speed_mps: Array, course: Course, dt_s: float) -> tuple[int, str]:
    """The row of a log without positions at which the plan's speed fits best, and words that say how well.

    Of all starts at which at least half of the plan lies within the log, those count at which the mean square
    difference is less than a tick earlier and later. Among them, what the log does not hold of the plan counts as
    missed by the plan's own scatter, which is what a guess of its mean would miss: so a short piece that happens to fit
    does not win. Raises InputError for a log without speed.
    """
    plan = np.asarray(course.speed_mps)[: course.ticks]
    known = np.flatnonzero(np.isfinite(speed_mps))
    if len(known) == 0:
        raise InputError("the log has neither positions nor a speed", code="nothing_to_align", key="--path")
    filled = np.interp(np.arange(len(speed_mps)), known, speed_mps[known])
    least = max(1, math.ceil(min(LEAST_OVERLAP * len(plan), len(filled))))
    scatter = float(np.var(plan))
    squares, shares = _fit_from_each_row(filled, plan, len(filled) - least + 1)
    around = np.concatenate([[math.inf], squares, [math.inf]])
    least_here = (squares <= around[:-2]) & (squares <= around[2:])
    row = int(np.argmin(np.where(least_here, shares * squares + (1.0 - shares) * scatter, math.inf)))
    held = "" if shares[row] >= 1.0 else f", the log ends after {math.floor(100.0 * shares[row])} % of the plan"
    return (
        row,
        f"no positions: the start was found by the speed, {row * dt_s:.2f} s into the log"
        f" (RMS {math.sqrt(squares[row]):.2f} m/s{held})",
    )


def _fit_from_each_row(speed_mps: Array, plan_mps: Array, starts: int) -> tuple[Array, Array]:
    """For the plan begun at each of the first `starts` rows: mean square difference, share of the plan in the log."""
    squares, shares = np.empty(starts), np.empty(starts)
    for row in range(starts):
        heard = speed_mps[row : row + len(plan_mps)]
        missed = heard - plan_mps[: len(heard)]
        squares[row], shares[row] = np.mean(missed * missed), len(heard) / len(plan_mps)
    return squares, shares


def longitudinal_only(recording: Recording, course: Course) -> Recording:
    """Adds what a plan by time says of a drive without positions: references, speed error, station error by odometry.

    The station error begins at 0 and runs with the speed signal's scale, which is said beside it.
    """
    rows = recording.ticks
    at = np.minimum(np.arange(rows), course.ticks)
    columns = {name: values for name, values in recording.columns.items() if name not in ("t_s", "tick", "replan")}
    ref_speed = np.asarray(course.speed_mps)[at]
    first = course.first_station_m + np.arange(len(course.path_curvature_1pm)) * course.spacing_m
    columns |= {"ref_speed_mps": ref_speed, "ref_accel_mps2": np.asarray(course.accel_mps2)[at]}
    station = np.asarray(course.station_m)[at]
    columns["ref_curvature_1pm"] = np.interp(station, first, np.asarray(course.path_curvature_1pm))
    speed = recording.get("speed_mps")
    if speed is not None:
        gone = np.concatenate([[0.0], np.nancumsum(0.5 * (speed[1:] + speed[:-1]) * recording.dt_s)])
        columns |= {"speed_error_mps": ref_speed - speed, "station_error_m": station - gone}
    return make_recording(columns, recording.dt_s, dict(recording.instead))
