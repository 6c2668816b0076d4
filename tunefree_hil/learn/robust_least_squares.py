"""Least squares whose intervals are honest about residuals that hang together.

The residuals of a simulation are correlated over time, so their number says little. Each belongs to a block (a stretch
of a drive); blocks are taken as independent, rows of one block not (the sandwich of White 1980 and Liang and Zeger 1986
with blocks as clusters). With few blocks the plain covariance, stretched by the residuals' correlation length, is taken
where it is the wider.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

Array = np.ndarray
Residuals = Callable[[Array], Array]

STEP = 1e-3  # of a scaled unknown, for differences
INSIDE, WARM = 0.3, 0.02  # how far from its bounds a search begins, cold, and from what was found before
FEW_BLOCKS = 30
CONFIDENCE = 0.95


class Least(NamedTuple):
    """x [p]; deviation [p]: standard deviations; quantile: how many of them the interval is to each side.

    jacobian [n, p] and residuals [n] at x, both with the robust weights in them; rms: root of the mean square of the
    residuals without those weights.
    """

    x: Array
    deviation: Array
    quantile: float
    jacobian: Array
    residuals: Array
    rms: float

    def interval(self, i: int) -> tuple[float, float]:
        """Ends of the 95 % interval of unknown i."""
        half = self.quantile * self.deviation[i]
        return float(self.x[i] - half), float(self.x[i] + half)


def solve(
    residuals: Residuals,
    start: Array,
    low: Array,
    high: Array,
    blocks: Array,
    *,
    robust: float = 0.0,
    most: int = 40,
    priors: int = 0,
    inside: float = INSIDE,
) -> Least:
    """Minimise the sum of squares from `start` within [low, high].

    Unknowns must be scaled so that 1 is a large step. blocks [n - priors]: the block of each residual; the last
    `priors` residuals are prior knowledge and not data. robust: 0 for plain squares, else the residual from which on
    they count less (soft L1). inside: how far from its bounds the search begins; WARM where one was found before.
    """

    def slopes(x: Array) -> Array:
        return differences(residuals, x, low, high)

    room = np.minimum(inside, 0.1 * (high - low))
    start = np.clip(start, low + room, high - room)  # at a bound the search would take no step at all
    loss = "soft_l1" if robust > 0.0 else "linear"
    found = least_squares(
        residuals, start, jac=cast(Any, slopes), bounds=(low, high), loss=loss, f_scale=robust or 1.0, max_nfev=most,
        xtol=1e-6, ftol=1e-8, gtol=1e-10,
    )  # fmt: skip
    rows = residuals(found.x)
    weights = (1.0 + (rows / robust) ** 2) ** -0.25 if robust > 0.0 else np.ones(len(rows))
    jacobian = differences(residuals, found.x, low, high, both=True) * weights[:, None]
    deviation, quantile = deviations(jacobian, rows * weights, blocks, priors)
    data = rows[: len(rows) - priors]
    rms = float(np.sqrt(np.mean(data * data)))
    return Least(found.x, deviation, quantile, jacobian, rows * weights, rms)


def differences(residuals: Residuals, x: Array, low: Array, high: Array, both: bool = False) -> Array:
    """The Jacobian by differences of STEP, one-sided (inwards at a bound) or to both sides where there is room."""
    here = residuals(x)
    columns = []
    for i in range(len(x)):
        ahead, behind = x.copy(), x.copy()
        ahead[i] = min(x[i] + STEP, high[i])
        if both or ahead[i] <= x[i]:
            behind[i] = max(x[i] - STEP, low[i])
        width = ahead[i] - behind[i]
        upper = here if ahead[i] == x[i] else residuals(ahead)
        lower = here if behind[i] == x[i] else residuals(behind)
        columns.append((upper - lower) / width if width > 0.0 else np.zeros(len(here)))
    return np.stack(columns, axis=1)


def deviations(jacobian: Array, rows: Array, blocks: Array, priors: int = 0) -> tuple[Array, float]:
    """(standard deviations, their quantile for 95 %) from weighted Jacobian and residuals."""
    bread = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    n = len(rows) - priors
    scores = jacobian[:n] * rows[:n, None]
    _, index = np.unique(blocks, return_inverse=True)
    count = int(index.max()) + 1
    sums = np.zeros((count, jacobian.shape[1]))
    np.add.at(sums, index, scores)
    meat = sums.T @ sums * (count / max(count - 1, 1))
    clustered = np.sqrt(np.maximum(np.diag(bread @ meat @ bread), 0.0))
    quantile = float(student.ppf(0.5 + 0.5 * CONFIDENCE, max(count - 1, 1))) if count > 1 else 12.7
    if count >= FEW_BLOCKS:
        return clustered, quantile
    variance = float(rows[:n] @ rows[:n]) / max(n - jacobian.shape[1], 1)
    plain = np.sqrt(np.maximum(np.diag(bread), 0.0) * variance * correlation_length(rows[:n], blocks))
    return np.maximum(clustered, plain), quantile


def correlation_length(rows: Array, blocks: Array) -> float:
    """1 + 2 * the sum of autocorrelations within blocks up to the first that is not positive; at least 1."""
    energy, sums = 0.0, np.zeros(400)
    for block in np.unique(blocks):
        some = rows[blocks == block]
        energy += float(some @ some)
        for lag in range(1, min(len(some), len(sums))):
            sums[lag] += float(some[lag:] @ some[:-lag])
    length = 1.0
    for lag in range(1, len(sums)):
        if energy <= 0.0 or sums[lag] <= 0.0:
            break
        length += 2.0 * sums[lag] / energy
    return length
