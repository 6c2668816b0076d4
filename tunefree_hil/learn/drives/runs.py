"""Runs of True in an array of flags, and the spacing of fresh values."""

from __future__ import annotations

import numpy as np

Array = np.ndarray

MAX_SILENCE_S = 0.25  # a signal has a gap after two of its usual intervals plus this time


def find_runs(flags: Array, min_rows: int = 1, first_row: int = 0) -> list[tuple[int, int]]:
    """Runs of True as [begin, end).

    Args:
        flags: shape (n_rows,).
        min_rows: shorter runs are left out.
        first_row: the number of the first row.
    """
    edges = np.diff(np.concatenate(([0], flags.astype(np.int8), [0])))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [
        (first_row + int(begin), first_row + int(end))
        for begin, end in zip(begins, ends, strict=True)
        if end - begin >= min_rows
    ]


def true_throughout(flags: Array, rows_before: int, rows_after: int) -> Array:
    """Rows around which all flags are True, shape (n_rows,); flags beyond both ends count as False."""
    n_false = np.concatenate([[0], np.cumsum(~flags)])
    rows = np.arange(len(flags))
    begin, end = rows - rows_before, rows + rows_after + 1
    is_inside = (begin >= 0) & (end <= len(flags))
    is_true = np.zeros(len(flags), dtype=bool)
    is_true[is_inside] = n_false[end[is_inside]] == n_false[begin[is_inside]]
    return is_true


def sample_interval_ticks(fresh: Array) -> float:
    """The median number of ticks between two fresh values, also 2.5; at least 1, and 1 for fewer than two values."""
    rows = np.flatnonzero(fresh)
    return max(float(np.median(np.diff(rows))), 1.0) if len(rows) > 1 else 1.0


def covered_rows(fresh: Array, dt_s: float) -> Array:
    """Rows between two fresh values with no gap between them, shape (n_rows,)."""
    rows = np.flatnonzero(fresh)
    is_covered = np.zeros(len(fresh), dtype=bool)
    if len(rows):
        is_covered[rows[0] : rows[-1] + 1] = True
    for i in np.flatnonzero(np.diff(rows) > 2.0 * sample_interval_ticks(fresh) + MAX_SILENCE_S / dt_s):
        is_covered[rows[i] + 1 : rows[i + 1]] = False
    return is_covered
