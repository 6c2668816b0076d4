"""Intervals of 95 %: of a share (Wilson), of a median or another quantile (order statistics)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

Z = 1.959963984540054


class Figure(NamedTuple):
    """A value with n and its interval; value None where n is 0."""

    value: float | None
    low: float | None
    high: float | None
    n: int


def share(hits: int, n: int) -> Figure:
    """A share by Wilson's interval."""
    if n == 0:
        return Figure(None, None, None, 0)
    p, z2 = hits / n, Z * Z
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = Z / (1 + z2 / n) * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    low, high = (0.0 if hits == 0 else middle - half), (1.0 if hits == n else middle + half)
    return Figure(p, low, high, n)


def quantile(values: Sequence[float], q: float) -> Figure:
    """A quantile, its interval by the binomial's normal approximation (min and max for n < 6)."""
    ordered = sorted(values)
    n = len(ordered)
    if n == 0:
        return Figure(None, None, None, 0)
    half = Z * math.sqrt(n * q * (1 - q))
    low = min(max(0, math.floor(n * q - half)), n - 1) if n >= 6 else 0
    high = min(n - 1, math.ceil(n * q + half)) if n >= 6 else n - 1
    return Figure(_at(ordered, q), ordered[low], ordered[high], n)


def _at(ordered: Sequence[float], q: float) -> float:
    place = q * (len(ordered) - 1)
    whole = math.floor(place)
    above = ordered[min(whole + 1, len(ordered) - 1)]
    return ordered[whole] + (place - whole) * (above - ordered[whole])


def mean(values: Sequence[float]) -> Figure:
    """A mean with its normal interval."""
    n = len(values)
    if n == 0:
        return Figure(None, None, None, 0)
    middle = math.fsum(values) / n
    spread = math.sqrt(math.fsum((v - middle) ** 2 for v in values) / max(n - 1, 1))
    half = Z * spread / math.sqrt(n)
    return Figure(middle, middle - half, middle + half, n)
