"""What is left by a right model: filtered white, its size known, whatever hangs together in it."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.gap.estimation.noise import ORDER, Piece, colour_of, sensor_noise, whitened

N = 6000


def hanging(share: float, seed: int = 1) -> np.ndarray:
    """An autoregression of order 1 with innovations of size 1."""
    chance, found = np.random.default_rng(seed), np.zeros(N)
    drawn = chance.standard_normal(N)
    for k in range(1, N):
        found[k] = share * found[k - 1] + drawn[k]
    return found


@pytest.mark.parametrize("share", [0.0, 0.6, 0.95])
def test_a_residual_that_hangs_together_comes_out_white_and_of_its_innovations_size(share: float) -> None:
    piece = Piece(hanging(share), np.ones(N, dtype=bool))
    colour = colour_of([piece], 0.0, 0.05)
    white = whitened(piece, colour.filter)
    some = white.values[white.valid]
    assert colour.sigma == pytest.approx(1.0, rel=0.06)
    assert abs(np.corrcoef(some[1:], some[:-1])[0, 1]) < 0.1
    assert colour.stretch < 1.6


def test_rows_that_do_not_count_are_not_looked_at() -> None:
    values, valid = hanging(0.5), np.ones(N, dtype=bool)
    spoilt = values.copy()
    spoilt[1000:1200], valid[1000:1200] = 1e6, False
    found, clean = (colour_of([Piece(v, valid)], 0.0, 0.05) for v in (spoilt, values))
    assert np.array_equal(found.filter, clean.filter) and found.sigma == clean.sigma
    assert not whitened(Piece(spoilt, valid), found.filter).valid[1200 : 1200 + ORDER].any()


@pytest.mark.parametrize("rows", [2, 30, 79, 81])
def test_a_piece_shorter_than_the_longest_lag_says_what_it_can(rows: int) -> None:
    long, short = (Piece(hanging(0.5, seed)[:n], np.ones(n, dtype=bool)) for seed, n in ((1, N), (2, rows)))
    assert colour_of([long, short], 0.0, 0.05).stretch == pytest.approx(colour_of([long], 0.0, 0.05).stretch, rel=0.1)


def test_no_residual_is_believed_smaller_than_its_floor() -> None:
    assert colour_of([Piece(1e-9 * hanging(0.5), np.ones(N, dtype=bool))], 0.01, 0.05).sigma >= 0.01


def test_the_noise_of_a_sensor_is_found_under_a_moving_signal() -> None:
    chance = np.random.default_rng(3)
    signal = 5.0 * np.sin(np.arange(N) * 0.02)
    found = sensor_noise(signal + 0.03 * chance.standard_normal(N), np.ones(N, dtype=bool))
    assert found == pytest.approx(0.03, rel=0.1)


def test_a_bias_is_not_taken_for_noise_that_hangs_together() -> None:
    values, valid = 0.1 * hanging(0.3), np.ones(N, dtype=bool)
    plain, biased = (colour_of([Piece(values + bias, valid)], 0.0, 0.05) for bias in (0.0, 5.0))
    assert biased.filter == pytest.approx(plain.filter, abs=1e-6)
    assert biased.sigma > 20.0 * plain.sigma


def test_a_moment_that_is_loud_does_not_make_a_filter_that_is_louder_than_what_it_filters() -> None:
    """A smooth bump in the midst of rows that all count: of those elsewhere many have no partner a few rows on."""
    chance, valid = np.random.default_rng(4), np.ones(N, dtype=bool)
    values = 2e-4 * chance.standard_normal(N)
    for begin in range(0, N, 200):
        valid[begin + 160 : begin + 200] = False
    values[1000:1160] += 0.02 * np.sin(np.linspace(0.0, np.pi, 160)) ** 2
    colour = colour_of([Piece(values, valid)], 0.0, 0.05)
    assert colour.filter[1] < -0.3 and np.abs(colour.filter).max() <= 1.0
    assert colour.sigma < 0.3 * np.sqrt(np.mean(values[valid] ** 2))
