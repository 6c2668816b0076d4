"""Least squares with confidence intervals that allow for correlated residuals.

The residuals of a simulation are correlated over time. Each belongs to a block (a stretch of a drive); blocks count as
independent, rows within a block do not: the sandwich covariance of White (1980, DOI 10.2307/1912934) and Liang and
Zeger (1986, DOI 10.1093/biomet/73.1.13) with blocks as clusters. With few blocks, the ordinary covariance, scaled by
the correlation length of the residuals, is used where it is wider.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

Array = np.ndarray
Residuals = Callable[[Array], Array]

DIFFERENCE_STEP = 1e-3  # in scaled unknowns
COLD_START_MARGIN, WARM_START_MARGIN = 0.3, 0.02  # distance of the first point from its bounds, in scaled unknowns
ENOUGH_BLOCKS = 30  # the sandwich covariance alone is used from here on
CONFIDENCE = 0.95
ONE_BLOCK_QUANTILE = 12.7  # Student's t, one degree of freedom
MAX_CORRELATION_LAG = 400  # rows


class RobustFit(NamedTuple):
    """A solution and its uncertainty.

    Attributes:
        x: Solution, shape (n_unknowns,).
        std_dev: Standard deviations, shape (n_unknowns,).
        quantile: Half width of an interval in standard deviations.
        jacobian: At x, with robust weights, shape (n_rows, n_unknowns).
        residuals: At x, with robust weights, shape (n_rows,).
        rms: Of the data residuals without robust weights.
    """

    x: Array
    std_dev: Array
    quantile: float
    jacobian: Array
    residuals: Array
    rms: float

    def interval(self, i: int) -> tuple[float, float]:
        """Ends of the 95 % interval of unknown i."""
        half = self.quantile * self.std_dev[i]
        return float(self.x[i] - half), float(self.x[i] + half)


class SolverOptions(NamedTuple):
    """How a fit is solved.

    Attributes:
        soft_l1_scale: Residual from which on the loss grows linearly (soft L1); 0: plain squares.
        max_evaluations: Limit on residual evaluations.
        n_priors: Number of residuals at the end that are prior knowledge and not data.
        start_margin: Least distance of the first point from its bounds; WARM_START_MARGIN near a known solution.
    """

    soft_l1_scale: float = 0.0
    max_evaluations: int = 40
    n_priors: int = 0
    start_margin: float = COLD_START_MARGIN


DEFAULT_OPTIONS = SolverOptions()


def fit_robustly(
    residuals: Residuals,
    start: Array,
    bounds: tuple[Array, Array],
    blocks: Array,
    options: SolverOptions = DEFAULT_OPTIONS,
) -> RobustFit:
    """Minimise the sum of squares from `start` within the bounds.

    Args:
        residuals: Function of the unknowns, which are scaled so that 1 is a large step.
        start: First point, shape (n_unknowns,).
        bounds: Lower and upper bounds, likewise.
        blocks: Block of each data residual, shape (n_rows - n_priors,).
        options: Of the solver.
    """
    low, high = bounds
    scale, n_priors = options.soft_l1_scale, options.n_priors
    margin = np.minimum(options.start_margin, 0.1 * (high - low))
    start = np.clip(start, low + margin, high - margin)  # the solver takes no step from a bound
    solution = least_squares(
        residuals,
        start,
        jac=cast(Any, lambda x: compute_jacobian(residuals, x, low, high)),
        bounds=(low, high),
        loss="soft_l1" if scale > 0.0 else "linear",
        f_scale=scale or 1.0,
        max_nfev=options.max_evaluations,
        xtol=1e-6,
        ftol=1e-8,
        gtol=1e-10,
    )
    rows = residuals(solution.x)
    weights = (1.0 + (rows / scale) ** 2) ** -0.25 if scale > 0.0 else np.ones(len(rows))
    jacobian = compute_jacobian(residuals, solution.x, low, high, two_sided=True) * weights[:, None]
    std_dev, quantile = compute_std_devs(jacobian, rows * weights, blocks, n_priors)
    data = rows[: len(rows) - n_priors]
    rms = float(np.sqrt(np.mean(data * data)))
    return RobustFit(solution.x, std_dev, quantile, jacobian, rows * weights, rms)


def compute_jacobian(residuals: Residuals, x: Array, low: Array, high: Array, two_sided: bool = False) -> Array:
    """Finite differences of DIFFERENCE_STEP: forward (backward at the upper bound), or two-sided within the bounds.

    Returns:
        Shape (n_rows, n_unknowns).
    """
    centre = residuals(x)
    columns = []
    for i in range(len(x)):
        ahead, behind = x.copy(), x.copy()
        ahead[i] = min(x[i] + DIFFERENCE_STEP, high[i])
        if two_sided or ahead[i] <= x[i]:
            behind[i] = max(x[i] - DIFFERENCE_STEP, low[i])
        width = ahead[i] - behind[i]
        upper = centre if ahead[i] == x[i] else residuals(ahead)
        lower = centre if behind[i] == x[i] else residuals(behind)
        columns.append((upper - lower) / width if width > 0.0 else np.zeros(len(centre)))
    return np.stack(columns, axis=1)


def compute_std_devs(jacobian: Array, rows: Array, blocks: Array, n_priors: int = 0) -> tuple[Array, float]:
    """Standard deviations, shape (n_unknowns,), and their 95 % quantile, from weighted Jacobian and residuals."""
    bread = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    n = len(rows) - n_priors
    scores = jacobian[:n] * rows[:n, None]
    _, index = np.unique(blocks, return_inverse=True)
    count = int(index.max()) + 1
    sums = np.zeros((count, jacobian.shape[1]))
    np.add.at(sums, index, scores)
    meat = sums.T @ sums * (count / max(count - 1, 1))
    clustered = np.sqrt(np.maximum(np.diag(bread @ meat @ bread), 0.0))
    quantile = float(student.ppf(0.5 + 0.5 * CONFIDENCE, max(count - 1, 1))) if count > 1 else ONE_BLOCK_QUANTILE
    if count >= ENOUGH_BLOCKS:
        return clustered, quantile
    variance = float(rows[:n] @ rows[:n]) / max(n - jacobian.shape[1], 1)
    plain = np.sqrt(np.maximum(np.diag(bread), 0.0) * variance * compute_correlation_length(rows[:n], blocks))
    return np.maximum(clustered, plain), quantile


def compute_correlation_length(rows: Array, blocks: Array) -> float:
    """1 + 2 * the sum of autocorrelations within blocks up to the first that is not positive; at least 1."""
    energy, sums = 0.0, np.zeros(MAX_CORRELATION_LAG)
    for block in np.unique(blocks):
        block_rows = rows[blocks == block]
        energy += float(block_rows @ block_rows)
        for lag in range(1, min(len(block_rows), len(sums))):
            sums[lag] += float(block_rows[lag:] @ block_rows[:-lag])
    length = 1.0
    for lag in range(1, len(sums)):
        if energy <= 0.0 or sums[lag] <= 0.0:
            break
        length += 2.0 * sums[lag] / energy
    return length
