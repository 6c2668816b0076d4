"""Feet of points on the path of a course, all rows of a drive at once, and the course as the arrays that takes.

The foot of a point is defined as in control/path.py; there tick by tick, here in bulk, to 1e-9 m the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.memo import Kept

Array = np.ndarray

STRIDE = 20  # rows between the feet that are looked for one after the other
NEWTON_STEPS = 4
WALK_STEPS = 6


class Feet(NamedTuple):
    """Feet of points on the path: arrays, one element a row."""

    station_m: Array
    heading_rad: Array
    curvature_1pm: Array
    lateral_m: Array


class Tables(NamedTuple):
    """A course as arrays: the path by station (control/path.py), the plan by time."""

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


def stations_of(recording: Recording, course: Course) -> Array | None:
    """Station of the rear axle along the original path, row by row, m; None without a position."""
    x, y = recording.get("x_m"), recording.get("y_m")
    return None if x is None or y is None else find_feet(tables_of(course), x, y).station_m


def find_feet(tables: Tables, x_m: Array, y_m: Array, near_m: Array | None = None, first: int = 0) -> Feet:
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


def near_stations(tables: Tables, x_m: Array, y_m: Array) -> Array:
    """Stations near the feet, for every row; 0 where no point is finite.

    Every twentieth foot is looked for from the one before (so the branch that is driven is kept where the path passes
    near itself), those between lie on the line through these.
    """
    rows = np.flatnonzero(np.isfinite(x_m) & np.isfinite(y_m))
    if len(rows) == 0:
        return np.zeros(len(x_m))
    some = np.append(rows[:-1:STRIDE], rows[-1])
    return np.interp(np.arange(len(x_m)), some, _follow(tables, x_m[some].tolist(), y_m[some].tolist()))


def _follow(tables: Tables, xs: list[float], ys: list[float]) -> list[float]:
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


def _settle(tables: Tables, cell: Array, x: Array, y: Array) -> Array:
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


def _feet(tables: Tables, cell: Array, x: Array, y: Array) -> Feet:
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


def _tables(course: Course) -> Tables:
    heading, x, y = (np.asarray(values) for values in (course.path_heading_rad, course.path_x_m, course.path_y_m))
    cos, sin = np.cos(heading), np.sin(heading)
    return Tables(
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


def _cells(tables: Tables, station_m: Array) -> Array:
    at = np.floor((station_m - tables.first_m) / tables.spacing_m)
    return np.clip(at, 0, len(tables.x_m) - 2).astype(int)


def _along(tables: Tables, node: Array, x: Array, y: Array) -> Array:
    return (x - tables.x_m[node]) * tables.cos[node] + (y - tables.y_m[node]) * tables.sin[node]


def _between(values: Array, cell: Array, share: Array) -> Array:
    return values[cell] + share * (values[cell + 1] - values[cell])
