"""Noise models: residuals are whitened, and their size is estimated, however they are correlated."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.gap.estimation.noise import (
    FILTER_ORDER,
    ResidualPiece,
    estimate_noise_model,
    estimate_white_noise,
    whiten_piece,
)

N = 6000


def hanging(share: float, seed: int = 1) -> np.ndarray:
    """An autoregression of order 1 with innovations of size 1."""
    chance, found = np.random.default_rng(seed), np.zeros(N)
    drawn = chance.standard_normal(N)
    for k in range(1, N):
        found[k] = share * found[k - 1] + drawn[k]
    return found


@pytest.mark.parametrize("share", [0.0, 0.6, 0.95])
def test_a_correlated_residual_is_whitened_to_the_size_of_its_innovations(share: float) -> None:
    piece = ResidualPiece(hanging(share), np.ones(N, dtype=bool))
    colour = estimate_noise_model([piece], 0.0, 0.05)
    white = whiten_piece(piece, colour.whitening_filter)
    some = white.values[white.valid]
    assert colour.sigma == pytest.approx(1.0, rel=0.06)
    assert abs(np.corrcoef(some[1:], some[:-1])[0, 1]) < 0.1
    assert colour.correlation_rows < 1.6


def test_invalid_rows_are_not_used() -> None:
    values, valid = hanging(0.5), np.ones(N, dtype=bool)
    spoilt = values.copy()
    spoilt[1000:1200], valid[1000:1200] = 1e6, False
    found, clean = (estimate_noise_model([ResidualPiece(v, valid)], 0.0, 0.05) for v in (spoilt, values))
    assert np.array_equal(found.whitening_filter, clean.whitening_filter) and found.sigma == clean.sigma
    assert (
        not whiten_piece(ResidualPiece(spoilt, valid), found.whitening_filter).valid[1200 : 1200 + FILTER_ORDER].any()
    )


@pytest.mark.parametrize("rows", [2, 30, 79, 81])
def test_a_piece_shorter_than_the_longest_lag_is_used(rows: int) -> None:
    long, short = (ResidualPiece(hanging(0.5, seed)[:n], np.ones(n, dtype=bool)) for seed, n in ((1, N), (2, rows)))
    assert estimate_noise_model([long, short], 0.0, 0.05).correlation_rows == pytest.approx(
        estimate_noise_model([long], 0.0, 0.05).correlation_rows, rel=0.1
    )


def test_no_noise_is_below_its_floor() -> None:
    assert estimate_noise_model([ResidualPiece(1e-9 * hanging(0.5), np.ones(N, dtype=bool))], 0.01, 0.05).sigma >= 0.01


def test_the_noise_of_a_sensor_is_found_under_a_moving_signal() -> None:
    chance = np.random.default_rng(3)
    signal = 5.0 * np.sin(np.arange(N) * 0.02)
    found = estimate_white_noise(signal + 0.03 * chance.standard_normal(N), np.ones(N, dtype=bool))
    assert found == pytest.approx(0.03, rel=0.1)


def test_a_bias_is_not_taken_for_correlated_noise() -> None:
    values, valid = 0.1 * hanging(0.3), np.ones(N, dtype=bool)
    plain, biased = (estimate_noise_model([ResidualPiece(values + bias, valid)], 0.0, 0.05) for bias in (0.0, 5.0))
    assert biased.whitening_filter == pytest.approx(plain.whitening_filter, abs=1e-6)
    assert biased.sigma > 20.0 * plain.sigma


def test_a_short_large_residual_does_not_give_an_amplifying_filter() -> None:
    """A smooth bump among valid rows; elsewhere many rows have no valid partner a few rows on."""
    chance, valid = np.random.default_rng(4), np.ones(N, dtype=bool)
    values = 2e-4 * chance.standard_normal(N)
    for begin in range(0, N, 200):
        valid[begin + 160 : begin + 200] = False
    values[1000:1160] += 0.02 * np.sin(np.linspace(0.0, np.pi, 160)) ** 2
    colour = estimate_noise_model([ResidualPiece(values, valid)], 0.0, 0.05)
    assert colour.whitening_filter[1] < -0.3 and np.abs(colour.whitening_filter).max() <= 1.0
    assert colour.sigma < 0.3 * np.sqrt(np.mean(values[valid] ** 2))
