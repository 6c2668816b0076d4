"""What signals do in the band of oscillations beyond what the reference asks for.

The band-pass has zero phase. What the reference explains of a signal is a sum of its columns at a few shifts, all
band-passed, by ridge regression: a response of 1.9 s. So a slalom that is followed late, with a gain error or with an
overshoot is no oscillation, and a limit cycle in a slalom still is one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

Array = np.ndarray

# gain of the band-pass: 0 outside the stops, 1 between the passes, half cosines over log frequency between
LOW_STOP_HZ, LOW_PASS_HZ = 0.3, 0.5
HIGH_PASS_HZ, HIGH_STOP_HZ = 5.0, 8.0
PAD_S = (
    2.0  # by which a record is continued at both ends, mirrored through its end points; longer than the filter rings
)
MAX_STEP_S = 0.04  # of the residual: five samples a cycle at the band's upper edge
BLOCK_ROWS = 256  # the padded length is a multiple, which the transform does fast
# Of the reference. Below 0: preview; above: dead time, lag, overshoot. Up to 0.4 s only, a calm manual set in a double
# lane change kept 9 deg of wheel as an oscillation.
SHIFTS_S = (-0.32, 0.0, 0.32, 0.64, 0.96, 1.28, 1.6)
RIDGE_SHARE = 1e-3  # of the energy that a term has in the whole drive
SHORT_S = 12.0  # a drive of this length has twice that ridge, a shorter one by the fourth power of its length more: in
# 3 s any swing looks like a response to some manoeuvre, and the wheel was explained with thousands of degrees
TINY = 1e-300  # energy; a term that is 0 where it is fitted has no weight
ROUNDING = 1e-12  # of a reference column's largest value: smaller motion in the band is rounding and asks for nothing
UNFITTED_END_S = 1.0  # a manoeuvre may break off there, and what is mirrored follows before it is asked


class ExplainedSignals(NamedTuple):
    """Names of signals, and of the reference columns that explain them."""

    signals: Sequence[str]
    references: Sequence[str]


class BandResiduals(NamedTuple):
    """Arrays of shape (n_signals, n_steps) in the order of `signals`, one column every `stride` rows from row 0.

    explained_range: peak to peak of a sine with the RMS that the explained part has within a second.
    """

    signals: tuple[str, ...]
    values: Array
    explained: Array
    explained_range: Array
    dt_s: float
    stride: int


class _Grid(NamedTuple):
    """Rows before a padded record and in all, rows a step of the residual, and the bins of the band with their gain.

    shifts: SHIFTS_S in steps. first, count: steps of the record; the first `fitted` of them are.
    """

    pad: int
    rows: int
    stride: int
    band: slice
    gain: Array
    shifts: tuple[int, ...]
    first: int
    count: int
    fitted: int
    ridge_share: float


def band_gain(frequency_hz: Array) -> Array:
    """Gain of the band-pass at frequencies above 0."""
    log = np.log(frequency_hz)
    rise = (log - math.log(LOW_STOP_HZ)) / math.log(LOW_PASS_HZ / LOW_STOP_HZ)
    fall = (math.log(HIGH_STOP_HZ) - log) / math.log(HIGH_STOP_HZ / HIGH_PASS_HZ)
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(np.minimum(rise, fall), 0.0, 1.0))


def band_residuals(columns: Mapping[str, Array], groups: Sequence[ExplainedSignals], dt_s: float) -> BandResiduals:
    """The residuals of the signals of all groups.

    Args:
        columns: Signals and references by name, finite, each of shape (n_ticks,), longer than PAD_S.
    """
    signals = tuple(name for group in groups for name in group.signals)
    names = list(dict.fromkeys((*signals, *(name for group in groups for name in group.references))))
    records = np.array([columns[name] for name in names])
    grid = _make_grid(records.shape[1], dt_s)
    filtered = _band_passed(records, grid)
    is_still = np.abs(filtered).max(axis=1) <= ROUNDING * np.abs(records).max(axis=1)
    first, last = grid.first, grid.first + grid.count
    values = filtered[: len(signals), first:last]
    explained = np.zeros_like(values)
    row = 0
    for group in groups:
        asked = [names.index(name) for name in group.references if not is_still[names.index(name)]]
        rows = slice(row, row + len(group.signals))
        if asked:
            terms = [filtered[i, first - shift : last - shift] for i in asked for shift in grid.shifts]
            explained[rows] = _explained(values[rows], np.array(terms), grid)
        row = rows.stop
    step_s = grid.stride * dt_s
    explained_range = _range_within(explained, round(1.0 / step_s))
    return BandResiduals(signals, values - explained, explained, explained_range, step_s, grid.stride)


@lru_cache(maxsize=32)
def _make_grid(ticks: int, dt_s: float) -> _Grid:
    stride = 1
    while 2 * stride * dt_s <= MAX_STEP_S and 2 * stride < BLOCK_ROWS:
        stride *= 2
    pad = round(PAD_S / dt_s) // stride * stride
    rows = -(-(ticks + 2 * pad) // BLOCK_ROWS) * BLOCK_ROWS
    bin_hz = 1.0 / (rows * dt_s)
    top_hz = min(HIGH_STOP_HZ, 0.5 / (stride * dt_s))
    bottom, top = math.ceil(LOW_STOP_HZ / bin_hz), math.floor(top_hz / bin_hz)
    gain = band_gain(np.arange(bottom, top) * bin_hz) / stride
    shifts = tuple(round(shift_s / (stride * dt_s)) for shift_s in SHIFTS_S)
    count = -(-ticks // stride)
    fitted = count - round(UNFITTED_END_S / (stride * dt_s))
    short = SHORT_S / (fitted * stride * dt_s)
    ridge_share = RIDGE_SHARE * (1.0 + short * short * short * short)
    return _Grid(pad, rows, stride, slice(bottom, top), gain, shifts, pad // stride, count, fitted, ridge_share)


def _band_passed(records: Array, grid: _Grid) -> Array:
    """The records and their padding, band-passed, at the steps of the residual."""
    pad, end = grid.pad, grid.pad + records.shape[1]
    rows = np.empty((len(records), grid.rows))
    rows[:, pad:end] = records
    rows[:, :pad] = 2.0 * records[:, :1] - records[:, pad:0:-1]
    rows[:, end : end + pad] = 2.0 * records[:, -1:] - records[:, -2 : -pad - 2 : -1]
    last = rows[:, end + pad - 1 : end + pad]
    rows[:, end + pad :] = last + (rows[:, :1] - last) * np.linspace(0.0, 1.0, grid.rows - end - pad)
    steps = grid.rows // grid.stride
    spectra = np.zeros((len(records), steps // 2 + 1), dtype=complex)
    spectra[:, grid.band] = np.fft.rfft(rows, axis=1)[:, grid.band] * grid.gain
    return np.fft.irfft(spectra, steps, axis=1)


def _explained(signals: Array, terms: Array, grid: _Grid) -> Array:
    """What a sum of the terms explains of each signal."""
    x, y = terms[:, : grid.fitted], signals[:, : grid.fitted]
    # einsum, as the bits of a matrix product depend on the number of threads
    squares = np.einsum("it,jt->ij", x, x)
    squares += np.diag(grid.ridge_share * np.einsum("it,it->i", terms, terms) + TINY)
    weights = np.linalg.solve(squares, np.einsum("it,jt->ij", x, y))
    return np.einsum("ij,it->jt", weights, terms)


def _range_within(values: Array, reach: int) -> Array:
    """Peak to peak of a sine with the RMS of the values at most `reach` steps away."""
    count = values.shape[1]
    sums = np.zeros((len(values), count + 1))
    np.cumsum(values * values, axis=1, out=sums[:, 1:])
    first = np.maximum(np.arange(count) - reach, 0)
    last = np.minimum(np.arange(count) + reach + 1, count)
    return math.sqrt(8.0) * np.sqrt((sums[:, last] - sums[:, first]).clip(0.0) / (last - first))
