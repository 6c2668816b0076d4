"""Noise of simulation residuals: an autoregressive model per target, and the white noise of sensors.

Residuals of a simulation are correlated over time, so their rows carry less information than their number. The residual
of each target is modelled as an autoregression: filtered by it, the residual is nearly white, and its size is the noise
against which effects are judged. The filter is estimated on the residual of the model that is judged. Correlation that
the filter leaves reduces the weight of each row (`NoiseModel.correlation_rows`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from tunefree_hil.learn.drives.smoothing import estimate_quantum

Array = np.ndarray

FILTER_ORDER = 10
# Share of the variance that is added to it. A filter that fits a smooth residual more closely has coefficients far
# above 1: a candidate that removes most of that residual and changes its shape would seem to make it larger.
VARIANCE_RIDGE = 1e-2
MAX_CORRELATION_S = 4.0  # longest lag at which correlation of the whitened residual is looked for
DIFFERENCE_ORDER = 4  # of the differences that separate white noise from the signal
MIN_NOISE_ROWS = 20  # fewer differences give no estimate of the noise


class NoiseModel(NamedTuple):
    """Noise of a target.

    Args:
        whitening_filter: coefficients that make a residual white, shape (FILTER_ORDER + 1,)
        sigma: standard deviation of the whitened residual, in the unit of the target
        correlation_rows: number of whitened rows that carry the information of one independent row
    """

    whitening_filter: Array
    sigma: float
    correlation_rows: float


class ResidualPiece(NamedTuple):
    """One drive's part of a target: values, shape (n_rows,) or (n_rows, n_columns), and which rows are valid."""

    values: Array
    valid: Array


def estimate_noise_model(pieces: Sequence[ResidualPiece], floor: float, dt_s: float) -> NoiseModel:
    """Fit the noise model of a target to its residuals of all drives.

    Args:
        floor: the noise is never estimated below this, in the unit of the target
    """
    products, pair_counts = _autocorrelation_sums(_remove_mean(pieces), FILTER_ORDER + 1)
    # Divided by the pairs of lag 0, not of each lag: else a short loud moment could put a lag above lag 0
    lags = products / max(pair_counts[0], 1.0)
    lags[0] = lags[0] * (1.0 + VARIANCE_RIDGE) + floor * floor + 1e-30
    ar = solve_toeplitz(lags[:FILTER_ORDER], lags[1 : FILTER_ORDER + 1])
    taps = np.concatenate([[1.0], -ar])
    white = [whiten_piece(piece, taps) for piece in pieces]
    values = np.concatenate([piece.values[piece.valid] for piece in white])
    sigma = float(np.sqrt(np.mean(values * values) + floor * floor)) if len(values) else 1.0
    products, pair_counts = _autocorrelation_sums(white, max(round(MAX_CORRELATION_S / dt_s), 2))
    return NoiseModel(taps, sigma, _integrated_correlation(products / np.maximum(pair_counts, 1.0)))


def _remove_mean(pieces: Sequence[ResidualPiece]) -> list[ResidualPiece]:
    """Without the mean over all pieces: a filter that took a constant for noise would hide every bias."""
    values = np.concatenate([piece.values[piece.valid] for piece in pieces])
    mean = float(values.mean()) if len(values) else 0.0
    return [piece._replace(values=piece.values - mean) for piece in pieces]


def whiten_piece(piece: ResidualPiece, taps: Array) -> ResidualPiece:
    """Filter a piece; a row is valid where all rows that the filter uses are."""
    order = len(taps) - 1
    values = np.asarray(lfilter(taps, [1.0], piece.values, axis=0))
    valid = np.convolve(~piece.valid, np.ones(order + 1))[: len(piece.valid)] < 0.5
    valid[:order] = False
    return ResidualPiece(values, valid)


def _autocorrelation_sums(pieces: Sequence[ResidualPiece], n_lags: int) -> tuple[Array, Array]:
    """Sums of products of valid rows, and the number of such pairs of rows, by lag; each of shape (n_lags,)."""
    products, pair_counts = np.zeros(n_lags), np.zeros(n_lags)
    for piece in pieces:
        values = np.where(piece.valid, piece.values, 0.0)
        size = 1 << (2 * len(values) - 1).bit_length()
        for total, series in ((products, values), (pair_counts, piece.valid.astype(float))):
            spectrum = np.fft.rfft(series, size)
            lag_sums = np.fft.irfft(spectrum * np.conj(spectrum), size)[: min(n_lags, len(values))]
            total[: len(lag_sums)] += lag_sums
    return products, pair_counts


def _integrated_correlation(lags: Array) -> float:
    """1 + 2 * the sum of correlations, up to the first pair of lags whose sum is not positive."""
    if lags[0] <= 0.0:
        return 1.0
    length = 1.0
    for k in range(1, len(lags) - 1, 2):
        pair = (lags[k] + lags[k + 1]) / lags[0]
        if pair <= 0.0:
            break
        length += 2.0 * pair
    return length


def estimate_white_noise(values: Array, valid: Array) -> float:
    """Standard deviation of a signal's white noise, from its differences of order DIFFERENCE_ORDER; 0 if unknown."""
    weights = np.array([1.0])
    for _ in range(DIFFERENCE_ORDER):
        weights = np.convolve(weights, [1.0, -1.0])
    rough = whiten_piece(ResidualPiece(values, valid), weights)
    differences = rough.values[rough.valid]
    if len(differences) < MIN_NOISE_ROWS:
        return 0.0
    spread = 1.4826 * float(np.median(np.abs(differences - np.median(differences))))
    return spread / float(np.sqrt(np.sum(weights * weights)))


def estimate_sensor_noise(values: Array, rows: Array) -> float:
    """Noise of a sensor: its white noise, or its quantisation where that is more; 0 for fewer than two rows.

    Args:
        values: the signal, shape (n_rows,)
        rows: rows in which a new value was received. Interpolated rows between them would seem too quiet, and no
            difference is taken over a gap
    """
    if len(rows) < 2:
        return 0.0
    steps = np.diff(rows, prepend=rows[0])
    is_regular = steps <= 1.5 * max(float(np.median(steps[1:])), 1.0)
    return max(estimate_white_noise(values[rows], is_regular), estimate_quantum(values[rows]) / 12.0**0.5)
