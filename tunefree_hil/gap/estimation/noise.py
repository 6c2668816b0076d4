"""What a model that is right would still leave: noise of the sensors, and what the car is more than a model of it.

A residual of a simulation hangs together over time, so its rows say less than their number. Each target's residual is
taken as an autoregression: what is left of it, filtered by that, is nearly white, and its size is the noise that a
name is measured against. The filter is estimated on the residual of the very model that is judged, so that nobody
is blamed for noise, and what hangs together beyond it stretches the noise (`stretch`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from tunefree_hil.learn.drives.smoothing import quantum_of

Array = np.ndarray

ORDER = 10
# Of the variance, added to it. A filter that fits a smooth residual any closer has taps far above 1: a candidate that
# takes off most of that residual, and leaves another shape of it, would come out louder than what there was.
RIDGE = 1e-2
BEYOND_S = 4.0  # up to which correlation is looked for behind the filter
NOISE_ORDER = 3


class Colour(NamedTuple):
    """filter [ORDER + 1] that makes a residual white; sigma: of what comes out; stretch: rows that say one thing."""

    filter: Array
    sigma: float
    stretch: float


class Piece(NamedTuple):
    """One drive's part of a target: residual [m] (or [m, k]) and the rows that count."""

    values: Array
    valid: Array


def colour_of(pieces: Sequence[Piece], floor: float, dt_s: float) -> Colour:
    """Of a target, all drives together. floor: no residual is believed smaller than that."""
    sums, pairs = _products(_centred(pieces), ORDER + 1)
    lags = sums / max(pairs[0], 1.0)  # not over the pairs of each lag: a moment that is loud would make a lag above 0's
    lags[0] = lags[0] * (1.0 + RIDGE) + floor * floor + 1e-30
    ar = solve_toeplitz(lags[:ORDER], lags[1 : ORDER + 1])
    taps = np.concatenate([[1.0], -ar])
    white = [whitened(piece, taps) for piece in pieces]
    some = np.concatenate([one.values[one.valid] for one in white])
    sigma = float(np.sqrt(np.mean(some * some) + floor * floor)) if len(some) else 1.0
    sums, pairs = _products(white, max(round(BEYOND_S / dt_s), 2))
    return Colour(taps, sigma, _stretch(sums / np.maximum(pairs, 1.0)))


def _centred(pieces: Sequence[Piece]) -> list[Piece]:
    """Without their mean: a constant is no noise, and a filter that takes it for noise would hide every bias."""
    some = np.concatenate([one.values[one.valid] for one in pieces])
    mean = float(some.mean()) if len(some) else 0.0
    return [one._replace(values=one.values - mean) for one in pieces]


def whitened(piece: Piece, taps: Array) -> Piece:
    """Filtered; a row counts where all rows that the filter looks at do."""
    order = len(taps) - 1
    values = np.asarray(lfilter(taps, [1.0], piece.values, axis=0))
    good = np.convolve(~piece.valid, np.ones(order + 1))[: len(piece.valid)] < 0.5
    good[:order] = False
    return Piece(values, good)


def _products(pieces: Sequence[Piece], count: int) -> tuple[Array, Array]:
    """(sums of products about nought, how many) over pairs of rows that both count, by how many rows they are apart."""
    sums, pairs = np.zeros(count), np.zeros(count)
    for piece in pieces:
        values = np.where(piece.valid, piece.values, 0.0)
        size = 1 << (2 * len(values) - 1).bit_length()
        for into, what in ((sums, values), (pairs, piece.valid.astype(float))):
            spectrum = np.fft.rfft(what, size)
            some = np.fft.irfft(spectrum * np.conj(spectrum), size)[: min(count, len(values))]
            into[: len(some)] += some
    return sums, pairs


def _stretch(lags: Array) -> float:
    """1 + 2 * the correlations behind the filter, up to the first that is not positive when taken in pairs."""
    if lags[0] <= 0.0:
        return 1.0
    length = 1.0
    for k in range(1, len(lags) - 1, 2):
        pair = (lags[k] + lags[k + 1]) / lags[0]
        if pair <= 0.0:
            break
        length += 2.0 * pair
    return length


def sensor_noise(values: Array, valid: Array) -> float:
    """Standard deviation of a signal's white noise, by differences of the order NOISE_ORDER + 1."""
    weights = np.array([1.0])
    for _ in range(NOISE_ORDER + 1):
        weights = np.convolve(weights, [1.0, -1.0])
    rough = whitened(Piece(values, valid), weights)
    some = rough.values[rough.valid]
    if len(some) < 20:
        return 0.0
    spread = 1.4826 * float(np.median(np.abs(some - np.median(some))))
    return spread / float(np.sqrt(np.sum(weights * weights)))


def told_noise(values: Array, rows: Array) -> float:
    """Of what a sensor told, in some rows of it: its white noise, or what its wire rounds where that is more. By the
    values that came alone, however seldom they do: what lies on a line between two of them is quieter. No difference is
    taken over a gap; 0 where there are too few.
    """
    if len(rows) < 2:
        return 0.0
    steps = np.diff(rows, prepend=rows[0])
    even = steps <= 1.5 * max(float(np.median(steps[1:])), 1.0)
    return max(sensor_noise(values[rows], even), quantum_of(values[rows]) / 12.0**0.5)
