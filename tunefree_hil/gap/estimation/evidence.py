"""Evidence for a model: the Laplace log evidence of its fit, and a paired test of two models over blocks.

Both are required before an effect is named. The log evidence counts every row, divided by the correlation rows of the
noise; where noise is small it reaches thousands of nats and then expresses certainty about the noise rather than about
the effect. The paired test uses whole blocks, and how much the difference of two models varies between them.

The paired test cross-validates only an effect's own parameters: in each fold they are fitted on the blocks of the other
folds. The nuisances and the whitening filter are fitted on all non-holdout blocks, for both models alike: the test
compares two models of the same freedom, and makes no claim about new drives. That claim is made on the holdout blocks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.estimation.least_squares import (
    Bounds,
    Fit,
    is_free,
    key_bounds,
    step_within_bounds,
    sum_equations,
)
from tunefree_hil.gap.measured.blocks import HOLDOUT, Blocks

Array = np.ndarray

N_FOLDS = 5
BOOTSTRAP_DRAWS = 2000
MIN_EVIDENCE_NATS = 6.0  # least evidence of an effect; docs/results/criteria.md
MAX_FOLD_STEP = 0.1  # of the prior's width that a free parameter may move in a fold: farther the Jacobian does not hold
OUTSIDE_PRIOR_NATS = 20.0  # penalty of a parameter that is a whole width of its prior outside of it


class PairedComparison(NamedTuple):
    """Log likelihood ratio of two models on whole blocks.

    Args:
        total: sum over the blocks, nats
        low: lower end of its 95 % bootstrap interval
        high: upper end
        p_value: that the sum is not positive
        std: standard deviation of the bootstrapped sums
    """

    total: float
    low: float
    high: float
    p_value: float
    std: float = 0.0


def correlation_rows_by_target(fit: Fit) -> dict[str, float]:
    """Correlation rows of a fit's residuals, by target. Models must be compared under the same."""
    return {name: equations.noise.correlation_rows for name, equations in fit.equations.items()}


def with_correlation_rows(fit: Fit, correlation_rows: Mapping[str, float]) -> Fit:
    """The fit with these correlation rows of its noise; of other targets they stay."""
    equations = {
        name: target._replace(
            noise=target.noise._replace(correlation_rows=correlation_rows.get(name, target.noise.correlation_rows))
        )
        for name, target in fit.equations.items()
    }
    return fit._replace(equations=equations)


def non_holdout_blocks(blocks: Blocks) -> Array:
    """Numbers of the blocks for fitting and selection."""
    return np.flatnonzero(blocks.roles != HOLDOUT)


def log_evidence(fit: Fit, blocks: Array) -> float:
    """Laplace log evidence, nats, up to a constant shared by all models of the same data."""
    free_mask = is_free(fit.keys, fit.free)
    curvature = sum_equations(fit.equations, len(fit.keys), blocks).curvature
    flat = np.diag(2.0 * np.pi * free_mask)  # a uniform prior as a normal density of height 1
    logdet = np.linalg.slogdet(curvature + fit.prior_precision + flat)[1]
    logdet -= np.linalg.slogdet(fit.prior_precision[np.ix_(~free_mask, ~free_mask)])[1]
    log_likelihood = sum(_log_likelihood(fit, name, blocks).sum() for name in fit.equations)
    log_likelihood -= 0.5 * float(fit.z @ fit.prior_precision @ fit.z)
    n_free = len(fit.free)
    outside = sum(max(0.0, -u, u - 1.0) for u in fit.z[len(fit.z) - n_free :]) if n_free else 0.0
    return float(log_likelihood - 0.5 * logdet + 0.5 * n_free * np.log(2.0 * np.pi) - OUTSIDE_PRIOR_NATS * outside)


def _log_likelihood(fit: Fit, name: str, blocks: Array, step: Array | None = None) -> Array:
    """Of a target in each block, shape (n_blocks,), after a step of the parameters by the normal equations."""
    equations = fit.equations[name]
    squared = equations.squared_residuals[blocks]
    if step is not None:
        part = step[equations.columns]
        squared = (
            squared
            + 2.0 * equations.gradient[blocks] @ part
            + np.einsum("bij,i,j->b", equations.curvature[blocks], part, part)
        )
    log_sigma = np.log(equations.noise.sigma)
    return -0.5 * (squared + 2.0 * equations.row_counts[blocks] * log_sigma) / equations.noise.correlation_rows


def predictive_log_likelihood(fit: Fit, blocks: Array, targets: Sequence[str] | None = None) -> Array:
    """Log likelihood of each block, shape (n_blocks,), with free parameters fitted on the blocks of the other folds.

    Nuisances keep their values from all blocks, with or without effects: fitted anew in each fold, they would make up
    most of the difference.

    Args:
        targets: those that are counted; None for all
    """
    log_likelihood = np.zeros(len(blocks))
    bounds = key_bounds(fit.keys, fit.free)
    free_mask = is_free(fit.keys, fit.free)
    for fold in range(min(N_FOLDS, len(blocks))):
        in_fold = np.arange(len(blocks)) % N_FOLDS == fold
        step = np.zeros(len(fit.keys))
        if free_mask.any():
            form = sum_equations(fit.equations, len(fit.keys), blocks[~in_fold])
            step[free_mask] = step_within_bounds(
                form.curvature[np.ix_(free_mask, free_mask)],
                form.gradient[free_mask],
                fit.z[free_mask],
                Bounds(bounds.low[free_mask], bounds.high[free_mask]),
            ).clip(-MAX_FOLD_STEP, MAX_FOLD_STEP)
        for name in targets or fit.equations:
            log_likelihood[in_fold] += _log_likelihood(fit, name, blocks[in_fold], step)
    return log_likelihood


def compare_paired(
    fit: Fit, reference: Fit, blocks: Array, seed: int = 1, targets: Sequence[str] | None = None
) -> PairedComparison:
    """Compare a model with a reference, both under the same correlation rows."""
    differences = predictive_log_likelihood(fit, blocks, targets) - predictive_log_likelihood(
        reference, blocks, targets
    )
    return bootstrap_sum(differences, seed)


def bootstrap_sum(differences: Array, seed: int = 1) -> PairedComparison:
    """Bootstrap the sum of differences over blocks, shape (n_blocks,).

    The p-value is the share of draws that are not positive, but at least the chance that so few blocks agree in sign:
    no draw from values of equal sign has the other one.
    """
    rng = np.random.default_rng(seed)
    sums = rng.choice(differences, (BOOTSTRAP_DRAWS, len(differences))).sum(axis=1)
    low, high = np.quantile(sums, [0.025, 0.975])
    p_value = max(float(np.mean(sums <= 0.0)), 0.5 ** len(differences))
    return PairedComparison(float(differences.sum()), float(low), float(high), p_value, float(sums.std()))


def select_by_holm(p_values: Mapping[str, float], level: float = 0.05) -> set[str]:
    """Names that are significant when all are tested at once (Holm's step-down procedure, Scand. J. Statist. 1979)."""
    order = sorted(p_values, key=lambda name: p_values[name])
    significant: set[str] = set()
    for i, name in enumerate(order):
        if p_values[name] > level / (len(order) - i):
            break
        significant.add(name)
    return significant
