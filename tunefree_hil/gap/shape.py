"""What a residual looks like, for people: how late the car is, how weak, and how far off."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Array = np.ndarray

LONGEST_S = 0.8
CLEAR_LATE_S, CLEAR_GAIN, CLEAR_BIAS = 0.01, 0.02, 0.02  # from here on it is worth a word; bias: of the signal
MOST_GAIN = 5.0  # beyond that a factor is no news of an actuator any more
LEAST_ROWS = 256


class Shape(NamedTuple):
    """The measured signal against the simulated one. late_s: by how much it comes later; gain: factor; bias: amount
    more.
    """

    late_s: float
    gain: float
    bias: float

    def words(self, size: float) -> str:
        """As a person would say it; '' where nothing of it is clear. size: the signal's deviation."""
        said = []
        if abs(self.late_s) >= CLEAR_LATE_S:
            said.append(f"{abs(self.late_s):.2f} s {'late' if self.late_s > 0.0 else 'early'}")
        if abs(self.gain - 1.0) >= CLEAR_GAIN:
            much = f"{abs(self.gain - 1.0):.0%}" if abs(self.gain - 1.0) < MOST_GAIN else "much too"
            said.append(f"{much} {'strong' if self.gain > 1.0 else 'weak'}")
        if abs(self.bias) >= CLEAR_BIAS * size:
            said.append(f"{self.bias:+.3g} off")
        return ", ".join(said)


def shape_of(residual: Sequence[Array], measured: Sequence[Array], valid: Sequence[Array], dt_s: float) -> Shape | None:
    """Of a target, its longest drive; residual: simulated - measured. None where there is too little of it."""
    i = int(np.argmax([one.sum() for one in valid]))
    good, truth = valid[i], measured[i]
    made = truth + residual[i]
    if good.sum() < LEAST_ROWS or np.std(made[good]) < 1e-12:
        return None
    most = round(LONGEST_S / dt_s)
    costs = [_fitted(np.roll(made, s), truth, good)[2] for s in range(-most, most + 1)]
    best = int(np.argmin(costs))
    late = best - most + _between(costs, best)
    gain, bias, _ = _fitted(np.roll(made, best - most), truth, good)
    return Shape(late * dt_s, gain, bias)


def _fitted(made: Array, truth: Array, good: Array) -> tuple[float, float, float]:
    """(gain, bias, squares) of the straight line through simulated and measured."""
    x, y = made[good], truth[good]
    dx, dy = x - x.mean(), y - y.mean()
    square = float(dx @ dx)
    gain = float(dx @ dy) / square if square > 0.0 else 1.0
    return gain, float(y.mean() - gain * x.mean()), float(dy @ dy) - gain * float(dx @ dy)


def _between(costs: Sequence[float], best: int) -> float:
    """The minimum of the parabola through three costs, in places from `best`."""
    if not 0 < best < len(costs) - 1:
        return 0.0
    a, b, c = costs[best - 1 : best + 2]
    curve = a - 2.0 * b + c
    return 0.5 * (a - c) / curve if curve > 0.0 else 0.0
