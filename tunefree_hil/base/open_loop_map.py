"""The open-loop map in a `calibration.npz`: triples of speed, acceleration and command (brake negative).

The controller reads it backwards (acceleration -> command), the plant `rule_based` forwards (command -> acceleration).
In both cases the triples are rows by speed: linear within a row, linear between rows, constant beyond the ends.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import kernel, table
from tunefree_hil.base.maths import find_cell, find_cell_between

MAP_FILE = "calibration.npz"  # in a model folder
KEYS = ("speed_mps", "accel_mps2", "command_frac")
UNREADABLE = (OSError, ValueError, TypeError, EOFError, RuntimeError, BadZipFile, zlib.error)


class Refusal(NamedTuple):
    """Errors of a reader: code and key of a missing file, code of a file that is no map, hint."""

    missing: str
    unfit: str
    hint: str
    missing_key: str = ""


class Triples(NamedTuple):
    """The three columns, equally long: speed in m/s, acceleration in m/s2, command as a share of full pedal."""

    speed_mps: list[float]
    accel_mps2: list[float]
    command_frac: list[float]


class SpeedRows(NamedTuple):
    """Speeds ascending; the points of row i are first[i] <= k < first[i + 1], strictly ascending in `at`."""

    speed_mps: Any
    first: Any
    at: Any
    value: Any


def read_triples(path: Path, refusal: Refusal) -> Triples:
    """The triples of a `calibration.npz`, at least one. Raises InputError for a file that is not valid."""
    if not path.is_file():
        code, key = refusal.missing, refusal.missing_key
        raise InputError("no such file", code=code, file=str(path), key=key, hint=refusal.hint)
    try:
        columns = _columns(path)
    except UNREADABLE as error:
        raise _unfit(f"cannot be read: {error}", path, refusal) from error
    lacking = [key for key in KEYS if key not in columns]
    if lacking:
        raise _unfit(f"lacks {', '.join(lacking)}", path, refusal)
    if any(column.ndim != 1 or not np.all(np.isfinite(column)) for column in columns.values()):
        raise _unfit("holds arrays that are not one-dimensional and finite", path, refusal)
    sizes = [columns[key].size for key in KEYS]
    if len(set(sizes)) > 1 or sizes[0] == 0:
        words = f"{', '.join(KEYS)} have {', '.join(map(str, sizes))} values, expected equally many, at least 1"
        raise _unfit(words, path, refusal)
    return Triples(*(columns[key].tolist() for key in KEYS))


def _columns(path: Path) -> dict[str, np.ndarray]:
    """The arrays of KEYS in the file."""
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        return {key: np.asarray(archive[key], dtype=np.float64) for key in KEYS if key in archive.files}


def _unfit(message: str, path: Path, refusal: Refusal) -> InputError:
    return InputError(message, code=refusal.unfit, file=str(path), hint=refusal.hint)


def rows_by_speed(speed_mps: Sequence[float], keys: Sequence[float], value: Sequence[float]) -> SpeedRows:
    """Rows of `value` over `at`; of a repeated (speed, at) pair the last one is used (docs/reference/apollo.md).

    Raises ValueError for columns of unequal length, or empty ones.
    """
    rows: dict[float, dict[float, float]] = {}
    for speed, place, row_value in zip(speed_mps, keys, value, strict=True):
        rows.setdefault(float(speed), {})[float(place)] = float(row_value)
    if not rows:
        raise ValueError("a map has one point or more")
    first, places, values = [0], [], []
    for speed in sorted(rows):
        pairs = sorted(rows[speed].items())
        places += [place for place, _ in pairs]
        values += [row_value for _, row_value in pairs]
        first.append(len(places))
    return SpeedRows(table(sorted(rows)), table(first), table(places), table(values))


@kernel
def value_in_row(rows: SpeedRows, row: int, key: float) -> float:
    """Linear within one speed, constant beyond the ends."""
    places, values = rows.at, rows.value
    low, high = int(rows.first[row]), int(rows.first[row + 1]) - 1
    if key <= places[low]:
        return float(values[low])
    if key >= places[high]:
        return float(values[high])
    i = find_cell_between(places, low, high, key)
    share = (key - places[i]) / (places[i + 1] - places[i])  # not 0: strictly ascending
    return float(values[i] + share * (values[i + 1] - values[i]))


@kernel
def value_at(rows: SpeedRows, speed_mps: float, key: float) -> float:
    """Linear between the two bracketing speeds, constant beyond the ends."""
    speeds = rows.speed_mps
    last = len(speeds) - 1
    if speed_mps <= speeds[0]:
        return value_in_row(rows, 0, key)
    if speed_mps >= speeds[last]:
        return value_in_row(rows, last, key)
    i = find_cell(speeds, speed_mps)
    share = (speed_mps - speeds[i]) / (speeds[i + 1] - speeds[i])  # not 0: strictly ascending
    below = value_in_row(rows, i, key)
    return below + share * (value_in_row(rows, i + 1, key) - below)
