"""An independent check of oscillations: no filter, no turning point and no fit of the metric is used.

Two looks at a drive, each of which may find a swing, and then says how large it stays:

- Spectral: in windows of about three cycles a sine explains most of what is left of a parabola, and the reference
  has no such sine. A cycle resembles the next (autocorrelation). The amplitude is that of the weakest cycle.
- Pedals: changes from throttle to brake or back within 10 s, beyond the reference's own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import signal as processing

from tunefree_hil.grade.oscillation.report import CRITERIA

Array = np.ndarray


class CheckCriteria(NamedTuple):
    """Thresholds of the independent check."""

    low_hz: float = 0.5  # band of issue 44
    high_hz: float = 5.0
    edge: float = 1.1  # the band is so much wider to either side: the frequency of three cycles scatters
    smooth_hz: float = 8.0  # low-pass before everything else, and sampled every step_s
    step_s: float = 0.02
    windows_s: tuple[float, ...] = (0.6, 0.8, 1.1, 1.5, 2.0, 2.7, 3.6, 4.8, 6.0)
    steps_a_window: int = 6
    min_cycles: float = 2.6  # in a window: three cycles whose first and last quarter may be missing
    start_s: float = CRITERIA.start_s  # the start is not counted, except in drives that end early
    early_end_s: float = 8.0  # a shorter drive left its lane: early_cycles are enough
    early_cycles: float = 1.6  # two cycles, as above
    max_cycles: float = 4.5
    sine_share: float = 0.5  # least share of the window's energy beyond a parabola in one sine
    likeness: float = 0.4  # least correlation of a window with itself one cycle later
    missed_crossings: float = 0.5  # that a straight line through a window may lack of two a cycle
    beyond_reference: float = 2.0  # least amplitude / the reference's, scaled by the gain of slow motion
    least_ratio: float = 0.7  # smaller swings are not looked at
    margin_s: float = 2.0  # before and after a window in which the reference counts, too
    slow_hz: float = 0.4  # below it the gain from the reference to the signal is taken
    delay_s: float = 1.0  # longest of a signal behind its reference for that gain
    pedal_windows_s: tuple[float, ...] = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0)


CHECK = CheckCriteria()


class CheckedSignal(NamedTuple):
    """Column, the reference column that it may follow, and the limit of its peak-to-peak swing."""

    column: str
    reference: str
    limit: float


STEER_COLUMNS = ("cmd_steer_rad", "out_steer_rad")
CHECKED = (
    *(CheckedSignal(column, "ref_curvature_1pm", CRITERIA.steer_rad) for column in STEER_COLUMNS),
    CheckedSignal("accel_mps2", "ref_accel_mps2", CRITERIA.accel_mps2),
    CheckedSignal("cmd_throttle_frac", "ref_accel_mps2", CRITERIA.pedal_frac),
    CheckedSignal("cmd_brake_frac", "ref_accel_mps2", CRITERIA.pedal_frac),
    CheckedSignal("speed_mps", "ref_speed_mps", CRITERIA.speed_mps),
)


class CheckedSwing(NamedTuple):
    """The largest swing that stays: amplitude / limit (0: none), signal, frequency, when it begins."""

    ratio: float = 0.0
    column: str = ""
    frequency_hz: float = 0.0
    from_s: float = 0.0


class _Record(NamedTuple):
    """A signal, its reference scaled to it, and its limit at every step; shape (n_steps,) each."""

    column: str
    values: Array
    reference: Array
    limit: Array
    dt_s: float


def strongest_swing(columns: Mapping[str, Array], row: CheckedSignal, dt_s: float) -> CheckedSwing:
    """The largest amplitude / limit of a signal of a drive, whose columns have no gap."""
    record = _record(columns, row, dt_s)
    return max((CheckedSwing(), *_regular_swings(record)), key=lambda swing: swing.ratio)


def alternation(columns: Mapping[str, Array], rest_frac: float, dt_s: float) -> CheckedSwing:
    """The rate of changes between the pedals in windows with enough of them beside the reference's own, / its limit."""
    up = np.maximum(columns["cmd_throttle_frac"] - rest_frac, 0.0)
    down = np.maximum(columns["cmd_brake_frac"] - rest_frac, 0.0)
    changes = _changes(up - down, CRITERIA.active_frac) - _changes(columns["ref_accel_mps2"], CRITERIA.asked_accel_mps2)
    sums = np.concatenate([[0.0], np.cumsum(changes)])
    best = CheckedSwing()
    for window_s in CHECK.pedal_windows_s:
        window = round(window_s / dt_s)
        counts = sums[np.minimum(np.arange(len(sums)) + window, len(changes))] - sums
        first = int(np.argmax(counts))
        rate = float(counts[first] - 1.0) / window_s
        if counts[first] >= CRITERIA.switches and rate > best.frequency_hz:
            best = CheckedSwing(rate / CRITERIA.switches_per_s, "pedals", rate, first * dt_s)
    return best._replace(frequency_hz=0.5 * best.frequency_hz)


def _record(columns: Mapping[str, Array], row: CheckedSignal, dt_s: float) -> _Record:
    stride = max(1, round(CHECK.step_s / dt_s))
    low_pass = processing.butter(3, CHECK.smooth_hz, "lowpass", fs=1.0 / dt_s, output="sos")
    values, reference = (
        processing.sosfiltfilt(low_pass, columns[name])[::stride] for name in (row.column, row.reference)
    )
    limit = np.full(len(values), row.limit)
    if row.column in STEER_COLUMNS:
        slower = CRITERIA.steer_speed_mps / np.maximum(np.abs(columns["ref_speed_mps"][::stride]), 0.1)
        limit = np.clip(row.limit * slower * slower, row.limit, CRITERIA.max_steer_rad)
    step_s = stride * dt_s
    return _Record(row.column, values, reference * _slow_gain(values, reference, step_s), limit, step_s)


def _slow_gain(values: Array, reference: Array, dt_s: float) -> float:
    """The largest gain with which the slow motion of a signal follows that of its reference, at some delay."""
    slow = processing.butter(3, CHECK.slow_hz, "lowpass", fs=1.0 / dt_s, output="sos")
    signal, asked = (processing.sosfiltfilt(slow, each - each.mean()) for each in (values, reference))
    energy = float(asked @ asked)
    if energy < 1e-9 * len(asked) * max(float(np.max(np.abs(reference))) ** 2, 1e-9):
        return 0.0
    delays = range(0, min(round(CHECK.delay_s / dt_s), len(asked) // 2), max(1, round(0.1 / dt_s)))
    return max(abs(float(signal[delay:] @ asked[: len(asked) - delay])) / energy for delay in delays)


def _regular_swings(record: _Record) -> Iterator[CheckedSwing]:
    """The swings of all windows in which a sine stands out."""
    count, dt_s = len(record.values), record.dt_s
    is_early = count * dt_s < CHECK.early_end_s
    cycles = CHECK.early_cycles if is_early else CHECK.min_cycles
    first = 0 if is_early else round(CHECK.start_s / dt_s)
    lengths = sorted({min(round(window_s / dt_s), count - 2) for window_s in CHECK.windows_s})
    margin = round(CHECK.margin_s / dt_s)
    for length in lengths:
        for start in range(0, count - length + 1, max(1, length // CHECK.steps_a_window)):
            window = record.values[start : start + length]
            limit = float(np.mean(record.limit[start : start + length]))
            if start < first or float(np.ptp(window)) < CHECK.least_ratio * limit:
                continue
            around = record.reference[max(0, start - margin) : start + length + margin]
            frequency_hz, amplitude = _regular_swing(window, around, dt_s, cycles)
            if amplitude > 0.0:
                yield CheckedSwing(amplitude / limit, record.column, frequency_hz, start * dt_s)


def _regular_swing(window: Array, reference: Array, dt_s: float, min_cycles: float) -> tuple[float, float]:
    """Frequency and peak-to-peak amplitude of the weakest cycle; zeros where there is no regular swing."""
    length = len(window)
    line, parabola = _trends(length)
    bent = window - parabola @ (parabola.T @ window)
    frequency_hz = _peak_hz(bent, dt_s)
    cycles = frequency_hz * length * dt_s
    if not min_cycles <= cycles <= CHECK.max_cycles or frequency_hz < CHECK.low_hz / CHECK.edge:
        return 0.0, 0.0
    if _crossings(window - line @ (line.T @ window)) < 2.0 * cycles - 2.0 * CHECK.missed_crossings:
        return 0.0, 0.0
    amplitude, share = _sine(bent, frequency_hz, dt_s)
    lag = round(1.0 / (frequency_hz * dt_s))
    if share < CHECK.sine_share or _correlation(bent[:-lag], bent[lag:]) < CHECK.likeness:
        return 0.0, 0.0
    starts = range(0, max(1, len(reference) - length + 1), max(1, length // CHECK.steps_a_window))
    asked = max(_sine(_unbent(reference[i : i + length]), frequency_hz, dt_s)[0] for i in starts)
    if amplitude < CHECK.beyond_reference * asked:
        return 0.0, 0.0
    return frequency_hz, 2.0 * _weakest_cycle(bent, frequency_hz, dt_s)


@lru_cache(maxsize=256)
def _trends(length: int) -> tuple[Array, Array]:
    """Orthonormal bases of straight lines and of parabolas, shape (length, 2) and (length, 3)."""
    time = np.linspace(-1.0, 1.0, length)
    basis = np.linalg.qr(np.stack([np.ones(length), time, time * time], axis=1))[0]
    return basis[:, :2], basis


def _unbent(values: Array) -> Array:
    parabola = _trends(len(values))[1]
    return values - parabola @ (parabola.T @ values)


def _peak_hz(values: Array, dt_s: float) -> float:
    """Frequency of the largest density, from well below the band."""
    power = np.abs(np.fft.rfft(values * np.hanning(len(values)), 4 * len(values))) ** 2
    frequency_hz = np.fft.rfftfreq(4 * len(values), dt_s)
    in_band = (frequency_hz >= CHECK.slow_hz * CHECK.low_hz) & (frequency_hz <= CHECK.high_hz * CHECK.edge)
    return float(frequency_hz[in_band][int(np.argmax(power[in_band]))])


def _sine(unbent: Array, frequency_hz: float, dt_s: float) -> tuple[float, float]:
    """Amplitude of the best sine of a frequency in values without a parabola, and its share of their energy."""
    angle = 2.0 * math.pi * frequency_hz * dt_s * np.arange(len(unbent))
    parabola = _trends(len(unbent))[1]
    waves = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    waves = waves - parabola @ (parabola.T @ waves)
    weights = np.linalg.lstsq(waves, unbent, rcond=None)[0]
    energy, rest = float(unbent @ unbent), unbent - waves @ weights
    return float(np.hypot(*weights)), 1.0 - float(rest @ rest) / energy if energy > 0.0 else 0.0


def _weakest_cycle(values: Array, frequency_hz: float, dt_s: float) -> float:
    """The least amplitude of the fundamental among all stretches of one cycle."""
    length = min(round(1.0 / (frequency_hz * dt_s)), len(values))
    turning = np.exp(-2j * math.pi * frequency_hz * dt_s * np.arange(length))
    cycles = np.lib.stride_tricks.sliding_window_view(values, length)
    return float(np.min(np.abs((cycles - cycles.mean(axis=1, keepdims=True)) @ turning))) * 2.0 / length


def _correlation(first: Array, second: Array) -> float:
    energy = math.sqrt(float(first @ first) * float(second @ second))
    return float(first @ second) / energy if energy > 0.0 else 0.0


def _crossings(values: Array) -> int:
    signs = np.sign(values)
    return int(np.count_nonzero(signs[1:] * signs[:-1] < 0.0))


def _changes(values: Array, dead_zone: float) -> Array:
    """1 in the rows where the sign outside of the dead zone is another one than before."""
    sides = np.where(np.abs(values) > dead_zone, np.sign(values), 0.0)
    rows = np.flatnonzero(sides)
    changes = np.zeros(len(values))
    changes[rows[1:][np.diff(sides[rows]) != 0.0]] = 1.0
    return changes
