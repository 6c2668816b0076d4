"""The reference path that a log is held against: a scenario file, or a table of points (CSV), as a Course.

A CSV has a header with x_m, y_m and speed_mps, and t_s where times are known; station_m, heading_rad and curvature_1pm
may be left out and are then taken from the points. Its coordinates are those of the INS frames, its points those of the
rear axle's middle, as an INS records them; what the centre of mass is to follow is drawn from them, `ahead_m` in front
(the source does the same: apollo_facts 1.2, 3.1). Without t_s the times follow from stations and speeds.

Points may be as dense and as noisy as a recorded drive's: those nearer together than half a metre count as one place,
or the path's length and its curvature would be the noise of the positions.
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

NEEDED = ("x_m", "y_m", "speed_mps")
KNOWN = ("t_s", "station_m", "x_m", "y_m", "heading_rad", "speed_mps", "curvature_1pm")
LEAST_POINTS = 3
LEAST_CHORD_M = 0.5
ACCEL_HALF_S = 0.1  # the speed's slope is taken over twice that
LEAST_PACE_MPS = 0.05  # below it, a table without times does not say how long the vehicle stands


class Reference(NamedTuple):
    """What was planned. world: its coordinates are meant to be those of the log (a CSV), not a place of its own."""

    name: str
    course: Course
    world: bool
    hash: str  # of the scenario file; '' for a CSV


class Points(NamedTuple):
    """The columns of a CSV by name; the line of the file that each row stands on, for whoever has to mend it."""

    file: str
    columns: dict[str, Array]
    lines: list[int]


def read_reference(name: str, dt_s: float, ahead_m: float = 0.0) -> Reference:
    """A reference by the path of a CSV, or by name or path of a scenario. Raises InputError that says what is wrong.

    ahead_m: rear axle to centre of mass, for a CSV of the rear axle's places; 0 for one of the centre of mass's.
    """
    path = Path(name)
    if path.suffix.lower() == ".csv":
        return Reference(path.stem, course_of_points(read_points(path), dt_s, ahead_m), True, "")
    spec = load_scenario(name)
    return Reference(spec.name, build_course(spec, dt_s), False, spec.hash)


def read_points(path: Path) -> Points:
    """What a CSV says. Raises InputError that names file and column or line."""
    if not path.is_file():
        raise InputError("there is no such file", code="no_path", file=str(path), hint="give a CSV or a scenario")
    lines, rows = _rows(path)
    header = [word.strip() for word in rows[0]] if rows else []
    for wanted in NEEDED:
        if wanted not in header:
            raise InputError(
                f"has no column {wanted!r}; its columns are {', '.join(header) or 'none'}",
                code="bad_path",
                file=str(path),
                key=wanted,
                hint=f"a header line with some of {', '.join(KNOWN)}, SI units",
            )
    if len(rows) - 1 < LEAST_POINTS:
        raise InputError(f"has {len(rows) - 1} points, needs {LEAST_POINTS}", code="bad_path", file=str(path))
    columns = {name: np.empty(len(rows) - 1) for name in header if name in KNOWN}
    for i, row in enumerate(rows[1:]):
        for name, column in columns.items():
            column[i] = _number(row, header.index(name), f"{path}", lines[i + 1], name)
    return Points(str(path), columns, lines[1:])


def _rows(path: Path) -> tuple[list[int], list[list[str]]]:
    """Line and cells of each row, the header first, without empty lines, remarks and a byte order mark (Excel's)."""
    lines, rows = [], []
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            for row in reader:
                if row and not row[0].startswith("#"):
                    lines.append(reader.line_num)
                    rows.append(row)
    except (UnicodeDecodeError, csv.Error) as error:
        hint = "save it as comma-separated text in UTF-8"
        raise InputError(f"not a CSV in UTF-8: {error}", code="bad_path", file=str(path), hint=hint) from error
    return lines, rows


def _number(row: list[str], at: int, file: str, line: int, name: str) -> float:
    """One cell as a finite number."""
    try:
        value = float(row[at])
    except (ValueError, IndexError):
        value = math.nan
    if not math.isfinite(value):
        shown = row[at] if at < len(row) else ""
        raise InputError(f"row {line}: {shown!r} is no finite number", code="bad_path", file=file, key=name)
    return value


def course_of_points(given: Points, dt_s: float, ahead_m: float = 0.0) -> Course:
    """A Course through the points; ahead_m as in read_reference."""
    points, file = given.columns, given.file
    if points["speed_mps"].min() < 0.0:
        raise InputError("speed is negative: reverse is not supported", code="bad_path", file=file, key="speed_mps")
    places = _places(points["x_m"], points["y_m"])
    if len(places) < LEAST_POINTS:
        raise InputError("the points do not move on: a path needs three places", code="bad_path", file=file)
    if ahead_m != 0.0:
        points = _moved_ahead(points, places, ahead_m)
    speed, station = points["speed_mps"], _stations(points, places)
    _require_ascending(station, "station_m", given, strictly=False)
    _require_ascending(station, "station_m", given, strictly=True, rows=places)
    time = points["t_s"] - points["t_s"][0] if "t_s" in points else _times(station, speed, given)
    _require_ascending(time, "t_s", given, strictly=True)
    ticks = max(1, math.floor(time[-1] / dt_s + 1e-6))
    at = np.arange(ticks + 1) * dt_s
    by_station = _by_station(points, station[places] + ahead_m, places)
    return Course(
        dt_s=dt_s,
        ticks=ticks,
        station_m=table(np.interp(at, time, station)),
        speed_mps=table(np.interp(at, time, speed)),
        accel_mps2=table(_accel(at, time, speed)),
        grade_rad=table(np.zeros(ticks + 1)),
        friction_frac=table(np.ones(ticks + 1)),
        first_station_m=-PROLONGED_M,
        spacing_m=SPACING_M,
        path_x_m=table(by_station[0]),
        path_y_m=table(by_station[1]),
        path_heading_rad=table(by_station[2]),
        path_curvature_1pm=table(by_station[3]),
    )


def _places(x: Array, y: Array) -> list[int]:
    """Rows at least LEAST_CHORD_M apart, first and last in."""
    kept, xs, ys = [0], x.tolist(), y.tolist()
    for row in range(1, len(xs)):
        if math.dist((xs[row], ys[row]), (xs[kept[-1]], ys[kept[-1]])) >= LEAST_CHORD_M:
            kept.append(row)
    if len(kept) > LEAST_POINTS and kept[-1] != len(xs) - 1:
        kept[-1] = len(xs) - 1
    return kept


def _stations(points: dict[str, Array], places: list[int]) -> Array:
    """Station of every row, m, the first 0: as given, or by chords between places and distances from the last one."""
    if "station_m" in points:
        return points["station_m"] - points["station_m"][0]
    x, y = points["x_m"], points["y_m"]
    at_places = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x[places]), np.diff(y[places])))])
    before = np.searchsorted(places, np.arange(len(x)), side="right") - 1
    here = np.take(places, before)
    gone = at_places[before] + np.hypot(x - x[here], y - y[here])
    ends = at_places[np.minimum(before + 1, len(places) - 1)]
    return np.maximum.accumulate(np.minimum(gone, ends))


def _moved_ahead(points: dict[str, Array], places: list[int], ahead_m: float) -> dict[str, Array]:
    """What the centre of mass follows where the rear axle is to follow the points, without slip: x, y, its tangent."""
    station = _stations(points, places)
    heading, curvature = _bends(points, station[places], places)
    at_rows = np.interp(station, station[places], heading)
    tangent = np.interp(station, station[places], heading + np.arctan(ahead_m * curvature))
    moved = {name: values for name, values in points.items() if name in ("t_s", "speed_mps")}
    x, y = points["x_m"] + ahead_m * np.cos(at_rows), points["y_m"] + ahead_m * np.sin(at_rows)
    return moved | {"x_m": x, "y_m": y, "heading_rad": tangent}


def _bends(points: dict[str, Array], station_m: Array, places: list[int]) -> tuple[Array, Array]:
    """Heading (continuous) and curvature at the places, as given or from the places themselves."""
    if "heading_rad" in points:
        heading = np.unwrap(points["heading_rad"][places])
    else:
        x, y = points["x_m"][places], points["y_m"][places]
        slopes = (np.gradient(values, station_m, edge_order=2) for values in (y, x))
        heading = np.unwrap(np.arctan2(*slopes))
    given = points.get("curvature_1pm")
    return heading, np.gradient(heading, station_m) if given is None else given[places]


def _require_ascending(
    values: Array, name: str, given: Points, *, strictly: bool, rows: list[int] | None = None
) -> None:
    """Raise InputError for the first row that does not; rows: only these are compared, each with the one before."""
    rows = list(range(len(values))) if rows is None else rows
    steps = np.diff(values[rows])
    wrong = steps <= 0.0 if strictly else steps < 0.0
    if wrong.any():
        line = given.lines[rows[int(np.argmax(wrong)) + 1]]
        raise InputError(f"must ascend; row {line} does not", code="bad_path", file=given.file, key=name)


def _accel(at: Array, time: Array, speed: Array) -> Array:
    """The plan's acceleration at the times `at`: of a recorded speed, a difference of two rows would be its noise."""
    low, high = np.maximum(at - ACCEL_HALF_S, time[0]), np.minimum(at + ACCEL_HALF_S, time[-1])
    return (np.interp(high, time, speed) - np.interp(low, time, speed)) / (high - low)


def _times(station_m: Array, speed_mps: Array, given: Points) -> Array:
    """When each point is passed, from stations and the mean speed between points."""
    pace = 0.5 * (speed_mps[1:] + speed_mps[:-1])
    if pace.min() < LEAST_PACE_MPS:
        raise InputError(
            f"row {given.lines[int(pace.argmin()) + 1]}: the plan stands still, and without times nobody knows for how"
            " long",
            code="bad_path",
            file=given.file,
            key="t_s",
            hint="add a column t_s",
        )
    return np.concatenate([[0.0], np.cumsum(np.diff(station_m) / pace)])


def _by_station(points: dict[str, Array], station_m: Array, places: list[int]) -> tuple[Array, Array, Array, Array]:
    """x, y, heading and curvature every SPACING_M, prolonged straight on at both ends."""
    x, y = points["x_m"][places], points["y_m"][places]
    heading, curvature = _bends(points, station_m, places)
    cells = round(PROLONGED_M / SPACING_M) + math.ceil((station_m[-1] + PROLONGED_M) / SPACING_M)
    at = -PROLONGED_M + np.arange(cells + 1) * SPACING_M
    inside = np.clip(at, station_m[0], station_m[-1])
    beyond = at - inside
    angle = np.interp(inside, station_m, heading)
    xs = _hermite(inside, station_m, x, np.cos(heading)) + beyond * np.cos(angle)
    ys = _hermite(inside, station_m, y, np.sin(heading)) + beyond * np.sin(angle)
    return xs, ys, angle, np.where(beyond == 0.0, np.interp(inside, station_m, curvature), 0.0)


def _hermite(at: Array, nodes: Array, values: Array, slopes: Array) -> Array:
    """Cubic through values with slopes (a chord of a bend would lie inside it)."""
    i = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    span = nodes[i + 1] - nodes[i]
    u = (at - nodes[i]) / span
    rest = 1.0 - u
    ends = rest * rest * (1.0 + 2.0 * u) * values[i] + u * u * (3.0 - 2.0 * u) * values[i + 1]
    return ends + span * u * rest * (rest * slopes[i] - u * slopes[i + 1])
