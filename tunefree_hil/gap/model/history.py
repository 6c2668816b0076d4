"""Recent results of a simulation by drive and values, and signals shifted in time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

Array = np.ndarray

MAX_RESULTS = 4  # kept for each drive


class ResultCache:
    """The last results of one half of the graph, by drive and the values that it depends on."""

    def __init__(self) -> None:
        self._results: dict[tuple[int, Any], tuple[Any, Array]] = {}

    def get(self, x: Any, values: Mapping[str, float]) -> Array | None:
        """The result of these values for this very drive object, or None."""
        key = (id(x), tuple(sorted(values.items())))
        if key not in self._results or self._results[key][0] is not x:
            return None
        self._results[key] = self._results.pop(key)
        return self._results[key][1]

    def store(self, x: Any, values: Mapping[str, float], result: Array) -> Array:
        """Keep a result and delete the drive's least recently used one if there are too many; returns the result."""
        of_drive = [key for key in self._results if key[0] == id(x)]
        if len(of_drive) >= MAX_RESULTS:
            del self._results[of_drive[0]]
        self._results[(id(x), tuple(sorted(values.items())))] = (x, result)
        return result


def shift_earlier(values: Array, rows: float) -> Array:
    """A signal `rows` rows earlier, (n_rows,) or (n_rows, k).

    Fractions of a row are interpolated; the ends are held. Negative `rows` shift it later.
    """
    whole = math.floor(rows)
    share = rows - whole
    first = _shift_rows(values, whole)
    return first + share * (_shift_rows(values, whole + 1) - first) if share else first


def _shift_rows(values: Array, rows: int) -> Array:
    """A signal by whole rows earlier, held at its ends."""
    count, shifted = len(values), np.empty_like(values)
    by = min(abs(rows), count - 1)
    if rows >= 0:
        shifted[: count - by], shifted[count - by :] = values[by:], values[-1]
    else:
        shifted[by:], shifted[:by] = values[: count - by], values[0]
    return shifted
