"""What flags say, one a tick: where they hold in a row, where they hold all about, and how far apart they are."""

from __future__ import annotations

import numpy as np

Array = np.ndarray

SILENCE_S = 0.25  # beyond which a signal has a gap


def runs(flags: Array, least: int = 1, first: int = 0) -> list[tuple[int, int]]:
    """Runs of True (flags: bool [n]) of at least `least` rows as [begin, end), counted from `first`."""
    edges = np.diff(np.concatenate(([0], flags.astype(np.int8), [0])))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return [(first + int(b), first + int(e)) for b, e in zip(begins, ends, strict=True) if e - b >= least]


def throughout(flags: Array, before: int, behind: int) -> Array:
    """bool [n]: rows with True from `before` rows before them to `behind` rows behind them; beyond both ends nothing
    holds.
    """
    gaps = np.concatenate([[0], np.cumsum(~flags)])
    rows = np.arange(len(flags))
    begin, end = rows - before, rows + behind + 1
    inside = (begin >= 0) & (end <= len(flags))
    found = np.zeros(len(flags), dtype=bool)
    found[inside] = gaps[end[inside]] == gaps[begin[inside]]
    return found


def every_of(fresh: Array) -> float:
    """The usual number of ticks from one True to the next, which may be half a tick more; 1 where there are not two."""
    rows = np.flatnonzero(fresh)
    return max(float(np.median(np.diff(rows))), 1.0) if len(rows) > 1 else 1.0


def there_of(fresh: Array, dt_s: float) -> Array:
    """bool [n]: rows between two True that are no gap apart."""
    rows = np.flatnonzero(fresh)
    there = np.zeros(len(fresh), dtype=bool)
    if len(rows):
        there[rows[0] : rows[-1] + 1] = True
    for i in np.flatnonzero(np.diff(rows) > 2.0 * every_of(fresh) + SILENCE_S / dt_s):
        there[rows[i] + 1 : rows[i + 1]] = False
    return there
