"""Block regression: the jackknife is that of its definition, and outliers count less."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.learn.steering_map.regression import fit_blocks, jackknife_half_width

CHANCE = np.random.default_rng(3)
N, BLOCKS = 400, np.repeat(np.arange(20), 20)
X = np.stack([np.ones(N), CHANCE.uniform(-1.0, 1.0, N)], axis=1)
TARGET = X @ np.array([0.5, 2.0]) + 0.01 * CHANCE.standard_normal(N)


def test_it_is_least_squares_on_clean_data() -> None:
    fit = fit_blocks(X, TARGET, BLOCKS, floor=1.0)  # a floor so high that no sample is an outlier
    assert fit.solution == pytest.approx(np.linalg.lstsq(X, TARGET, rcond=None)[0], rel=1e-9)
    left_out = BLOCKS != 7
    assert fit.without_block[7] == pytest.approx(np.linalg.lstsq(X[left_out], TARGET[left_out], rcond=None)[0])
    assert fit.is_determined and fit.residuals == pytest.approx(TARGET - X @ fit.solution)


def test_outliers_count_less() -> None:
    spoilt = TARGET.copy()
    spoilt[::10] += 5.0
    fit = fit_blocks(X, spoilt, BLOCKS, floor=0.001)
    assert fit.solution == pytest.approx([0.5, 2.0], abs=0.02)
    assert abs(np.linalg.lstsq(X, spoilt, rcond=None)[0][0] - 0.5) > 0.3


def test_intervals_know_that_samples_of_a_block_share_an_error() -> None:
    shared = np.repeat(0.05 * CHANCE.standard_normal(20), 20)
    alone, common = (fit_blocks(X, target, BLOCKS, floor=1.0) for target in (TARGET, TARGET + shared))
    halves = [jackknife_half_width(fit.without_block)[0] for fit in (alone, common)]
    assert halves[1] > 5.0 * halves[0]
    assert halves[1] == pytest.approx(2.09 * np.std(shared[::20], ddof=1) / np.sqrt(20), rel=0.25)


def test_columns_that_cannot_be_told_apart() -> None:
    twice = np.stack([X[:, 1], 2.0 * X[:, 1]], axis=1)
    assert not fit_blocks(twice, TARGET, BLOCKS, floor=1.0).is_determined
    only = np.where(BLOCKS == 3, X[:, 1], 0.0)  # without block 3 nothing is known of it
    assert not fit_blocks(np.stack([X[:, 0], only], axis=1), TARGET, BLOCKS, floor=1.0).is_determined


def test_one_block_has_no_interval() -> None:
    assert jackknife_half_width(np.ones((1, 2))).tolist() == [np.inf, np.inf]
