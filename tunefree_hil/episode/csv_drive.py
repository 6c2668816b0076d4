"""A test drive in a CSV, read by its mapping file into columns in SI. Nothing is filled or sorted."""

from __future__ import annotations

import csv
import math
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.find import nearest
from tunefree_hil.config.import_schema import CLOCK_UNITS, ColumnSpec, ImportSpec, to_si

NO_VALUE = ("", "nan", "na", "n/a", "null", "none", "-")
GAP_STEPS = 3.0  # a silence of this many usual steps is a gap


class Gap(NamedTuple):
    """A silence: of all rows (`what` is ''), or of one field whose cells are empty."""

    what: str
    begin_s: float
    end_s: float


class Column(NamedTuple):
    """One record field: SI values by row, NaN where the cell holds none; `sent`: rows that are a measurement."""

    spec: ColumnSpec
    values: NDArray[np.float64]
    sent: NDArray[np.bool_]


class CsvDrive(NamedTuple):
    """time_s by row, the columns by record field ('report.speed_mps'), the gaps, the usual step between rows.

    enabled: by row 1 where by-wire control was enabled, 0 where not, NaN for an empty cell; None without a column.
    """

    time_s: NDArray[np.float64]
    columns: dict[str, Column]
    gaps: list[Gap]
    step_s: float
    enabled: NDArray[np.float64] | None = None

    def held_out(self, name: str) -> int:
        """How many cells of a column hold no value."""
        return int(np.isnan(self.columns[name].values).sum())


def read_csv_drive(path: Path, spec: ImportSpec) -> CsvDrive:
    """Read all rows. InputError with file and line for a bad number, a bad row, or times not in order."""
    lines, numbers = array("q"), array("d")
    try:
        for line, row in _cells(path, spec):
            lines.append(line)
            numbers.extend(_number(text, name, line, path, spec) for name, text in row)
    except csv.Error as error:
        raise InputError(f"no CSV: {error}", code="bad_line", file=str(path), hint="export it again") from error
    if not lines:
        raise InputError("there is no row below the head", code="empty_log", file=str(path), hint="export it again")
    table = np.array(numbers).reshape(len(lines), -1)
    by_name = {name: table[:, i] for i, name in enumerate(_wanted(spec))}
    time_s = _clock(by_name[spec.clock.column], lines, path, spec)
    step_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else math.nan
    columns = {one.field: _column(one, by_name, time_s) for one in spec.columns}
    gap_s = spec.clock.gap_s or GAP_STEPS * step_s
    return CsvDrive(time_s, columns, list(_gaps(time_s, columns, gap_s)), step_s, _enabled(by_name, spec))


def _wanted(spec: ImportSpec) -> list[str]:
    """The columns that are read, each once."""
    names = [spec.clock.column, *(one.column for one in spec.columns)]
    names += [spec.enabled.column] if spec.enabled is not None else []
    return list(dict.fromkeys([*names, *(one.new_when for one in spec.columns if one.new_when)]))


def _cells(path: Path, spec: ImportSpec) -> Iterator[tuple[int, list[tuple[str, str]]]]:
    """(line, [(column, text), ...]) of each row, wanted columns only."""
    if not path.is_file():
        raise InputError("there is no such file", code="no_log", file=str(path), hint="check the path")
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        rows = csv.reader(file, delimiter=spec.delimiter)
        head = [name.strip() for name in next(rows, [])]
        if not any(head):
            raise InputError("the file is empty", code="empty_log", file=str(path), hint="export it again")
        places = [(name, _place(name, head, path, spec)) for name in _wanted(spec)]
        for row in rows:
            if len(row) == len(head):
                yield rows.line_num, [(name, row[place]) for name, place in places]
            elif row:
                raise InputError(
                    f"the row has {len(row)} cells, the head has {len(head)}",
                    code="truncated_log" if len(row) < len(head) else "bad_line",
                    file=f"{path}:{rows.line_num}",
                    hint="is the file cut off here? delete this line to use what is before it",
                )


def _place(name: str, head: Sequence[str], path: Path, spec: ImportSpec) -> int:
    if head.count(name) != 1:
        problem = f"there are {head.count(name)} columns" if name in head else "no column"
        hint = nearest(name, head)
        if len(head) == 1:
            hint = f"the head is one cell: is {spec.delimiter!r} its delimiter?"
        raise InputError(f"{problem} named {name!r}", code="no_column", file=f"{path}:1", key=name, hint=hint)
    return head.index(name)


def _number(text: str, name: str, line: int, path: Path, spec: ImportSpec) -> float:
    """A cell's number; NaN where it is empty. Infinities are refused."""
    text = text.strip()
    if text.lower() in NO_VALUE:
        return math.nan
    try:
        value = float(text.replace(",", ".") if spec.decimal == "," else text)
    except ValueError:
        value = math.inf
    if math.isinf(value):
        raise InputError(
            f"{text!r} in column {name!r} is no number",
            code="bad_cell",
            file=f"{path}:{line}",
            key=name,
            hint="leave the cell empty where nothing was measured",
        )
    return value


def _clock(cells: NDArray[np.float64], lines: Sequence[int], path: Path, spec: ImportSpec) -> NDArray[np.float64]:
    """Seconds, strictly rising. InputError with the first line that is not."""
    name, unit = spec.clock.column, spec.clock.unit
    time_s = cells * CLOCK_UNITS[unit]
    missing = np.flatnonzero(np.isnan(time_s))
    if missing.size:
        raise InputError(
            f"the clock {name!r} has no value ({missing.size} rows)",
            code="no_time",
            file=f"{path}:{lines[missing[0]]}",
            key="clock.column",
            hint="delete these rows, or name another clock",
        )
    wrong = np.flatnonzero(np.diff(time_s) <= 0.0)
    if wrong.size:
        before, after = cells[wrong[0]], cells[wrong[0] + 1]
        same = before == after
        count = f"{wrong.size} such {'place' if wrong.size == 1 else 'places'} in all"
        raise InputError(
            f"the clock {name!r} {'stands still at' if same else 'goes back from'} {before:.6f}"
            f"{'' if same else f' to {after:.6f}'} {unit} ({count})",
            code="repeated_time" if same else "unsorted_time",
            file=f"{path}:{lines[wrong[0] + 1]}",
            key="clock.column",
            hint="sort the rows by time and drop doubles yourself, or name another clock: nothing is re-ordered here",
        )
    if time_s[0] < 0.0:
        raise InputError(
            f"the clock begins at {time_s[0]:g} s", code="negative_time", file=f"{path}:{lines[0]}", hint="start at 0"
        )
    return time_s


def _column(spec: ColumnSpec, by_name: dict[str, NDArray[np.float64]], time_s: NDArray[np.float64]) -> Column:
    values = (by_name[spec.column] * spec.scale + spec.offset) * to_si(spec)
    sent = ~np.isnan(values)
    if spec.new_when:
        mark = by_name[spec.new_when]
        sent &= np.concatenate([[True], np.diff(mark) != 0.0])
    if spec.period_ms:
        sent = _thinned(sent, time_s, spec.period_ms / 1000.0)
    return Column(spec, values, sent)


def _enabled(by_name: dict[str, NDArray[np.float64]], spec: ImportSpec) -> NDArray[np.float64] | None:
    if spec.enabled is None:
        return None
    cells = by_name[spec.enabled.column]
    return np.where(np.isnan(cells), math.nan, cells == spec.enabled.active)


def _thinned(sent: NDArray[np.bool_], time_s: NDArray[np.float64], period_s: float) -> NDArray[np.bool_]:
    """At most one row a period: the first of each on the grid that begins with the first row."""
    is_kept = np.zeros_like(sent)
    rows = np.flatnonzero(sent)
    slots = np.floor((time_s[rows] - time_s[0]) / period_s + 1e-6)
    is_kept[rows[np.concatenate([[True], np.diff(slots) > 0.0])] if rows.size else rows] = True
    return is_kept


def _gaps(time_s: NDArray[np.float64], columns: dict[str, Column], gap_s: float) -> Iterator[Gap]:
    """Silences of the whole file, and of single columns whose cells are empty for as long."""
    for i in np.flatnonzero(np.diff(time_s) > gap_s):
        yield Gap("", float(time_s[i]), float(time_s[i + 1]))
    for name, column in columns.items():
        empty = np.isnan(column.values)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], empty.astype(int), [0]])))
        for begin, end in edges.reshape(-1, 2):
            first_s = time_s[max(begin - 1, 0)]
            last_s = time_s[min(end, len(time_s) - 1)]
            if last_s - first_s > gap_s:
                yield Gap(name, float(first_s), float(last_s))
