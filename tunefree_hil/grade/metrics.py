"""The metrics that a score may weigh: the source's 15 (apollo_facts 6.1, 6.2; the paper's Table II) and three more.

All 42 of the source, of which these are a part, are in table.py; they are computed where somebody asks for a profile.

Notation of apollo_facts 6.1: e the error, V = max(|v_ref|, 1.0 m/s), C = max(|kappa_ref|, 0.02852 1/m), L the
wheelbase, T = N_f dt = 1 s. RMS = sqrt(sum s^2 / (N - 1)). Every metric is dimensionless, 0 is perfect, and it is None
(never 0) where a column is missing or fewer than 5 samples count. Different from the source on purpose: the harsh
heading rate uses the rate (AS_PUBLISHED keeps the slip), and lateral jerk is that of v * yaw rate.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.episode.feasible import curvature_by_time
from tunefree_hil.episode.recording import Recording

Array = np.ndarray

# apollo_facts 6.1, constants
HARSH_ACCEL_MPS2 = 1.0
HARSH_CURVATURE_1PM = 0.05
STOP_MPS = 0.03
LEAST_SPEED_MPS = 1.0
LEAST_CURVATURE_1PM = 0.02852
HORIZON_S = 1.0  # N_f dt
LEAST_SAMPLES = 5

# ours
LATERAL_JERK_MPS3 = 2.0  # the source's threshold of a bad sensation (6.1)
JERK_WINDOW_S = 0.1  # v * yaw rate is averaged over it, or the noise of a yaw-rate sensor would be the jerk


class Samples(NamedTuple):
    """What the metrics look at, one row a tick; None for what could not be had. Signs as in interfaces 6."""

    ref_speed_mps: Array | None
    ref_accel_mps2: Array | None
    ref_curvature_1pm: Array | None
    station_error_m: Array | None
    speed_error_mps: Array | None
    lateral_error_m: Array | None
    lateral_error_rate_mps: Array | None
    heading_error_rad: Array | None
    heading_error_rate_radps: Array | None
    cmd_steer_rad: Array | None
    speed_mps: Array | None
    yaw_rate_radps: Array | None


class Scales(NamedTuple):
    """The vehicle's numbers that metrics are divided by, and the time of a tick."""

    wheelbase_m: float
    steer_rad: float  # limit of the steering wheel
    steer_rate_radps: float
    dt_s: float


def samples_of(recording: Recording) -> Samples:
    """The columns as they are: errors against the current trajectory."""
    return Samples(*(recording.get(name) for name in Samples._fields))


class Rms(NamedTuple):
    """RMS of error / (the product of the letters of `by`: V, C, L, T) over the samples of `where`."""

    error: str
    by: str
    where: str


class Peak(NamedTuple):
    """max |error| / threshold over all samples."""

    error: str
    threshold: float


class Own(NamedTuple):
    """RMS of a series of its own; `needs`: the samples that it is made of."""

    series: Callable[[Samples, Scales], Array | None]
    needs: tuple[str, ...]


def steer_rate(samples: Samples, scales: Scales) -> Array | None:
    """The steering command's rate (difference of one tick) / limit of the steering rate."""
    if samples.cmd_steer_rad is None:
        return None
    return np.diff(samples.cmd_steer_rad) / (scales.dt_s * scales.steer_rate_radps)


def steering_usage(samples: Samples, scales: Scales) -> Array | None:
    """The steering command / limit (6.1: command / 100, command in percent of the limit)."""
    return None if samples.cmd_steer_rad is None else samples.cmd_steer_rad / scales.steer_rad


def lateral_jerk(samples: Samples, scales: Scales) -> Array | None:
    """d/dt (v * yaw rate) / 2 m/s^3, between means over 0.1 s.

    The source's "lateral acceleration" is a_lon sin(heading error) (3.1); this is the one that passengers feel.
    """
    if samples.speed_mps is None or samples.yaw_rate_radps is None:
        return None
    ticks = window_ticks(scales.dt_s)
    means = window_means(samples.speed_mps * samples.yaw_rate_radps, ticks)
    return np.diff(means) / (ticks * scales.dt_s * LATERAL_JERK_MPS3)


def window_ticks(dt_s: float) -> int:
    """Ticks of the window over which a signal is averaged before it is differentiated."""
    return max(1, round(JERK_WINDOW_S / dt_s))


def window_means(values: Array, ticks: int) -> Array:
    """Means of windows that follow each other; a rest shorter than a window is left out."""
    windows = len(values) // ticks
    return values[: windows * ticks].reshape(windows, ticks).mean(axis=1)


METRICS: dict[str, Rms | Peak | Own] = {
    "station_err_std": Rms("station_error_m", "VT", "moving"),
    "station_err_std_harsh": Rms("station_error_m", "VT", "harsh accel"),
    "speed_err_std": Rms("speed_error_mps", "V", "moving"),
    "speed_err_std_harsh": Rms("speed_error_mps", "V", "harsh accel"),
    "lateral_err_std": Rms("lateral_error_m", "CVLT", "moving"),
    "lateral_err_std_harsh": Rms("lateral_error_m", "CVLT", "harsh curvature"),
    "heading_err_std": Rms("heading_error_rad", "CVT", "moving"),
    "heading_err_std_harsh": Rms("heading_error_rad", "CVT", "harsh curvature"),
    "heading_err_rate_std": Rms("heading_error_rate_radps", "CV", "moving"),
    "heading_err_rate_std_harsh": Rms("heading_error_rate_radps", "CV", "harsh curvature"),
    "station_err_peak": Peak("station_error_m", 1.0),
    "speed_err_peak": Peak("speed_error_mps", 0.5),
    "lateral_err_peak": Peak("lateral_error_m", 0.5),
    "heading_err_peak": Peak("heading_error_rad", 0.5236),
    "heading_err_rate_peak": Peak("heading_error_rate_radps", 0.5236),
    "steer_rate_rms": Own(steer_rate, ("cmd_steer_rad",)),
    "lateral_jerk_rms": Own(lateral_jerk, ("speed_mps", "yaw_rate_radps")),
    "steering_control_usage": Own(steering_usage, ("cmd_steer_rad",)),
}

# 6.1: as written, this one divides the heading error itself, not its rate, by C V
Row = Rms | Peak | Own
AS_PUBLISHED: dict[str, Row] = {"heading_err_rate_std_harsh": Rms("heading_error_rad", "CV", "harsh curvature")}


class Sharing:
    """Samples of one drive with what several metrics have in common: which samples count, and their divisors."""

    def __init__(self, samples: Samples, scales: Scales) -> None:
        self.samples = samples
        self.scales = scales
        self._kept: dict[str, Array | None] = {}
        self._divisors: dict[str, Array | None] = {}
        self._cut: dict[tuple[str, str], Array] = {}

    def series(self, row: Rms | Peak | Own) -> Array | None:
        """What a metric takes the RMS or the peak of, one value a sample that counts; None where a column is missing.

        A Peak's is not yet divided by its threshold. Samples that are not finite are still in it.
        """
        if isinstance(row, Own):
            return row.series(self.samples, self.scales)
        error = getattr(self.samples, row.error)
        if error is None or isinstance(row, Peak):
            return error
        kept = self.kept(row.where)
        if row.by not in self._divisors:
            self._divisors[row.by] = _divisor(row.by, self.samples, self.scales)
        divisor = self._divisors[row.by]
        if kept is None or divisor is None:
            return None
        key = (row.by, row.where)
        if key not in self._cut:
            self._cut[key] = divisor[kept]
        return error[kept] / self._cut[key]

    def kept(self, where: str) -> Array | None:
        """The samples that count, as flags."""
        if where not in self._kept:
            self._kept[where] = _where(where, self.samples)
        return self._kept[where]

    def metric(self, row: Rms | Peak | Own) -> float | None:
        """The metric of a row."""
        series = self.series(row)
        if series is None:
            return None
        return peak(series, row.threshold) if isinstance(row, Peak) else rms(series)


def row_of(name: str, *, as_published: bool = False) -> Rms | Peak | Own:
    """The row of a metric; `as_published` keeps the source's slip. KeyError for an unknown name."""
    return AS_PUBLISHED.get(name, METRICS[name]) if as_published else METRICS[name]


def metric(name: str, samples: Samples, scales: Scales, *, as_published: bool = False) -> float | None:
    """One metric by its name in METRICS. KeyError for an unknown name."""
    return Sharing(samples, scales).metric(row_of(name, as_published=as_published))


def is_planned(name: str, plan: Samples) -> bool:
    """Whether the plan itself has the 5 samples that a metric of METRICS needs. plan: what samples_of_plan gives."""
    return is_planned_row(METRICS[name], plan)


def is_planned_row(row: Rms | Peak | Own, plan: Samples) -> bool:
    """As is_planned, of a row."""
    kept = _where(row.where, plan) if isinstance(row, Rms) else None
    return kept is None or int(np.count_nonzero(kept)) >= LEAST_SAMPLES


def samples_of_plan(course: Course) -> Samples:
    """The references of a course as planned, one row a tick; no errors."""
    references = dict.fromkeys(Samples._fields)
    references |= {
        "ref_speed_mps": np.asarray(course.speed_mps),
        "ref_accel_mps2": np.asarray(course.accel_mps2),
        "ref_curvature_1pm": curvature_by_time(course),
    }
    return Samples(**references)


def rms(values: Array) -> float | None:
    """sqrt(sum s^2 / (N - 1)) over the finite values; None below 5 of them."""
    values = values[np.isfinite(values)]
    if len(values) < LEAST_SAMPLES:
        return None
    return math.sqrt(float(values @ values) / (len(values) - 1))


def peak(error: Array, threshold: float) -> float | None:
    """max |error| / threshold over the finite values; None below 5 of them."""
    error = error[np.isfinite(error)]
    if len(error) < LEAST_SAMPLES:
        return None
    return float(np.abs(error).max()) / threshold


def _where(which: str, samples: Samples) -> Array | None:
    """The samples that count: v_ref >= 0.03, |a_ref| >= 1 or |kappa_ref| >= 0.05; None where the column is missing."""
    if which == "moving":
        return None if samples.ref_speed_mps is None else samples.ref_speed_mps >= STOP_MPS
    if which == "harsh accel":
        return None if samples.ref_accel_mps2 is None else np.abs(samples.ref_accel_mps2) >= HARSH_ACCEL_MPS2
    return None if samples.ref_curvature_1pm is None else np.abs(samples.ref_curvature_1pm) >= HARSH_CURVATURE_1PM


def _divisor(by: str, samples: Samples, scales: Scales) -> Array | None:
    """Product of the letters, for every sample; None where a column is missing."""
    if samples.ref_speed_mps is None:
        return None
    product = np.maximum(np.abs(samples.ref_speed_mps), LEAST_SPEED_MPS)  # every row of the table has a V
    if "C" in by:
        if samples.ref_curvature_1pm is None:
            return None
        product = product * np.maximum(np.abs(samples.ref_curvature_1pm), LEAST_CURVATURE_1PM)
    if "L" in by:
        product = product * scales.wheelbase_m
    return product * HORIZON_S if "T" in by else product
