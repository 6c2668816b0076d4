"""Data of the figures of a calibration, computed in the process with compiled kernels (learn/compiled_process.py)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.learn.actuators.model import ActuatorModel, simulate_output
from tunefree_hil.learn.actuators.samples import ActuatorSamples, ChannelSamples
from tunefree_hil.learn.physics.windows import FreeRunWindow, OutputCorrection, compute_errors, compute_target_rms
from tunefree_hil.plant.actuation.actuators import ActuatorParams

Array = np.ndarray

LONG_TRACE_S, SHORT_TRACE_S = 8.0, 2.5


class ActuatorTrace(NamedTuple):
    """A stretch of a channel: stamps, command, reported output (NaN where there is none), simulated output."""

    time_s: Array
    command: Array
    output: Array
    fit: Array


class ConstantComparison(NamedTuple):
    """Free-run errors on held-out parts with the data sheet's constants (before) and the fitted ones (after).

    Attributes:
        time_s: Shape (n_compared,).
        before_by_time: RMS of each target over all windows at each time, shape (n_compared, 6).
        after_by_time: Likewise.
        before: RMS by target.
        after: RMS by target.
    """

    time_s: Array
    before_by_time: Array
    after_by_time: Array
    before: dict[str, float]
    after: dict[str, float]
    n_windows: int


def make_traces(samples: ChannelSamples, params: ActuatorParams) -> list[ActuatorTrace]:
    """A long and a short stretch with as much movement as possible; none without samples."""
    if not samples.segments:
        return []
    traces = []
    for seconds in (LONG_TRACE_S, SHORT_TRACE_S):
        segment, begin = _find_most_active(samples.segments, seconds)
        span = slice(begin, begin + round(seconds / segment.dt_s))
        output = np.where(segment.is_compared, segment.output, np.nan)
        time_s = np.arange(len(segment.command)) * segment.dt_s
        fit = simulate_output(ActuatorModel(params), segment)
        traces.append(ActuatorTrace(time_s[span], segment.command[span], output[span], fit[span]))
    return traces


def _find_most_active(segments: Sequence[ActuatorSamples], seconds: float) -> tuple[ActuatorSamples, int]:
    """Segment and row at which a stretch of this length has the most command movement."""
    best_score, best_segment, best_begin = -1.0, segments[0], 0
    for segment in segments:
        rows = round(seconds / segment.dt_s)
        moves = np.abs(np.diff(segment.command, append=segment.command[-1]))
        movement = np.sqrt(moves) * segment.is_compared
        total = np.concatenate([[0.0], np.cumsum(movement)])
        for begin in range(0, max(len(movement) - rows, 1), max(rows // 4, 1)):
            score = float(total[min(begin + rows, len(movement))] - total[begin])
            if score > best_score:
                best_score, best_segment, best_begin = score, segment, begin
    return best_segment, best_begin


def compare_constants(
    windows: Sequence[FreeRunWindow],
    before: tuple[Mapping[str, float], OutputCorrection],
    after: tuple[Mapping[str, float], OutputCorrection],
) -> ConstantComparison | None:
    """Free runs with two sets of constants and output corrections; None without windows."""
    if not windows:
        return None
    errors = [compute_errors(params, correction, windows) for params, correction in (before, after)]
    by_time = [np.sqrt(np.nanmean(error * error, axis=0)) if np.isfinite(error).any() else error[0] for error in errors]
    return ConstantComparison(
        time_s=windows[0].rows * windows[0].dt_s,
        before_by_time=by_time[0],
        after_by_time=by_time[1],
        before=compute_target_rms(errors[0]),
        after=compute_target_rms(errors[1]),
        n_windows=len(windows),
    )
