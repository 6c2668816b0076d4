"""What a drive gave a moment ago, and signals moved in time: what the graph needs of a drive, and no car."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

Array = np.ndarray

RECENT = 4  # results that are kept for each drive


class Recent:
    """The newest results of one half of the graph, by the drive and the values that it feels."""

    def __init__(self) -> None:
        self._kept: dict[tuple[int, Any], tuple[Any, Array]] = {}

    def found(self, x: Any, values: Mapping[str, float]) -> Array | None:
        """What these values gave for this very drive; None where that is not known any more."""
        key = (id(x), tuple(sorted(values.items())))
        if key not in self._kept or self._kept[key][0] is not x:
            return None
        self._kept[key] = self._kept.pop(key)
        return self._kept[key][1]

    def keep(self, x: Any, values: Mapping[str, float], result: Array) -> Array:
        """Keep a result, which is given back, and forget the one that was asked for longest ago."""
        mine = [key for key in self._kept if key[0] == id(x)]
        if len(mine) >= RECENT:
            del self._kept[mine[0]]
        self._kept[(id(x), tuple(sorted(values.items())))] = (x, result)
        return result


def ahead(values: Array, rows: float) -> Array:
    """A signal `rows` rows earlier, parts of a row by a straight line; held at its end. [n] or [n, k]."""
    whole = math.floor(rows)
    share = rows - whole
    first = _moved(values, whole)
    return first + share * (_moved(values, whole + 1) - first) if share else first


def _moved(values: Array, rows: int) -> Array:
    """A signal by whole rows earlier, held at its ends."""
    count, found = len(values), np.empty_like(values)
    by = min(abs(rows), count - 1)
    if rows >= 0:
        found[: count - by], found[count - by :] = values[by:], values[-1]
    else:
        found[by:], found[:by] = values[: count - by], values[0]
    return found
