"""The values of a drive that requirements limit: errors after the start, jerk, steering rate, oscillation, re-plans."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.config.tuning.require_schema import REQUIREMENTS
from tunefree_hil.episode.feasible import curvature_by_time
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.memo import CourseCache
from tunefree_hil.grade.metrics import MetricSamples, peak, rms, window_means, window_ticks
from tunefree_hil.grade.oscillation.detection import oscillation_metrics
from tunefree_hil.grade.oscillation.report import OscillationReport
from tunefree_hil.grade.requirements.limits import CRITERIA, oscillation_limits

Array = np.ndarray
RequirementValues = Mapping[str, float | None]  # by name; None where a column is missing or the drive is too short

GRAVITY_MPS2 = 9.80665
_PEAKS = {
    "lateral_error_peak_m": "lateral_error_m",
    "heading_error_peak_rad": "heading_error_rad",
    "station_error_peak_m": "station_error_m",
    "speed_error_peak_mps": "speed_error_mps",
}
# rows of the table of metrics (grade/table.py) whose swings count
_SWINGS = {
    "steer_oscillation_rad": ("oscillation_steer",),
    "accel_oscillation_mps2": ("oscillation_accel",),
    "pedal_oscillation_frac": ("oscillation_throttle", "oscillation_brake"),
    "speed_oscillation_mps": ("oscillation_speed",),
    "pedal_alternation_per_s": ("pedal_alternation",),
}


class PlannedJerk(NamedTuple):
    """The largest jerk that a course asks for around each window of `jerk_rates`, m/s3."""

    lateral_mps3: Array
    accel_mps3: Array


def measure_requirements(
    recording: Recording, course: Course, original: MetricSamples, oscillation: OscillationReport, replans: int
) -> dict[str, float | None]:
    """The values of a drive by name, in the order of REQUIREMENTS.

    Args:
        original: Samples with the errors against the original path.
    """
    dt_s = recording.dt_s
    planned = _planned_jerk(course)
    values = {name: _peak_error(getattr(original, column), dt_s) for name, column in _PEAKS.items()}
    lateral = original.lateral_error_m
    values["lateral_error_rms_m"] = None if lateral is None else rms(lateral[_start_row(dt_s) :])
    speed, yaw_rate = original.speed_mps, original.yaw_rate_radps
    lateral_accel = None if speed is None or yaw_rate is None else speed * yaw_rate
    on_path = slice(None, max(course.ticks - round(CRITERIA.path_end_s / dt_s), 0))
    lateral_accel = None if lateral_accel is None else lateral_accel[on_path]
    values["lateral_jerk_peak_mps3"] = _excess_jerk(lateral_accel, planned.lateral_mps3, dt_s)
    values["accel_jerk_peak_mps3"] = _excess_jerk(recording.get("accel_mps2"), planned.accel_mps3, dt_s)
    steer = None if original.cmd_steer_rad is None else original.cmd_steer_rad[on_path]
    values["steer_rate_peak_radps"] = _steer_rate(steer, dt_s)
    values |= _swings(oscillation, recording)
    values["replans"] = None if recording.get("replan") is None else float(replans)
    return {name: values[name] for name in REQUIREMENTS}


def jerk_rates(accel_mps2: Array, dt_s: float) -> Array:
    """Mean jerk over 0.5 s, one value every 0.1 s, m/s3."""
    ticks = window_ticks(dt_s)
    means = window_means(accel_mps2, ticks)
    windows = max(1, round(CRITERIA.jerk_window_s / (ticks * dt_s)))
    return (means[windows:] - means[:-windows]) / (windows * ticks * dt_s)


def _find_planned_jerk(course: Course) -> PlannedJerk:
    speed = np.asarray(course.speed_mps)
    lateral = speed * speed * curvature_by_time(course)
    felt = np.asarray(course.accel_mps2) + GRAVITY_MPS2 * np.sin(np.asarray(course.grade_rad))
    return PlannedJerk(_largest_around(lateral, course.dt_s), _largest_around(felt, course.dt_s))


_planned_jerk = CourseCache(_find_planned_jerk)


def _largest_around(accel_mps2: Array, dt_s: float) -> Array:
    """The largest |jerk| within `jerk_margin_s` before and after each window."""
    jerk = np.abs(jerk_rates(accel_mps2, dt_s))
    margin = round(CRITERIA.jerk_margin_s / (window_ticks(dt_s) * dt_s))
    padded = np.pad(jerk, margin)
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * margin + 1).max(axis=1) if len(jerk) else jerk


def _excess_jerk(accel_mps2: Array | None, planned_mps3: Array, dt_s: float) -> float | None:
    """The largest jerk after the start beyond the planned one, 0 where it nowhere exceeds it."""
    if accel_mps2 is None:
        return None
    jerk = jerk_rates(accel_mps2, dt_s)
    first = math.ceil(CRITERIA.start_s / (window_ticks(dt_s) * dt_s))
    count = min(len(jerk), len(planned_mps3))
    excess = np.abs(jerk[first:count]) - planned_mps3[first:count]
    excess = excess[np.isfinite(excess)]
    return max(float(excess.max()), 0.0) if len(excess) else None


def _steer_rate(cmd_steer_rad: Array | None, dt_s: float) -> float | None:
    if cmd_steer_rad is None:
        return None
    ticks = max(1, round(CRITERIA.steer_rate_window_s / dt_s))
    after_start = cmd_steer_rad[_start_row(dt_s) :]
    return peak(after_start[ticks:] - after_start[:-ticks], ticks * dt_s)


def _swings(oscillation: OscillationReport, recording: Recording) -> dict[str, float | None]:
    """Amplitudes, each as a share of its limit there, times the limit that a requirement has by default."""
    shares = oscillation_metrics(oscillation, recording.columns, recording.dt_s)
    values: dict[str, float | None] = {}
    for name, limit in oscillation_limits().items():
        known = [shares[row] for row in _SWINGS[name] if row in shares]
        values[name] = limit * max(known) if known else None
    return values


def _peak_error(error: Array | None, dt_s: float) -> float | None:
    return None if error is None else peak(error[_start_row(dt_s) :], 1.0)


def _start_row(dt_s: float) -> int:
    return round(CRITERIA.start_s / dt_s)
