"""Projection of a point on the path table of a Course: local, continuous along the segment and across the nodes.

Within a cell the path is the chord plus an arc of its mean curvature; its heading is interpolated. The projection of a
point is where the interpolated tangent is perpendicular to the line to the point. At a node this condition is the same
for both cells, so the projection is continuous. The search starts at the last projection: where the path passes near
itself (U-turn, slip road) it stays on the branch being driven.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.course import Course
from tunefree_hil.base.kernel import kernel, table

WALK_M = 5.0  # longest search in one tick; further away is another branch of the path


class Path(NamedTuple):
    """The path tables of a Course with sine and cosine of the heading at the nodes."""

    first_station_m: float
    spacing_m: float
    x_m: Any
    y_m: Any
    heading_rad: Any
    curvature_1pm: Any
    cos: Any
    sin: Any
    walk_cells: int


class ProjectedPoint(NamedTuple):
    """The point of the path nearest to a point, and how far to the left of it (tangent's normal) the point is."""

    cell: int
    station_m: float
    heading_rad: float
    curvature_1pm: float
    lateral_m: float
    cos: float
    sin: float


def make_path(course: Course) -> Path:
    """The tables for `project`."""
    heading = [float(value) for value in course.path_heading_rad]
    return Path(
        first_station_m=course.first_station_m,
        spacing_m=course.spacing_m,
        x_m=course.path_x_m,
        y_m=course.path_y_m,
        heading_rad=course.path_heading_rad,
        curvature_1pm=course.path_curvature_1pm,
        cos=table(math.cos(value) for value in heading),
        sin=table(math.sin(value) for value in heading),
        walk_cells=math.ceil(WALK_M / course.spacing_m),
    )


@kernel
def find_projection(path: Path, cell: int, x_m: float, y_m: float) -> tuple[int, float]:
    """(cell, share of the cell) of the projection of a point, searched forwards and backwards from `cell`."""
    xs, ys, cos, sin = path.x_m, path.y_m, path.cos, path.sin
    last = len(xs) - 2
    along = (x_m - xs[cell]) * cos[cell] + (y_m - ys[cell]) * sin[cell]
    ahead = (x_m - xs[cell + 1]) * cos[cell + 1] + (y_m - ys[cell + 1]) * sin[cell + 1]
    walked = 0
    while ahead > 0.0 and cell < last and walked < path.walk_cells:
        cell += 1
        walked += 1
        along = ahead
        ahead = (x_m - xs[cell + 1]) * cos[cell + 1] + (y_m - ys[cell + 1]) * sin[cell + 1]
    while along < 0.0 and cell > 0 and walked < path.walk_cells:
        cell -= 1
        walked += 1
        ahead = along
        along = (x_m - xs[cell]) * cos[cell] + (y_m - ys[cell]) * sin[cell]
    fall = along - ahead
    share = 0.5  # beyond the centre of curvature the projection is not defined
    if fall > 1e-9:
        share = along / fall
    if share < 0.0 and cell > 0:
        share = 0.0
    elif share > 1.0 and cell < last:
        share = 1.0
    return cell, share


@kernel
def project(path: Path, cell: int, x_m: float, y_m: float) -> ProjectedPoint:
    """The projection of a point. Left of the path is positive; beyond the ends the path is straight."""
    cell, share = find_projection(path, cell, x_m, y_m)
    after = cell + 1
    first_curvature, first_heading = path.curvature_1pm[cell], path.heading_rad[cell]
    heading_rad = first_heading + share * (path.heading_rad[after] - first_heading)
    curvature_1pm = first_curvature + share * (path.curvature_1pm[after] - first_curvature)
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    first_x_m, first_y_m = path.x_m[cell], path.y_m[cell]
    gap_x_m = x_m - first_x_m - share * (path.x_m[after] - first_x_m)
    gap_y_m = y_m - first_y_m - share * (path.y_m[after] - first_y_m)
    lateral_m = gap_y_m * cos - gap_x_m * sin
    if 0.0 < share < 1.0:  # a left-hand arc lies to the right of its chord
        mean_1pm = 0.5 * (first_curvature + path.curvature_1pm[after])
        lateral_m += 0.5 * mean_1pm * path.spacing_m * path.spacing_m * share * (1.0 - share)
    station_m = path.first_station_m + (cell + share) * path.spacing_m
    return ProjectedPoint(cell, station_m, heading_rad, curvature_1pm, lateral_m, cos, sin)


@kernel
def heading_at(path: Path, station_m: float) -> tuple[float, float]:
    """(heading, curvature) of the path at a station; beyond the ends that of the end."""
    last = len(path.x_m) - 1
    row = (station_m - path.first_station_m) / path.spacing_m  # not 0: a Course has a spacing
    if row <= 0.0:
        return float(path.heading_rad[0]), float(path.curvature_1pm[0])
    if row >= last:
        return float(path.heading_rad[last]), float(path.curvature_1pm[last])
    cell = int(math.floor(row))  # noqa: RUF046 - a compiled floor gives a float
    share = row - cell
    first_heading, first_curvature = path.heading_rad[cell], path.curvature_1pm[cell]
    heading_rad = first_heading + share * (path.heading_rad[cell + 1] - first_heading)
    curvature_1pm = first_curvature + share * (path.curvature_1pm[cell + 1] - first_curvature)
    return heading_rad, curvature_1pm


@kernel
def cell_of(path: Path, station_m: float) -> int:
    """The cell in which a station lies, clamped to the ends."""
    last = len(path.x_m) - 2
    row = (station_m - path.first_station_m) / path.spacing_m  # not 0: a Course has a spacing
    if row <= 0.0:
        return 0
    if row >= last:
        return last
    return int(math.floor(row))  # noqa: RUF046 - a compiled floor gives a float
