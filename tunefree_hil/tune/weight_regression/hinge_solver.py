"""Solves eq. 10: weights for which the human drives score lower, as near to the base weights as the pairs allow.

With u_k the multiplier of base weight k, p_k its share, and d_jk the difference human - generated of pair j,

    minimise  1/n sum_j |sum_k p_k d_jk u_k / P_j + eps|_+  +  strength / 2 sum_k p_k (u_k - 1)^2
    subject to  u >= 0,  sum_k p_k u_k = 1

where the sum of pair j is over the metrics that it has and P_j is their share of the base weights. For pairs with all
metrics the first term is eq. 10 over n. A score renormalises by the regressed weights of the available metrics, which
is not convex; P_j does it by the base weights, so that weight on metrics that a pair lacks cannot meet its margin.
Metrics that no pair has keep their base weight. The second term makes the solution unique. The dual is a smooth concave
function of one bounded number a pair; the gap between both values bounds the error.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from tunefree_hil.grade.weight_regression.pairs import PairTable

Array = np.ndarray


class SolverCriteria(NamedTuple):
    """When a solution counts as found."""

    max_gap: float = 1e-4  # primal minus dual value, in units of the score; figures of weights have three digits
    max_iterations: int = 20000  # of L-BFGS-B; the problems met so far need some hundred


CRITERIA = SolverCriteria()


class WeightFit(NamedTuple):
    """Multipliers of the base weights, shape (n_metrics,). loss: first term. gap: largest error of the objective."""

    multipliers: Array
    loss: float
    gap: float

    @property
    def is_solved(self) -> bool:
        """Whether the gap is small enough."""
        return self.gap <= CRITERIA.max_gap


class DualValue(NamedTuple):
    """Value of the dual, its gradient (n_pairs,), and the multipliers that attain it (n_metrics,)."""

    value: float
    gradient: Array
    multipliers: Array


class HingeProblem(NamedTuple):
    """The problem over the metrics that some pair has.

    Attributes:
        slopes: d_jk / P_j, 0 where not available, shape (n_pairs, n_metrics).
        shares: p_k over their sum, shape (n_metrics,).
        margin, strength: As above.
    """

    slopes: Array
    shares: Array
    margin: float
    strength: float


def fit_multipliers(table: PairTable, margin: float, strength: float) -> WeightFit:
    """Solve the problem above.

    Args:
        table: Pairs; at least one, each with at least one metric.
        margin: eps, above 0.
        strength: Of the pull to the base weights, above 0.
    """
    is_used = table.is_available.any(axis=0)
    total = table.shares[is_used].sum()
    slopes = _slopes(table)[:, is_used] * total
    problem = HingeProblem(slopes, table.shares[is_used] / total, margin, strength)

    def negative_dual(scaled: Array) -> tuple[float, Array]:
        dual = evaluate_dual(scaled / table.n_pairs, problem)
        return -dual.value, -dual.gradient / table.n_pairs

    start = np.full(table.n_pairs, 0.5)
    options = {"maxiter": CRITERIA.max_iterations, "maxfun": 10 * CRITERIA.max_iterations, "ftol": 1e-14, "gtol": 1e-10}
    bounds = [(0.0, 1.0)] * table.n_pairs
    answer = minimize(negative_dual, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    dual = evaluate_dual(np.clip(answer.x, 0.0, 1.0) / table.n_pairs, problem)
    multipliers = np.ones(len(table.shares))
    multipliers[is_used] = dual.multipliers
    loss = mean_hinge_loss(table, margin, multipliers)
    pull = 0.5 * strength * float(problem.shares @ (dual.multipliers - 1.0) ** 2)
    return WeightFit(multipliers, loss, loss + pull - dual.value)


def mean_hinge_loss(table: PairTable, margin: float, multipliers: Array) -> float:
    """The first term: mean over the pairs of the unmet part of the margin."""
    return float(np.maximum(_slopes(table) @ (table.shares * multipliers) + margin, 0.0).mean())


def evaluate_dual(prices: Array, problem: HingeProblem) -> DualValue:
    """Minimise the Lagrangian over the multipliers for given prices of the pairs, shape (n_pairs,)."""
    costs = prices @ problem.slopes
    multipliers = project_on_scale(1.0 - costs / problem.strength, problem.shares)
    weights = problem.shares * multipliers
    pull = 0.5 * problem.strength * float(problem.shares @ (multipliers - 1.0) ** 2)
    value = float(costs @ weights) + problem.margin * float(prices.sum()) + pull
    return DualValue(value, problem.slopes @ weights + problem.margin, multipliers)


def _slopes(table: PairTable) -> Array:
    """d_jk / P_j, shape (n_pairs, n_metrics)."""
    available_share = table.is_available @ table.shares
    return table.differences / available_share[:, None]


def project_on_scale(targets: Array, shares: Array) -> Array:
    """The nearest u >= 0 with sum of shares * u = 1, in the norm weighted by the shares: max(0, targets - shift)."""
    order = np.argsort(-targets, kind="stable")
    mass = np.cumsum(shares[order])
    shifts = (np.cumsum(shares[order] * targets[order]) - 1.0) / mass
    last = int(np.flatnonzero(targets[order] > shifts)[-1])
    return np.maximum(targets - shifts[last], 0.0)
