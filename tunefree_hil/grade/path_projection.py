"""Projection of points onto the path of a course, for all rows of a drive at once.

Defined as in control/path.py, which does it tick by tick; the results agree to 1e-9 m.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.memo import CourseCache

Array = np.ndarray

ANCHOR_STRIDE = 20  # rows between the points that are projected one after the other
NEWTON_STEPS = 4
CELL_STEPS = 6


class DriveProjection(NamedTuple):
    """Points projected onto the path: arrays of shape (n_rows,)."""

    station_m: Array
    heading_rad: Array
    curvature_1pm: Array
    lateral_m: Array


class CourseArrays(NamedTuple):
    """A course as arrays: the path by station (control/path.py), the plan by time."""

    first_m: float
    spacing_m: float
    x_m: Array
    y_m: Array
    heading_rad: Array
    curvature_1pm: Array
    cos: Array
    sin: Array
    nodes: list[tuple[float, float, float, float]]  # x, y, cos, sin; for single look-ups
    plan_s: Array
    plan_station_m: Array
    plan_speed_mps: Array
    plan_accel_mps2: Array


def rear_axle_stations(recording: Recording, course: Course) -> Array | None:
    """Station of the rear axle along the original path in m, shape (n_rows,); None without a position."""
    x, y = recording.get("x_m"), recording.get("y_m")
    return None if x is None or y is None else project_points(course_arrays(course), x, y).station_m


def project_points(
    course: CourseArrays, x_m: Array, y_m: Array, near_m: Array | None = None, first_row: int = 0
) -> DriveProjection:
    """Project points that follow each other along the path.

    Args:
        near_m: Start values of the stations, shape (n_rows,); None to estimate them.
        first_row: Earlier rows are not projected.

    Returns:
        The projections; NaN where a point is not finite, and before `first_row`.
    """
    rows = np.flatnonzero(np.isfinite(x_m) & np.isfinite(y_m))
    result = DriveProjection(*(np.full(len(x_m), np.nan) for _ in range(4)))
    if len(rows) == 0:
        return result
    guess = estimate_stations(course, x_m, y_m) if near_m is None else near_m
    rows = rows[np.searchsorted(rows, first_row) :]
    x, y, guess = x_m[rows], y_m[rows], guess[rows]
    cell = _cells_at(course, guess)
    for _ in range(NEWTON_STEPS):
        guess = course.first_m + cell * course.spacing_m + _distance_along(course, cell, x, y)
        before, cell = cell, _cells_at(course, guess)
        if np.array_equal(cell, before):  # every further step would give the same
            break
    for column, values in zip(result, _project_in_cells(course, _settle_cells(course, cell, x, y), x, y), strict=True):
        column[rows] = values
    return result


def estimate_stations(course: CourseArrays, x_m: Array, y_m: Array) -> Array:
    """Approximate stations of the projected points, shape (n_rows,); 0 where no point is finite.

    Every twentieth point is projected starting from the previous one, which keeps the driven branch where the path
    passes near itself. The stations between them are interpolated.
    """
    rows = np.flatnonzero(np.isfinite(x_m) & np.isfinite(y_m))
    if len(rows) == 0:
        return np.zeros(len(x_m))
    anchors = np.append(rows[:-1:ANCHOR_STRIDE], rows[-1])
    return np.interp(
        np.arange(len(x_m)), anchors, _follow_stations(course, x_m[anchors].tolist(), y_m[anchors].tolist())
    )


def _follow_stations(course: CourseArrays, xs: list[float], ys: list[float]) -> list[float]:
    """Stations of some points, each searched from the previous one; the first from station 0."""
    nodes, first_m, spacing_m = course.nodes, course.first_m, course.spacing_m
    last = len(nodes) - 1
    station, stations = 0.0, []
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
        stations.append(station)
    return stations


def _settle_cells(course: CourseArrays, cell: Array, x: Array, y: Array) -> Array:
    """Move to the cell whose first node is behind the point and whose last node is ahead of it."""
    last = len(course.x_m) - 2
    for _ in range(CELL_STEPS):
        ahead = _distance_along(course, cell + 1, x, y) > 0.0
        behind = _distance_along(course, cell, x, y) < 0.0
        step = np.where(ahead, 1, np.where(behind, -1, 0))
        if not step.any():
            break
        cell = np.clip(cell + step, 0, last)
    return cell


def _project_in_cells(course: CourseArrays, cell: Array, x: Array, y: Array) -> DriveProjection:
    """Projection within each cell: chord plus bulge, interpolated tangent (control/path.py `project`)."""
    along, ahead = _distance_along(course, cell, x, y), _distance_along(course, cell + 1, x, y)
    fall = along - ahead
    share = np.where(fall > 1e-9, along / np.where(fall > 1e-9, fall, 1.0), 0.5)
    inside = (cell > 0) & (share < 0.0) | (cell < len(course.x_m) - 2) & (share > 1.0)
    share = np.where(inside, np.clip(share, 0.0, 1.0), share)
    heading = _interpolate(course.heading_rad, cell, share)
    gap_x = x - _interpolate(course.x_m, cell, share)
    gap_y = y - _interpolate(course.y_m, cell, share)
    mean = 0.5 * (course.curvature_1pm[cell] + course.curvature_1pm[cell + 1])
    bulge = np.where((share > 0.0) & (share < 1.0), 0.5 * mean * course.spacing_m**2 * share * (1.0 - share), 0.0)
    return DriveProjection(
        course.first_m + (cell + share) * course.spacing_m,
        heading,
        _interpolate(course.curvature_1pm, cell, share),
        gap_y * np.cos(heading) - gap_x * np.sin(heading) + bulge,
    )


def _build_course_arrays(course: Course) -> CourseArrays:
    heading, x, y = (np.asarray(values) for values in (course.path_heading_rad, course.path_x_m, course.path_y_m))
    cos, sin = np.cos(heading), np.sin(heading)
    return CourseArrays(
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


course_arrays = CourseCache(_build_course_arrays)


def _cells_at(course: CourseArrays, station_m: Array) -> Array:
    cells = np.floor((station_m - course.first_m) / course.spacing_m)
    return np.clip(cells, 0, len(course.x_m) - 2).astype(int)


def _distance_along(course: CourseArrays, node: Array, x: Array, y: Array) -> Array:
    return (x - course.x_m[node]) * course.cos[node] + (y - course.y_m[node]) * course.sin[node]


def _interpolate(values: Array, cell: Array, share: Array) -> Array:
    return values[cell] + share * (values[cell + 1] - values[cell])
