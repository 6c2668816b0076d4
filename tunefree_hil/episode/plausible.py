"""Whether the columns of a test drive contradict each other: integrals compared, so that a swapped unit is caught.

A speed's integral is the way between positions, a yaw rate's the change of heading, an acceleration's the change of
speed. Compared over windows of WINDOW_S that hold no silence. Where two columns do not fit, every other unit of either
is tried, and those that make them fit are named. Columns that hardly move, or do not follow each other at all (a
correlation below LEAST_FIT under every unit), are not judged, and that is said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.config.import_schema import UNITS, si_unit
from tunefree_hil.episode.csv_drive import Column, CsvDrive

WINDOW_S = 0.5
LEAST_WINDOWS = 4
LEAST_FIT = 0.6  # correlation from which two columns are taken to follow each other
LIKELY = (0.8, 1.25)  # a factor in here makes another unit the likely one
# Greatest absolute SI values that a car (or a model of one) shows, by the end of the field's name.
HIGHEST = {"mps": 120.0, "mps2": 60.0, "radps": 600.0, "frac": 1.5}
HIGHEST_OF = {"yaw_rate_radps": 12.0, "heading_rad": 100.0, "steer_rad": 25.0, "steer_command_rad": 25.0}

Array = NDArray[np.float64]
Sample = tuple[Array, Array]  # stamps, values


class Pair(NamedTuple):
    """One comparison: two groups of fields, allowed factor of the second by the first, least movement to be judged."""

    check: str
    first: tuple[str, ...]
    second: tuple[str, ...]
    allowed: tuple[float, float]
    least: float
    windows: Callable[[Sequence[Sample], Sequence[Sample], Array], tuple[Array, Array]]
    centred: bool = False  # a constant offset (gravity, a sensor's bias) does not count


class Finding(NamedTuple):
    """What one check says. holds: None where it could not be judged. factor: second by first, 1 where they agree."""

    check: str
    holds: bool | None
    words: str
    factor: float | None = None


def check_units(drive: CsvDrive, wheelbase_m: float | None = None, steer_ratio: float | None = None) -> list[Finding]:
    """All checks that the drive's columns allow; with the car's two constants also steering against yaw rate."""
    found = list(_ranges(drive))
    steering: tuple[Pair, ...] = ()
    if wheelbase_m and steer_ratio:
        steering = tuple(
            _steering(yaw, wheelbase_m, steer_ratio) for yaw in ("report.yaw_rate_radps", "ins.yaw_rate_radps")
        )
    for pair in (*PAIRS, *steering):
        if all(name in drive.columns for name in (*pair.first, *pair.second)):
            found.append(_compare(pair, drive))
    return found


def _ranges(drive: CsvDrive) -> Iterator[Finding]:
    for name, column in drive.columns.items():
        field = name.partition(".")[2]
        highest = HIGHEST_OF.get(field, HIGHEST.get(si_unit(field)))
        values = column.values[column.sent]
        if highest is None or not values.size:
            continue
        most = float(np.abs(values).max())
        if most > highest:
            fits = [unit for unit, factor in _others(column) if most * factor <= highest]
            likely = f"; it would fit in {' or '.join(fits)}" if fits else ""
            words = f"{_called([column])} reaches {most:.4g} in SI, more than {highest:g}{likely}"
            yield Finding("range", False, words)


def _others(column: Column) -> list[tuple[str, float]]:
    """(unit, factor on the SI values) of the units that the column might be in instead."""
    units = UNITS[si_unit(column.spec.field.partition(".")[2])]
    return [(unit, factor / units[column.spec.unit]) for unit, factor in units.items() if unit != column.spec.unit]


def _called(columns: Sequence[Column]) -> str:
    """'column 'v' (report.speed_mps, said to be in km/h)'."""
    names = " and ".join(repr(column.spec.column) for column in columns)
    fields = ", ".join(column.spec.field for column in columns)
    return f"column{'s' if len(columns) > 1 else ''} {names} ({fields}, said to be in {columns[0].spec.unit})"


def _compare(pair: Pair, drive: CsvDrive) -> Finding:
    first = [drive.columns[name] for name in pair.first]
    second = [drive.columns[name] for name in pair.second]
    factor, fit, moved = _judge(pair, drive, 1.0, 1.0)
    called = f"{_called(first)} and {_called(second)}"
    likely = [
        (f"{_quoted(columns)} in {unit}", judged[0])
        for columns, place in ((first, 0), (second, 1))
        for unit, by in _others(columns[0])
        if _fits(pair, judged := _judge(pair, drive, *((by, 1.0) if place == 0 else (1.0, by))))
    ]
    if moved < pair.least:
        return Finding(pair.check, None, f"{called} hardly move: not judged")
    if fit < LEAST_FIT and not (likely and fit < 0.5 * LEAST_FIT):
        return Finding(
            pair.check, None, f"{called} do not follow each other (correlation {fit:.2f}): not judged", factor
        )
    low, high = pair.allowed
    allowed = f"(allowed {low:.3g} to {high:.3g})"
    if fit >= LEAST_FIT and low <= factor <= high:
        return Finding(pair.check, True, f"{called} agree: factor {factor:.3f} {allowed}", factor)
    hint = (
        f"; they agree with {' or with '.join(name for name, _ in sorted(likely, key=_by_nearness))}" if likely else ""
    )
    turned = "; the sign is turned round (ISO 8855: left and forward positive)" if factor < 0.0 and not likely else ""
    apart = f"the second is {factor:.3g} times the first {allowed}"
    apart = apart if fit >= LEAST_FIT else f"they do not follow each other (correlation {fit:.2f})"
    return Finding(pair.check, False, f"{called} contradict each other: {apart}{hint}{turned}", factor)


def _by_nearness(likely: tuple[str, float]) -> float:
    """Nearest to a factor of 1 first."""
    return abs(float(np.log(likely[1])))


def _quoted(columns: Sequence[Column]) -> str:
    return " and ".join(repr(column.spec.column) for column in columns)


def _fits(pair: Pair, judged: tuple[float, float, float]) -> bool:
    factor, fit, moved = judged
    return moved >= pair.least and fit >= LEAST_FIT and LIKELY[0] <= factor <= LIKELY[1]


def _judge(pair: Pair, drive: CsvDrive, by_first: float, by_second: float) -> tuple[float, float, float]:
    """(factor, size of the correlation, greatest movement), the SI values being multiplied by these."""
    first = [_sample(drive, name, by_first if place == 0 else 1.0) for place, name in enumerate(pair.first)]
    second = [_sample(drive, name, by_second) for name in pair.second]
    edges = _edges([*first, *second])
    if len(edges) < LEAST_WINDOWS:
        return 0.0, 0.0, 0.0
    a, b = pair.windows(first, second, edges)
    if pair.centred:
        a, b = a - a.mean(), b - b.mean()
    squares = float(a @ a) * float(b @ b)
    if squares <= 0.0:
        return 0.0, 0.0, max(float(np.abs(a).sum()), float(np.abs(b).sum()))
    fit = float(a @ b) / squares**0.5
    factor = float(a @ b) / float(a @ a)
    return factor, abs(fit), max(float(np.abs(a).sum()), float(np.abs(b).sum()))


def _sample(drive: CsvDrive, name: str, factor: float) -> Sample:
    column = drive.columns[name]
    return drive.time_s[column.sent], column.values[column.sent] * factor


def _edges(samples: Sequence[Sample]) -> Array:
    """(begin, end) of the windows in which every sample is measured without a silence; shape (n, 2)."""
    if any(times.size < 2 for times, _ in samples):
        return np.empty((0, 2))
    begin, end = max(times[0] for times, _ in samples), min(times[-1] for times, _ in samples)
    begins = np.arange(begin, end - WINDOW_S, WINDOW_S)
    whole = np.ones(len(begins), dtype=bool)
    for times, _ in samples:
        limit_s = max(WINDOW_S, 2.0 * float(np.median(np.diff(times))))
        for i in np.flatnonzero(np.diff(times) > limit_s):
            whole &= (begins >= times[i + 1]) | (begins + WINDOW_S <= times[i])
    return np.column_stack([begins, begins + WINDOW_S])[whole]


def _integral(sample: Sample, edges: Array) -> Array:
    """The integral over each window (trapezoids)."""
    times, values = sample
    total = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(times))])
    return np.diff(np.interp(edges, times, total), axis=1)[:, 0]


def _change(sample: Sample, edges: Array) -> Array:
    return np.diff(np.interp(edges, *sample), axis=1)[:, 0]


def _way(first: Sequence[Sample], second: Sequence[Sample], edges: Array) -> tuple[Array, Array]:
    """Speed's integral, and the distance between the positions at the window's ends."""
    speed = (first[0][0], np.abs(first[0][1]))
    return _integral(speed, edges), np.hypot(_change(second[0], edges), _change(second[1], edges))


def _turn(first: Sequence[Sample], second: Sequence[Sample], edges: Array) -> tuple[Array, Array]:
    """Yaw rate's integral, and the change of a heading that may wrap."""
    times, heading = second[0]
    return _integral(first[0], edges), _change((times, np.unwrap(heading)), edges)


def _speeding(first: Sequence[Sample], second: Sequence[Sample], edges: Array) -> tuple[Array, Array]:
    return _integral(first[0], edges), _change(second[0], edges)


def _same(first: Sequence[Sample], second: Sequence[Sample], edges: Array) -> tuple[Array, Array]:
    return _integral(first[0], edges), _integral(second[0], edges)


def _steering(yaw: str, wheelbase_m: float, steer_ratio: float) -> Pair:
    """Speed times the kinematic curvature against a yaw rate; understeer makes the factor small."""

    def windows(first: Sequence[Sample], second: Sequence[Sample], edges: Array) -> tuple[Array, Array]:
        (times, steer), speed = first
        curvature = np.tan(np.clip(steer / steer_ratio, -1.4, 1.4)) / wheelbase_m
        return _integral((times, curvature * np.interp(times, *speed)), edges), _integral(second[0], edges)

    return Pair("steer_and_yaw_rate", ("report.steer_rad", "report.speed_mps"), (yaw,), (0.3, 2.0), 0.3, windows)


def _course(first: Sequence[Sample], second: Sequence[Sample], edges: Array) -> tuple[Array, Array]:
    """The change of heading, and that of the course over ground, from one moving window to the next."""
    times, heading = first[0]
    dx, dy = _change(second[0], edges), _change(second[1], edges)
    way = np.hypot(dx, dy)
    moving = way > 0.2 * way.max(initial=0.0)
    pairs = moving[1:] & moving[:-1] & (np.abs(np.diff(edges[:, 0]) - WINDOW_S) < 1e-6)
    middle = np.interp(edges.mean(axis=1), times, np.unwrap(heading))
    turned = np.diff(np.arctan2(dy, dx))
    return np.diff(middle)[pairs], (np.mod(turned + np.pi, 2.0 * np.pi) - np.pi)[pairs]


PLACE = ("ins.x_m", "ins.y_m")
HALF = (1.0 / 1.5, 1.5)
WIDE = (0.45, 2.2)  # an acceleration's own noise makes its factor small
PAIRS = (
    *(Pair("speed_and_path", (name,), PLACE, HALF, 2.0, _way) for name in ("report.speed_mps", "ins.speed_mps")),
    *(
        Pair("yaw_rate_and_heading", (name,), ("ins.heading_rad",), HALF, 0.3, _turn)
        for name in ("report.yaw_rate_radps", "ins.yaw_rate_radps")
    ),
    *(
        Pair("accel_and_speed", (f"{group}.accel_mps2",), (f"{other}.speed_mps",), WIDE, 2.0, _speeding, centred=True)
        for group, other in (("report", "report"), ("ins", "ins"), ("report", "ins"))
    ),
    Pair("heading_and_path", ("ins.heading_rad",), PLACE, (0.5, 2.0), 0.5, _course),
    Pair("same_quantity", ("report.speed_mps",), ("ins.speed_mps",), HALF, 2.0, _same),
    Pair("same_quantity", ("report.yaw_rate_radps",), ("ins.yaw_rate_radps",), HALF, 0.3, _same),
    Pair("same_quantity", ("report.steer_command_rad",), ("report.steer_rad",), (0.4, 2.5), 0.3, _same),
    Pair("same_quantity", ("command.steer_rad",), ("report.steer_rad",), (0.4, 2.5), 0.3, _same),
)
