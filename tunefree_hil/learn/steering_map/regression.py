"""Linear least squares with robust weights, and a block jackknife of whatever follows from the solution.

Samples of one block (a stretch of driving) share road, wind and driver; blocks count as independent. The jackknife
leaves out one block after the other (Shao and Wu 1989, DOI 10.1214/aos/1176347263): from the spread of the solutions
follow intervals also of numbers that are no linear function of the coefficients, such as a ratio of two of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

Array = np.ndarray

HUBER_SCALES = 1.5  # residual beyond which a sample counts less, in standard deviations (Huber 1981: 95 % efficiency)
MAD_TO_SIGMA = 1.4826  # of the normal distribution
ROUNDS = 8  # of reweighting; the weights stop changing after about five
CONFIDENCE = 0.95


class BlockRegression(NamedTuple):
    """A solution.

    Attributes:
        solution: Shape (n_columns,).
        without_block: Solution without each block, shape (n_blocks, n_columns).
        residuals: Of all samples, without weights, shape (n_samples,).
        is_determined: False: the columns cannot be told apart, with all blocks or without one of them.
    """

    solution: Array
    without_block: Array
    residuals: Array
    is_determined: bool


def fit_blocks(
    columns: Array, target: Array, blocks: Array, floor: float, weights: Array | None = None
) -> BlockRegression:
    """Fit target = columns @ solution.

    Args:
        columns: Shape (n_samples, n_columns).
        target: Shape (n_samples,).
        blocks: Number of the block of each sample.
        floor: Least standard deviation of the residuals: noise and resolution of the measured angle.
        weights: Of the samples before the robust ones, None for 1.
    """
    scale = np.sqrt(np.maximum(np.mean(columns * columns, axis=0), 1e-30))
    scaled = columns / scale
    prior = np.ones(len(target)) if weights is None else weights
    robust = np.ones(len(target))
    for _ in range(ROUNDS):
        root = np.sqrt(prior * robust)
        solution = np.linalg.lstsq(scaled * root[:, None], target * root, rcond=None)[0]
        residuals = target - scaled @ solution
        size = np.abs(residuals) * np.sqrt(prior)
        sigma = max(MAD_TO_SIGMA * float(np.median(size)), floor)
        robust = np.minimum(1.0, HUBER_SCALES * sigma / np.maximum(size, 1e-12))
    _, index = np.unique(blocks, return_inverse=True)
    n_blocks, n_columns = int(index.max()) + 1, columns.shape[1]
    weighted = scaled * (prior * robust)[:, None]
    grams, sides = np.zeros((n_blocks, n_columns, n_columns)), np.zeros((n_blocks, n_columns))
    np.add.at(grams, index, weighted[:, :, None] * scaled[:, None, :])
    np.add.at(sides, index, weighted * target[:, None])
    rest = grams.sum(axis=0) - grams
    is_determined = bool(np.all(np.linalg.cond(rest) < 1e10))
    without = np.array(
        [np.linalg.lstsq(gram, side, rcond=None)[0] for gram, side in zip(rest, sides.sum(axis=0) - sides, strict=True)]
    )
    return BlockRegression(solution / scale, without / scale, residuals, is_determined)


def jackknife_half_width(replicates: Array) -> Array:
    """Half width of the 95 % interval, from values without each block, shape (n_blocks, ...) to (...)."""
    count = len(replicates)
    if count < 2:
        return np.full(np.shape(replicates)[1:], np.inf)
    spread = np.sum((replicates - replicates.mean(axis=0)) ** 2, axis=0)
    quantile = float(student.ppf(0.5 + 0.5 * CONFIDENCE, count - 1))
    return quantile * np.sqrt((count - 1) / count * spread)
