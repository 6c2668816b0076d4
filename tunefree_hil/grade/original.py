"""Errors against the *original* path, whatever was re-planned on the way (design D11), from the columns and the course.

Until the first re-plan the current trajectory is the original one, so the columns are taken as they are. From then on:
lateral and heading error against the path itself; station and speed against the plan, whose clock and station are set
to where the vehicle is at each re-plan (it need not catch up) but which is not blended from the measured speed. Speed
along the path and yaw rate are the ones that the follower saw (the INS's), read back from its columns. The foot of a
point is defined as in control/path.py (there tick by tick, here all rows at once, to 1e-9 m the same), the plan's clock
is set by control/schedule.py itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.control.follower import SHRINK_FLOOR
from tunefree_hil.control.schedule import Schedule, station_at, time_of
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.kept import Kept
from tunefree_hil.grade.metrics import Samples, samples_of

Array = np.ndarray

STRIDE = 20  # rows between the feet that are looked for one after the other
NEWTON_STEPS = 4
WALK_STEPS = 6
LEAST_COS = 1e-3


class Feet(NamedTuple):
    """Feet of points on the path: arrays, one element a row."""

    station_m: Array
    heading_rad: Array
    curvature_1pm: Array
    lateral_m: Array


class _Tables(NamedTuple):
    """A course as arrays: the path by station, the plan by time."""

    first_m: float
    spacing_m: float
    x_m: Array
    y_m: Array
    heading_rad: Array
    curvature_1pm: Array
    cos: Array
    sin: Array
    nodes: list[tuple[float, float, float, float]]  # x, y, cos, sin, for what is looked up one by one
    plan_s: Array
    plan_station_m: Array
    plan_speed_mps: Array
    plan_accel_mps2: Array


def samples_against_original(recording: Recording, course: Course, rear_axle_m: float) -> Samples:
    """As samples_of, but against the original path. rear_axle_m: rear axle (INS point) to centre of mass.

    Where position or an error against the current trajectory could not be had, the errors that need it are None after
    a re-plan.
    """
    current = samples_of(recording)
    replan = recording.get("replan")
    anchors = np.flatnonzero(replan > 0.5) if replan is not None else np.empty(0, dtype=int)
    if len(anchors) == 0:
        return current
    if not {"x_m", "y_m", "heading_rad"} <= recording.columns.keys():
        return current._replace(**dict.fromkeys(_ERRORS))
    first = int(anchors[0]) + 1  # at the tick of a re-plan the errors are still against the old trajectory
    again = _recompute(recording, course, rear_axle_m, anchors)
    joined = {name: _join(getattr(current, name), getattr(again, name), first) for name in (*_ERRORS, *_REFERENCES)}
    return current._replace(**joined)


_ERRORS = (
    "station_error_m",
    "speed_error_mps",
    "lateral_error_m",
    "lateral_error_rate_mps",
    "heading_error_rad",
    "heading_error_rate_radps",
)
_REFERENCES = ("ref_speed_mps", "ref_accel_mps2", "ref_curvature_1pm")


def _join(before: Array | None, after: Array | None, first: int) -> Array | None:
    return None if before is None or after is None else np.concatenate([before[:first], after[first:]])


def _recompute(recording: Recording, course: Course, rear_axle_m: float, anchors: Array) -> Samples:
    """All rows from the first re-plan on against the original path and the plan as it was re-anchored."""
    x, y, heading = (recording.columns[name] for name in ("x_m", "y_m", "heading_rad"))
    tables, first = tables_of(course), int(anchors[0])
    near_m = near_stations(tables, x, y)
    rear = find_feet(tables, x, y, near_m, first)
    ahead_x, ahead_y = rear_axle_m * np.cos(heading), rear_axle_m * np.sin(heading)
    mass = find_feet(tables, x + ahead_x, y + ahead_y, near_m + rear_axle_m, first)
    shift_s, offset_m = _clock(course, rear.station_m, anchors)
    plan_s = np.arange(recording.ticks) * course.dt_s - shift_s
    ref_speed = np.interp(plan_s, tables.plan_s, tables.plan_speed_mps)
    beyond_m = np.maximum(plan_s - tables.plan_s[-1], 0.0) * tables.plan_speed_mps[-1]
    ref_station = np.interp(plan_s, tables.plan_s, tables.plan_station_m) + beyond_m + offset_m
    current = samples_of(recording)
    along, yaw_rate = _seen(current)
    heading_error = _wrap(heading - mass.heading_rad)
    return current._replace(
        ref_speed_mps=ref_speed,
        ref_accel_mps2=np.interp(plan_s, tables.plan_s, tables.plan_accel_mps2),
        ref_curvature_1pm=mass.curvature_1pm,
        station_error_m=ref_station - rear.station_m,
        speed_error_mps=None if along is None else ref_speed - along,
        lateral_error_m=mass.lateral_m,
        lateral_error_rate_mps=None if along is None else _speed(along, rear, heading) * np.sin(heading_error),
        heading_error_rad=heading_error,
        heading_error_rate_radps=None if yaw_rate is None else yaw_rate - mass.curvature_1pm * ref_speed,
    )


def stations_of(recording: Recording, course: Course) -> Array | None:
    """Station of the rear axle along the original path, row by row, m; None without a position."""
    x, y = recording.get("x_m"), recording.get("y_m")
    return None if x is None or y is None else find_feet(tables_of(course), x, y).station_m


def _seen(current: Samples) -> tuple[Array | None, Array | None]:
    """(speed along the path, yaw rate) as the follower took its errors from them."""
    speed, curvature = current.ref_speed_mps, current.ref_curvature_1pm
    along = yaw_rate = None
    if speed is not None and current.speed_error_mps is not None:
        along = speed - current.speed_error_mps
    if speed is not None and curvature is not None and current.heading_error_rate_radps is not None:
        yaw_rate = current.heading_error_rate_radps + curvature * speed
    return along, yaw_rate


def _speed(along: Array, rear: Feet, heading: Array) -> Array:
    """The INS's speed, of which `along` is the rate of the station (control/follower.py `speed_along`, the way back).

    NaN across the path, where it cannot be told.
    """
    cos = np.cos(heading - rear.heading_rad)
    shrink = np.maximum(1.0 - rear.curvature_1pm * rear.lateral_m, SHRINK_FLOOR)
    return along * shrink / np.where(np.abs(cos) > LEAST_COS, cos, np.nan)


def _clock(course: Course, station_m: Array, anchors: Array) -> tuple[Array, Array]:
    """(how late the plan runs, what is added to its station) at every row: set anew after each re-plan."""
    # the stops are not asked for here; a table of the same kind stands in for them
    schedule = Schedule(course.dt_s, course.station_m, course.speed_mps, course.accel_mps2, course.station_m)
    shift_s, offset_m = np.zeros(len(station_m)), np.zeros(len(station_m))
    late_s = 0.0
    for row in anchors.tolist():
        here_m, time_s = float(station_m[row]), row * course.dt_s
        if not math.isfinite(here_m):
            continue
        plan_s = time_of(schedule, time_s - late_s, here_m)
        late_s = time_s - plan_s
        shift_s[row + 1 :] = late_s
        offset_m[row + 1 :] = here_m - station_at(schedule, plan_s)
    return shift_s, offset_m


def find_feet(tables: _Tables, x_m: Array, y_m: Array, near_m: Array | None = None, first: int = 0) -> Feet:
    """The feet of points that follow each other along the path; NaN where a point is not finite, and before `first`.

    near_m: stations to look from, row by row; None to find them.
    """
    rows = np.flatnonzero(np.isfinite(x_m) & np.isfinite(y_m))
    result = Feet(*(np.full(len(x_m), np.nan) for _ in range(4)))
    if len(rows) == 0:
        return result
    guess = near_stations(tables, x_m, y_m) if near_m is None else near_m
    rows = rows[np.searchsorted(rows, first) :]
    x, y, guess = x_m[rows], y_m[rows], guess[rows]
    cell = _cells(tables, guess)
    for _ in range(NEWTON_STEPS):
        guess = tables.first_m + cell * tables.spacing_m + _along(tables, cell, x, y)
        before, cell = cell, _cells(tables, guess)
        if np.array_equal(cell, before):  # every further step would give the same
            break
    for column, values in zip(result, _feet(tables, _settle(tables, cell, x, y), x, y), strict=True):
        column[rows] = values
    return result


def near_stations(tables: _Tables, x_m: Array, y_m: Array) -> Array:
    """Stations near the feet, for every row; 0 where no point is finite.

    Every twentieth foot is looked for from the one before (so the branch that is driven is kept where the path passes
    near itself), those between lie on the line through these.
    """
    rows = np.flatnonzero(np.isfinite(x_m) & np.isfinite(y_m))
    if len(rows) == 0:
        return np.zeros(len(x_m))
    some = np.append(rows[:-1:STRIDE], rows[-1])
    return np.interp(np.arange(len(x_m)), some, _follow(tables, x_m[some].tolist(), y_m[some].tolist()))


def _follow(tables: _Tables, xs: list[float], ys: list[float]) -> list[float]:
    """Stations of the feet of a few points, each looked for from the one before; the first from station 0."""
    nodes, first_m, spacing_m = tables.nodes, tables.first_m, tables.spacing_m
    last = len(nodes) - 1
    station, found = 0.0, []
    for x, y in zip(xs, ys, strict=True):
        before = -1
        for _ in range(NEWTON_STEPS):
            cell = round((station - first_m) / spacing_m)
            cell = 0 if cell < 0 else last if cell > last else cell
            if cell == before:  # every further step would give the same
                break
            before = cell
            node_x, node_y, cos, sin = nodes[cell]
            station = first_m + cell * spacing_m + ((x - node_x) * cos + (y - node_y) * sin)
        found.append(station)
    return found


def _settle(tables: _Tables, cell: Array, x: Array, y: Array) -> Array:
    """Move to the cell at whose first node the point is ahead, and at whose last node it is behind."""
    last = len(tables.x_m) - 2
    for _ in range(WALK_STEPS):
        ahead = _along(tables, cell + 1, x, y) > 0.0
        behind = _along(tables, cell, x, y) < 0.0
        step = np.where(ahead, 1, np.where(behind, -1, 0))
        if not step.any():
            break
        cell = np.clip(cell + step, 0, last)
    return cell


def _feet(tables: _Tables, cell: Array, x: Array, y: Array) -> Feet:
    """The foot within each cell: chord plus bulge, interpolated tangent (control/path.py `project`)."""
    along, ahead = _along(tables, cell, x, y), _along(tables, cell + 1, x, y)
    fall = along - ahead
    share = np.where(fall > 1e-9, along / np.where(fall > 1e-9, fall, 1.0), 0.5)
    inside = (cell > 0) & (share < 0.0) | (cell < len(tables.x_m) - 2) & (share > 1.0)
    share = np.where(inside, np.clip(share, 0.0, 1.0), share)
    heading = _between(tables.heading_rad, cell, share)
    gap_x = x - _between(tables.x_m, cell, share)
    gap_y = y - _between(tables.y_m, cell, share)
    mean = 0.5 * (tables.curvature_1pm[cell] + tables.curvature_1pm[cell + 1])
    bulge = np.where((share > 0.0) & (share < 1.0), 0.5 * mean * tables.spacing_m**2 * share * (1.0 - share), 0.0)
    return Feet(
        tables.first_m + (cell + share) * tables.spacing_m,
        heading,
        _between(tables.curvature_1pm, cell, share),
        gap_y * np.cos(heading) - gap_x * np.sin(heading) + bulge,
    )


def _tables(course: Course) -> _Tables:
    heading, x, y = (np.asarray(values) for values in (course.path_heading_rad, course.path_x_m, course.path_y_m))
    cos, sin = np.cos(heading), np.sin(heading)
    return _Tables(
        course.first_station_m,
        course.spacing_m,
        x,
        y,
        heading,
        np.asarray(course.path_curvature_1pm),
        cos,
        sin,
        list(zip(x.tolist(), y.tolist(), cos.tolist(), sin.tolist(), strict=True)),
        np.arange(course.ticks + 1) * course.dt_s,
        np.asarray(course.station_m),
        np.asarray(course.speed_mps),
        np.asarray(course.accel_mps2),
    )


tables_of = Kept(_tables)


def _cells(tables: _Tables, station_m: Array) -> Array:
    at = np.floor((station_m - tables.first_m) / tables.spacing_m)
    return np.clip(at, 0, len(tables.x_m) - 2).astype(int)


def _along(tables: _Tables, node: Array, x: Array, y: Array) -> Array:
    return (x - tables.x_m[node]) * tables.cos[node] + (y - tables.y_m[node]) * tables.sin[node]


def _between(values: Array, cell: Array, share: Array) -> Array:
    return values[cell] + share * (values[cell + 1] - values[cell])


def _wrap(angle_rad: Array) -> Array:
    return angle_rad - 2.0 * math.pi * np.ceil((angle_rad - math.pi) / (2.0 * math.pi))
