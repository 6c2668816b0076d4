"""The solution of eq. 10 keeps its bounds, is the least of its neighbours, and agrees with a linear program."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from tests.grade.weight_regression.made_pairs import METRICS, ruled_pairs, table_of
from tunefree_hil.grade.weight_regression.pairs import PairTable
from tunefree_hil.tune.weight_regression.hinge_solver import (
    CRITERIA,
    fit_multipliers,
    mean_hinge_loss,
    project_on_scale,
)

MARGIN = 0.05


def random_table(seed: int, n_pairs: int = 40, n_metrics: int = 6) -> PairTable:
    chance = np.random.default_rng(seed)
    shares = chance.uniform(0.1, 1.0, n_metrics)
    is_available = chance.random((n_pairs, n_metrics)) < 0.8
    is_available[:, 0] = True
    differences = is_available * chance.normal(0.0, 0.5, (n_pairs, n_metrics))
    return PairTable(tuple("abcdef"[:n_metrics]), shares / shares.sum(), differences, is_available)


def objective(table: PairTable, multipliers: np.ndarray, strength: float) -> float:
    pull = 0.5 * strength * float(table.shares @ (multipliers - 1.0) ** 2)
    return mean_hinge_loss(table, MARGIN, multipliers) + pull


@given(seed=st.integers(0, 10_000), strength=st.sampled_from([0.003, 0.03, 0.3, 3.0]))
@settings(max_examples=25, deadline=None)
def test_a_solution_is_feasible_and_no_feasible_point_is_better(seed: int, strength: float) -> None:
    table = random_table(seed)
    fit = fit_multipliers(table, MARGIN, strength)
    assert fit.is_solved and fit.gap >= -1e-9
    assert (fit.multipliers >= 0.0).all()
    assert table.shares @ fit.multipliers == pytest.approx(1.0, abs=1e-9)
    best, chance = objective(table, fit.multipliers, strength), np.random.default_rng(seed)
    for spread in (0.01, 0.1, 1.0):
        other = project_on_scale(fit.multipliers + chance.normal(0.0, spread, len(table.shares)), table.shares)
        assert objective(table, other, strength) >= best - CRITERIA.max_gap


@pytest.mark.parametrize("seed", range(5))
def test_without_a_pull_the_loss_is_that_of_the_linear_program(seed: int) -> None:
    """Slack s_j >= sum_k p_k d_jk u_k / P_j + eps, s >= 0; solved by HiGHS."""
    table = random_table(seed)
    n, k = table.differences.shape
    slopes = table.differences / (table.is_available @ table.shares)[:, None] * table.shares
    cost = np.concatenate([np.zeros(k), np.full(n, 1.0 / n)])
    answer = linprog(
        cost, A_ub=np.hstack([slopes, -np.eye(n)]), b_ub=np.full(n, -MARGIN),
        A_eq=np.concatenate([table.shares, np.zeros(n)])[None, :], b_eq=[1.0],
    )  # fmt: skip
    fit = fit_multipliers(table, MARGIN, 1e-5)
    assert fit.loss == pytest.approx(answer.fun, abs=1e-3)
    assert fit.loss >= answer.fun - 1e-9


def test_the_rule_of_the_pairs_is_found() -> None:
    rule = np.array([4.0, 0.0, 1.0, 3.0])
    fit = fit_multipliers(table_of(ruled_pairs(rule.tolist(), 30, 3)), 0.01, 1e-4)
    assert np.abs(fit.multipliers - rule / rule.mean()).max() < 0.25


def test_a_strong_pull_gives_the_base_weights() -> None:
    fit = fit_multipliers(table_of(ruled_pairs([4, 0, 1, 3], 10, 3)), MARGIN, 1e4)
    assert np.abs(fit.multipliers - 1.0).max() < 1e-3


def test_weight_on_missing_metrics_meets_no_margin() -> None:
    """All pairs lack two metrics and say that the human is worse: these keep their weight, nothing is gained."""
    is_available = np.zeros((12, 4), dtype=bool)
    is_available[:, :2] = True
    differences = is_available * np.array([0.3, 0.2, 0.0, 0.0])
    table = PairTable(METRICS, np.full(4, 0.25), differences, is_available)
    fit = fit_multipliers(table, MARGIN, 0.001)
    assert fit.multipliers[2:].tolist() == [1.0, 1.0]
    assert fit.multipliers[:2].sum() == pytest.approx(2.0)
    assert fit.loss == pytest.approx(0.2 + MARGIN, abs=1e-3)
