"""Reference path of a log as a Course: a scenario file, or a table of points (CSV).

A CSV has a header with x_m, y_m and speed_mps, and t_s where times are known; station_m, heading_rad and curvature_1pm
are optional and otherwise computed from the points. The points are positions of the rear axle in the coordinates of
the INS; the path of the centre of mass, `ahead_m` in front of it, is computed from them. Without t_s, times follow
from stations and speeds. Points of a recorded drive may be dense and noisy: points less than 0.5 m apart are merged,
so that noise of the positions does not enter length and curvature.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import table
from tunefree_hil.config.load import load_scenario
from tunefree_hil.episode.scenario import PROLONGED_M, SPACING_M, build_course

Array = np.ndarray

REQUIRED_COLUMNS = ("x_m", "y_m", "speed_mps")
COLUMNS = ("t_s", "station_m", "x_m", "y_m", "heading_rad", "speed_mps", "curvature_1pm")
MIN_POINTS = 3
MIN_CHORD_M = 0.5
ACCEL_HALF_WINDOW_S = 0.1  # half the time over which the acceleration is taken from the speed
MIN_PACE_MPS = 0.05  # at a lower mean speed between two points, the points must have times


class ReferencePath(NamedTuple):
    """A reference path. in_log_coordinates: its coordinates are those of the log (a CSV)."""

    name: str
    course: Course
    in_log_coordinates: bool
    hash: str  # of the scenario file; '' for a CSV


class PathSamples(NamedTuple):
    """A path every SPACING_M: arrays of shape (n_stations,)."""

    x_m: Array
    y_m: Array
    heading_rad: Array
    curvature_1pm: Array


class ReferencePoints(NamedTuple):
    """The columns of a CSV by name, and the line number of each row for error messages."""

    file: str
    columns: dict[str, Array]
    lines: list[int]


def read_reference(name: str, dt_s: float, ahead_m: float = 0.0) -> ReferencePath:
    """Read a reference: a CSV by its path, or a scenario by name or path.

    Args:
        ahead_m: Rear axle to centre of mass for a CSV of the rear axle; 0 for one of the centre of mass.

    Raises:
        InputError: The file is missing or invalid.
    """
    path = Path(name)
    if path.suffix.lower() == ".csv":
        return ReferencePath(path.stem, course_from_points(read_points(path), dt_s, ahead_m), True, "")
    spec = load_scenario(name)
    return ReferencePath(spec.name, build_course(spec, dt_s), False, spec.hash)


def read_points(path: Path) -> ReferencePoints:
    """Read a CSV of points. Raises InputError that names file and column or line."""
    if not path.is_file():
        raise InputError("no such file", code="no_path", file=str(path), hint="give a CSV or a scenario")
    lines, rows = _read_rows(path)
    header = [word.strip() for word in rows[0]] if rows else []
    for wanted in REQUIRED_COLUMNS:
        if wanted not in header:
            raise InputError(
                f"has no column {wanted!r}; its columns are {', '.join(header) or 'none'}",
                code="bad_path",
                file=str(path),
                key=wanted,
                hint=f"a header line with some of {', '.join(COLUMNS)}, SI units",
            )
    if len(rows) - 1 < MIN_POINTS:
        raise InputError(f"has {len(rows) - 1} points, needs {MIN_POINTS}", code="bad_path", file=str(path))
    columns = {name: np.empty(len(rows) - 1) for name in header if name in COLUMNS}
    for i, row in enumerate(rows[1:]):
        for name, column in columns.items():
            column[i] = _parse_number(row, header.index(name), f"{path}", lines[i + 1], name)
    return ReferencePoints(str(path), columns, lines[1:])


def _read_rows(path: Path) -> tuple[list[int], list[list[str]]]:
    """Line numbers and cells of the rows, header first; without empty lines, comments and a byte order mark."""
    lines, rows = [], []
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            for row in reader:
                if row and not row[0].startswith("#"):
                    lines.append(reader.line_num)
                    rows.append(row)
    except (UnicodeDecodeError, csv.Error) as error:
        hint = "save it as comma-separated UTF-8 text"
        raise InputError(f"not a CSV in UTF-8: {error}", code="bad_path", file=str(path), hint=hint) from error
    return lines, rows


def _parse_number(row: list[str], column: int, file: str, line: int, name: str) -> float:
    """One cell as a finite number."""
    try:
        value = float(row[column])
    except (ValueError, IndexError):
        value = math.nan
    if not math.isfinite(value):
        cell = row[column] if column < len(row) else ""
        raise InputError(f"row {line}: {cell!r} is not a finite number", code="bad_path", file=file, key=name)
    return value


def course_from_points(points_file: ReferencePoints, dt_s: float, ahead_m: float = 0.0) -> Course:
    """Make a Course through the points; ahead_m as in read_reference."""
    points, file = points_file.columns, points_file.file
    if points["speed_mps"].min() < 0.0:
        raise InputError("speed is negative: reverse is not supported", code="bad_path", file=file, key="speed_mps")
    places = _select_spaced_rows(points["x_m"], points["y_m"])
    if len(places) < MIN_POINTS:
        message = f"a path needs {MIN_POINTS} points at least {MIN_CHORD_M} m apart"
        raise InputError(message, code="bad_path", file=file)
    if ahead_m != 0.0:
        points = _shift_to_com(points, places, ahead_m)
    speed, station = points["speed_mps"], _compute_stations(points, places)
    _require_ascending(station, "station_m", points_file, strictly=False)
    _require_ascending(station, "station_m", points_file, strictly=True, rows=places)
    time = points["t_s"] - points["t_s"][0] if "t_s" in points else _times_from_speed(station, speed, points_file)
    _require_ascending(time, "t_s", points_file, strictly=True)
    ticks = max(1, math.floor(time[-1] / dt_s + 1e-6))
    times_s = np.arange(ticks + 1) * dt_s
    path = _sample_path(points, station[places] + ahead_m, places)
    return Course(
        dt_s=dt_s,
        ticks=ticks,
        station_m=table(np.interp(times_s, time, station)),
        speed_mps=table(np.interp(times_s, time, speed)),
        accel_mps2=table(_planned_accel(times_s, time, speed)),
        grade_rad=table(np.zeros(ticks + 1)),
        friction_frac=table(np.ones(ticks + 1)),
        bank_rad=table(np.zeros(ticks + 1)),
        side_wind_mps2=table(np.zeros(ticks + 1)),
        first_station_m=-PROLONGED_M,
        spacing_m=SPACING_M,
        path_x_m=table(path.x_m),
        path_y_m=table(path.y_m),
        path_heading_rad=table(path.heading_rad),
        path_curvature_1pm=table(path.curvature_1pm),
    )


def _select_spaced_rows(x: Array, y: Array) -> list[int]:
    """Rows at least MIN_CHORD_M apart, first and last included."""
    rows, xs, ys = [0], x.tolist(), y.tolist()
    for row in range(1, len(xs)):
        if math.dist((xs[row], ys[row]), (xs[rows[-1]], ys[rows[-1]])) >= MIN_CHORD_M:
            rows.append(row)
    if len(rows) > MIN_POINTS and rows[-1] != len(xs) - 1:
        rows[-1] = len(xs) - 1
    return rows


def _compute_stations(points: dict[str, Array], places: list[int]) -> Array:
    """Station of every row in m, from 0: as given, or by chords between `places` and the distance from the last one."""
    if "station_m" in points:
        return points["station_m"] - points["station_m"][0]
    x, y = points["x_m"], points["y_m"]
    at_places = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x[places]), np.diff(y[places])))])
    before = np.searchsorted(places, np.arange(len(x)), side="right") - 1
    last = np.take(places, before)
    station = at_places[before] + np.hypot(x - x[last], y - y[last])
    ends = at_places[np.minimum(before + 1, len(places) - 1)]
    return np.maximum.accumulate(np.minimum(station, ends))


def _shift_to_com(points: dict[str, Array], places: list[int], ahead_m: float) -> dict[str, Array]:
    """Path of the centre of mass, without slip, whose rear axle follows the points."""
    station = _compute_stations(points, places)
    heading, curvature = _heading_and_curvature(points, station[places], places)
    at_rows = np.interp(station, station[places], heading)
    tangent = np.interp(station, station[places], heading + np.arctan(ahead_m * curvature))
    moved = {name: values for name, values in points.items() if name in ("t_s", "speed_mps")}
    x, y = points["x_m"] + ahead_m * np.cos(at_rows), points["y_m"] + ahead_m * np.sin(at_rows)
    return moved | {"x_m": x, "y_m": y, "heading_rad": tangent}


def _heading_and_curvature(points: dict[str, Array], station_m: Array, places: list[int]) -> tuple[Array, Array]:
    """Heading (continuous) and curvature at `places`, as given or from the points."""
    if "heading_rad" in points:
        heading = np.unwrap(points["heading_rad"][places])
    else:
        x, y = points["x_m"][places], points["y_m"][places]
        slopes = (np.gradient(values, station_m, edge_order=2) for values in (y, x))
        heading = np.unwrap(np.arctan2(*slopes))
    given = points.get("curvature_1pm")
    return heading, np.gradient(heading, station_m) if given is None else given[places]


def _require_ascending(
    values: Array, name: str, source: ReferencePoints, *, strictly: bool, rows: list[int] | None = None
) -> None:
    """Raise InputError for the first row that does not ascend; rows: compare only these."""
    rows = list(range(len(values))) if rows is None else rows
    steps = np.diff(values[rows])
    wrong = steps <= 0.0 if strictly else steps < 0.0
    if wrong.any():
        line = source.lines[rows[int(np.argmax(wrong)) + 1]]
        raise InputError(f"must ascend; row {line} does not", code="bad_path", file=source.file, key=name)


def _planned_accel(times_s: Array, time: Array, speed: Array) -> Array:
    """Acceleration of the plan over 0.2 s; the difference of two rows would be the noise of a recorded speed."""
    low, high = np.maximum(times_s - ACCEL_HALF_WINDOW_S, time[0]), np.minimum(times_s + ACCEL_HALF_WINDOW_S, time[-1])
    return (np.interp(high, time, speed) - np.interp(low, time, speed)) / (high - low)


def _times_from_speed(station_m: Array, speed_mps: Array, source: ReferencePoints) -> Array:
    """Time at each point, from stations and the mean speed between points."""
    pace = 0.5 * (speed_mps[1:] + speed_mps[:-1])
    if pace.min() < MIN_PACE_MPS:
        raise InputError(
            f"row {source.lines[int(pace.argmin()) + 1]}: the plan stands still, and without times its duration is"
            " unknown",
            code="bad_path",
            file=source.file,
            key="t_s",
            hint="add a column t_s",
        )
    return np.concatenate([[0.0], np.cumsum(np.diff(station_m) / pace)])


def _sample_path(points: dict[str, Array], station_m: Array, places: list[int]) -> PathSamples:
    """Sample the path every SPACING_M, extended straight at both ends."""
    x, y = points["x_m"][places], points["y_m"][places]
    heading, curvature = _heading_and_curvature(points, station_m, places)
    cells = round(PROLONGED_M / SPACING_M) + math.ceil((station_m[-1] + PROLONGED_M) / SPACING_M)
    samples_m = -PROLONGED_M + np.arange(cells + 1) * SPACING_M
    inside = np.clip(samples_m, station_m[0], station_m[-1])
    beyond = samples_m - inside
    angle = np.interp(inside, station_m, heading)
    xs = _interpolate_hermite(inside, station_m, x, np.cos(heading)) + beyond * np.cos(angle)
    ys = _interpolate_hermite(inside, station_m, y, np.sin(heading)) + beyond * np.sin(angle)
    return PathSamples(xs, ys, angle, np.where(beyond == 0.0, np.interp(inside, station_m, curvature), 0.0))


def _interpolate_hermite(positions: Array, nodes: Array, values: Array, slopes: Array) -> Array:
    """Cubic through values with slopes; the chord of a curve would lie inside it."""
    i = np.clip(np.searchsorted(nodes, positions, side="right") - 1, 0, len(nodes) - 2)
    span = nodes[i + 1] - nodes[i]
    u = (positions - nodes[i]) / span
    rest = 1.0 - u
    ends = rest * rest * (1.0 + 2.0 * u) * values[i] + u * u * (3.0 - 2.0 * u) * values[i + 1]
    return ends + span * u * rest * (rest * slopes[i] - u * slopes[i + 1])
