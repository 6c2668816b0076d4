"""Intervals of 95 %: of a share (Wilson), of a median or another quantile (order statistics), of a mean (normal); and
of any of them where logs share models, by drawing whole models.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from typing import NamedTuple

import numpy as np

Z = 1.959963984540054
EDGES = (0.025, 0.975)
DRAWS, SEED = 1000, 1  # of models; the seed is fixed, so that a table is the same whenever it is counted


class Figure(NamedTuple):
    """A value with n and its interval; value None where n is 0."""

    value: float | None
    low: float | None
    high: float | None
    n: int


def share(hits: float, n: int) -> Figure:
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


def by_models(
    figure: Figure, values: Sequence[float], models: Sequence[Hashable], of: Callable[[np.ndarray], float]
) -> Figure:
    """A figure with its interval from a bootstrap that draws whole models: the logs of one are no new witnesses.

    models: of every value; of: what makes the figure out of values. The interval is never narrower than that of as many
    logs of their own: of one model, or of two that happen to be alike, the draws differ too little.
    """
    return _widened(figure, _drawn(values, models, of)) if figure.n else figure


def share_by_models(hits: Sequence[bool], models: Sequence[Hashable]) -> Figure:
    """A share of logs that share models."""
    plain, values = share(sum(hits), len(hits)), [float(hit) for hit in hits]
    if plain.value is None:
        return plain
    low, high = _drawn(values, models, lambda some: float(some.mean()))
    if low != high:
        return _widened(plain, (low, high))
    # All right or all wrong (or every model alike): no draw differs, which is no certainty. So many models are so many
    # witnesses, and Wilson knows what that says.
    n = len(set(models))
    return share(plain.value * n, n)._replace(value=plain.value, n=plain.n)


def _widened(figure: Figure, to: tuple[float, float]) -> Figure:
    low, high = (other if edge is None else edge for edge, other in zip(figure[1:3], to, strict=True))
    return figure._replace(low=min(low, to[0]), high=max(high, to[1]))


def _drawn(
    values: Sequence[float], models: Sequence[Hashable], of: Callable[[np.ndarray], float]
) -> tuple[float, float]:
    """The 95 % of a figure over draws of whole models, with replacement."""
    groups: dict[Hashable, list[float]] = {}
    for value, model in zip(values, models, strict=True):
        groups.setdefault(model, []).append(float(value))
    each = [np.array(group) for group in groups.values()]
    draws = np.random.default_rng(SEED).integers(len(each), size=(DRAWS, len(each)))
    low, high = np.quantile([of(np.concatenate([each[k] for k in some])) for some in draws], EDGES)
    return float(low), float(high)
