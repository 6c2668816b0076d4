"""Whether the columns of a test drive contradict each other: integrals compared, so that a swapped unit is caught.

The integral of speed is the distance between positions, that of yaw rate the change of heading, that of acceleration
the change of speed. They are compared over windows of WINDOW_S without a gap. Where two columns do not agree, every
other unit of each is tried, and those with which they agree are named. Columns with little change, or without
correlation (below LEAST_FIT with every unit), are reported as not judged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.config.import_schema import UNITS, si_unit
from tunefree_hil.episode.csv_drive import Column, CsvDrive
from tunefree_hil.episode.plausible_pairs import WINDOW_S, Array, Pair, Sample, pairs_of

LEAST_WINDOWS = 4
COUNTS = 0.1  # share of the least movement from which a window is used, against the sum of noise at standstill
LEAST_FIT = 0.6  # least correlation of two related columns
LIKELY = (0.8, 1.25)  # with a factor in this range another unit is likely
# Greatest absolute SI values that a car (or a model of one) shows, by the end of the field's name.
HIGHEST = {"mps": 120.0, "mps2": 60.0, "radps": 600.0, "frac": 1.5}
HIGHEST_OF = {"yaw_rate_radps": 12.0, "heading_rad": 100.0, "steer_rad": 25.0, "steer_command_rad": 25.0}


class Finding(NamedTuple):
    """Result of a check. holds: None where it could not be judged. factor: second by first, 1 where they agree."""

    check: str
    holds: bool | None
    words: str
    factor: float | None = None


def check_units(
    drive: CsvDrive,
    wheelbase_m: float | None = None,
    steer_ratio: float | None = None,
    wheel_radius_m: float | None = None,
) -> list[Finding]:
    """All checks for the drive's columns; with the car's constants also steering and wheels."""
    problems = list(_ranges(drive))
    for pair in pairs_of(wheelbase_m, steer_ratio, wheel_radius_m):
        if all(name in drive.columns for name in (*pair.first, *pair.second)):
            problems.append(_compare(pair, drive))
    return problems


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
    """'column 'v' (report.speed_mps, given in km/h)'."""
    names = " and ".join(repr(column.spec.column) for column in columns)
    fields = ", ".join(column.spec.field for column in columns)
    return f"column{'s' if len(columns) > 1 else ''} {names} ({fields}, given in {columns[0].spec.unit})"


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


class PairFit(NamedTuple):
    """How two columns agree: factor between them, size of their correlation, greatest movement beyond noise."""

    factor: float
    correlation: float
    moved: float


def _fits(pair: Pair, fit: PairFit) -> bool:
    return fit.moved >= pair.least and fit.correlation >= LEAST_FIT and LIKELY[0] <= fit.factor <= LIKELY[1]


def _judge(pair: Pair, drive: CsvDrive, by_first: float, by_second: float) -> PairFit:
    """Compare two groups of columns whose SI values are multiplied by these factors."""
    unit = _unit(pair.first[0])  # of the four wheels all, of steering and speed the steering
    first = [_sample(drive, name, by_first if _unit(name) == unit else 1.0) for name in pair.first]
    second = [_sample(drive, name, by_second) for name in pair.second]
    edges = _edges([*first, *second])
    if len(edges) < LEAST_WINDOWS:
        return PairFit(0.0, 0.0, 0.0)
    a, b = pair.windows(first, second, edges)
    if pair.centred:
        a, b = a - a.mean(), b - b.mean()
    moved = max(_moved(a, pair.least), _moved(b, pair.least))
    squares = float(a @ a) * float(b @ b)
    if squares <= 0.0:
        return PairFit(0.0, 0.0, moved)
    fit = float(a @ b) / squares**0.5
    factor = float(a @ b) / float(a @ a)
    return PairFit(factor, abs(fit), moved)


def _moved(windows: Array, least: float) -> float:
    """Sum of all movement; of quantities without a sign that beyond noise, as their noise does not cancel."""
    size = np.abs(windows)
    return float(size[size > COUNTS * least].sum() if (windows >= 0.0).all() else size.sum())


def _unit(name: str) -> str:
    return si_unit(name.partition(".")[2])


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
