"""Least squares whose intervals hold what they promise, also where residuals hang together."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.learn.robust_least_squares import (
    WARM_START_MARGIN,
    SolverOptions,
    compute_correlation_length,
    fit_robustly,
)

LOW, HIGH = np.full(2, -50.0), np.full(2, 50.0)


def correlated(chance: np.random.Generator, n: int, kept: float) -> np.ndarray:
    """A first-order autoregression of unit variance."""
    noise = chance.standard_normal(n) * np.sqrt(1.0 - kept * kept)
    values = np.empty(n)
    last = chance.standard_normal()
    for i in range(n):
        last = kept * last + noise[i]
        values[i] = last
    return values


@pytest.mark.parametrize(("kept", "count"), [(0.0, 40), (0.9, 40), (0.9, 12)])
def test_the_interval_covers_the_truth_as_often_as_it_says(kept: float, count: int) -> None:
    chance, rows = np.random.default_rng(3), 60
    t = np.linspace(0.0, 1.0, rows * count)
    slow = np.sin(2.0 * np.pi * 3.0 * t)
    blocks = np.repeat(np.arange(count), rows)
    hits = []
    for _ in range(60):
        y = 1.5 + 0.7 * slow + 0.3 * correlated(chance, len(t), kept)
        least = fit_robustly(lambda x, y=y: (x[0] + x[1] * slow - y) / 0.3, np.zeros(2), (LOW, HIGH), blocks)
        for i, truth in enumerate((1.5, 0.7)):
            low, high = least.interval(i)
            hits.append(low <= truth <= high)
    assert 0.85 <= np.mean(hits) <= 1.0, np.mean(hits)


def test_the_plain_covariance_would_not_have() -> None:
    chance = np.random.default_rng(3)
    rows = correlated(chance, 6000, 0.9)
    assert compute_correlation_length(rows, np.repeat(np.arange(10), 600)) == pytest.approx(19.0, rel=0.35)
    assert compute_correlation_length(chance.standard_normal(6000), np.zeros(6000)) < 1.3


def test_what_was_found_near_a_bound_is_found_again_in_few_steps() -> None:
    """A cold search begins far from bounds, and a few steps do not lead back from there."""
    t, blocks = np.linspace(0.0, 1.0, 400), np.repeat(np.arange(10), 40)
    low, found = np.array([0.0, -50.0]), np.array([1e-3, 2.0])

    def residuals(x: np.ndarray) -> np.ndarray:
        return 30.0 * (np.tanh(4.0 * (x[0] - found[0])) * (1.0 + t) + (x[1] - found[1]) * t)

    options = SolverOptions(max_evaluations=3), SolverOptions(max_evaluations=3, start_margin=WARM_START_MARGIN)
    cold, warm = (
        float(np.abs(fit_robustly(residuals, found, (low, HIGH), blocks, option).x - found).max()) for option in options
    )
    assert warm < 0.2 * cold


def test_outliers_are_held_down() -> None:
    chance = np.random.default_rng(1)
    y = 2.0 + 0.1 * chance.standard_normal(500)
    y[::25] += 40.0
    blocks = np.repeat(np.arange(50), 10)

    def residuals(x: np.ndarray) -> np.ndarray:
        return (x[0] - y) / 0.1

    plain = fit_robustly(residuals, np.zeros(1), (LOW[:1], HIGH[:1]), blocks)
    firm = fit_robustly(residuals, np.zeros(1), (LOW[:1], HIGH[:1]), blocks, SolverOptions(soft_l1_scale=3.0))
    assert abs(plain.x[0] - 2.0) > 1.0 and abs(firm.x[0] - 2.0) < 0.05


def test_what_nothing_shows_stays_as_wide_as_it_was_known() -> None:
    y = np.ones(100)
    blocks = np.repeat(np.arange(50), 2)

    def residuals(x: np.ndarray) -> np.ndarray:
        return np.concatenate([(x[0] - y) / 0.01, x])

    least = fit_robustly(residuals, np.zeros(2), (LOW, HIGH), blocks, SolverOptions(n_priors=2))
    inner = np.linalg.pinv(least.jacobian.T @ least.jacobian)
    assert np.sqrt(inner[1, 1]) == pytest.approx(1.0, rel=0.01) and np.sqrt(inner[0, 0]) < 0.01


def test_a_start_at_a_bound_does_not_hold_the_search() -> None:
    y = np.full(100, 3.0)
    blocks = np.repeat(np.arange(50), 2)
    low = np.array([-50.0, 0.0])

    def residuals(x: np.ndarray) -> np.ndarray:
        return np.concatenate([(x[0] - y) / 0.1, (x[1] - 0.5 * y) / 0.1])

    least = fit_robustly(residuals, np.zeros(2), (low, HIGH), np.concatenate([blocks, blocks]))
    assert least.x == pytest.approx([3.0, 1.5])
    held = fit_robustly(
        lambda x: residuals(x) + np.repeat([0.0, 40.0], 100), np.zeros(2), (low, HIGH), np.concatenate([blocks] * 2)
    )
    assert held.x == pytest.approx([3.0, 0.0], abs=1e-3), "and a bound still holds it"
