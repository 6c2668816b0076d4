"""The metrics that a score may weigh: the 15 of Apollo's control profiling (the paper's Table II) and fifteen more.

All 42 metrics of Apollo are in table.py; they are computed for a profile only. Ten of this project separate the start
of a drive, which begins beside its road, from the rest (`DriveStartCriteria`). Notation (docs/reference/grading.md):
e the error, V = max(|v_ref|, 1.0 m/s), C = max(|kappa_ref|, 0.02852 1/m), L the wheelbase, T = N_f dt = 1 s,
RMS = sqrt(sum s^2 / (N - 1)). Every metric is dimensionless, 0 is perfect, and it is None (never 0) where a column is
missing or fewer than 5 samples count. Two deliberate differences: the harsh heading rate uses the rate (AS_PUBLISHED
keeps Apollo's error), and lateral jerk is that of v * yaw rate.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.episode.feasible import curvature_by_time
from tunefree_hil.episode.recording import Recording

Array = np.ndarray

# constants of Apollo's control profiling
HARSH_ACCEL_MPS2 = 1.0
HARSH_CURVATURE_1PM = 0.05
STOP_MPS = 0.03
MIN_SPEED_MPS = 1.0
MIN_CURVATURE_1PM = 0.02852
HORIZON_S = 1.0  # N_f dt
MIN_SAMPLES = 5

# constants of this project
JERK_MPS3 = 2.0  # Apollo's threshold of a bad sensation
PEDAL_RATE_PER_S = (
    0.5  # duty/s; RMS of the pedals' rate in a poor but drivable set on the van (docs/results/score_shares.md)
)
JERK_WINDOW_S = 0.1  # averaging time before a derivative; without it the jerk would be the noise of the sensor


class DriveStartCriteria(NamedTuple):
    """The start of a drive, in which the vehicle comes from beside its road; lengths are lateral error."""

    duration_s: float = 3.0  # s; issue 44 counts errors after the first 3 s
    min_offset_m: float = 0.1  # m; a smaller first error is no offset: noise of the position reaches 0.03 m
    settled_m: float = 0.05  # m; band of a settled start: the error of straight driving with noise stays below 0.035 m


START = DriveStartCriteria()


class MetricSamples(NamedTuple):
    """Input of the metrics, arrays of shape (n_ticks,); None where not available. Signs: docs/reference/files.md."""

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
    accel_mps2: Array | None
    cmd_throttle_frac: Array | None
    cmd_brake_frac: Array | None


class MetricScales(NamedTuple):
    """Vehicle constants that metrics are divided by, and the tick."""

    wheelbase_m: float
    steer_rad: float  # limit of the steering wheel
    steer_rate_radps: float
    dt_s: float


def samples_from_recording(recording: Recording) -> MetricSamples:
    """The recorded columns: errors against the current (re-planned) trajectory."""
    return MetricSamples(*(recording.get(name) for name in MetricSamples._fields))


class Subset(Enum):
    """Samples that an RMS metric counts."""

    MOVING = "moving"
    HARSH_ACCEL = "harsh accel"
    HARSH_CURVATURE = "harsh curvature"


class RmsMetric(NamedTuple):
    """RMS of error / (product of the letters of `divisors`: V, C, L, T) over the samples of `subset`."""

    error: str
    divisors: str
    subset: Subset


class PeakMetric(NamedTuple):
    """max |error| / threshold over all samples, or over those after the start."""

    error: str
    threshold: float
    after_start: bool = False


class LaterRmsMetric(NamedTuple):
    """RMS of error / scale over the samples after the start."""

    error: str
    scale: float


class StartMetric(NamedTuple):
    """A number of the lateral error during the start, shape (n_ticks,), given dt_s."""

    value: Callable[[Array, float], float]


class SeriesMetric(NamedTuple):
    """RMS of a computed series; needs: the columns it is computed from."""

    series: Callable[[MetricSamples, MetricScales], Array | None]
    needs: tuple[str, ...]


def steer_rate(samples: MetricSamples, scales: MetricScales) -> Array | None:
    """Rate of the steering command (difference over one tick) / limit of the steering rate."""
    if samples.cmd_steer_rad is None:
        return None
    return np.diff(samples.cmd_steer_rad) / (scales.dt_s * scales.steer_rate_radps)


def steering_usage(samples: MetricSamples, scales: MetricScales) -> Array | None:
    """Steering command / steering limit."""
    return None if samples.cmd_steer_rad is None else samples.cmd_steer_rad / scales.steer_rad


def lateral_jerk(samples: MetricSamples, scales: MetricScales) -> Array | None:
    """d/dt (v * yaw rate) / 2 m/s^3, between means over 0.1 s.

    Apollo's lateral acceleration is a_lon sin(heading error); v * yaw rate is what passengers feel.
    """
    if samples.speed_mps is None or samples.yaw_rate_radps is None:
        return None
    return window_rates(samples.speed_mps * samples.yaw_rate_radps, scales.dt_s) / JERK_MPS3


def longitudinal_jerk(samples: MetricSamples, scales: MetricScales) -> Array | None:
    """d/dt acceleration / 2 m/s^3, between means over 0.1 s."""
    return None if samples.accel_mps2 is None else window_rates(samples.accel_mps2, scales.dt_s) / JERK_MPS3


def pedal_rate(samples: MetricSamples, scales: MetricScales) -> Array | None:
    """d/dt (throttle - brake) / 0.5 duty/s, between means over 0.1 s; what both have at rest cancels."""
    if samples.cmd_throttle_frac is None or samples.cmd_brake_frac is None:
        return None
    return window_rates(samples.cmd_throttle_frac - samples.cmd_brake_frac, scales.dt_s) / PEDAL_RATE_PER_S


def start_overshoot(lateral_error_m: Array, dt_s: float) -> float:
    """Largest error on the other side of the road / initial offset, of means over 0.1 s."""
    means = window_means(lateral_error_m, window_ticks(dt_s))
    return max(0.0, float((-means / means[0]).max()))


def start_settling(lateral_error_m: Array, dt_s: float) -> float:
    """Time until means over 0.1 s stay within the band / duration of the start; 1 where they do not."""
    means = window_means(lateral_error_m, window_ticks(dt_s))
    outside = np.flatnonzero(np.abs(means) > START.settled_m)
    return (float(outside[-1]) + 1.0) / len(means) if len(outside) else 0.0


def start_ticks(dt_s: float) -> int:
    """Number of ticks of the start of a drive."""
    return round(START.duration_s / dt_s)


def window_rates(values: Array, dt_s: float) -> Array:
    """d/dt between means over JERK_WINDOW_S."""
    ticks = window_ticks(dt_s)
    return np.diff(window_means(values, ticks)) / (ticks * dt_s)


def window_ticks(dt_s: float) -> int:
    """Number of ticks over which a signal is averaged before it is differentiated."""
    return max(1, round(JERK_WINDOW_S / dt_s))


def window_means(values: Array, ticks: int) -> Array:
    """Means of consecutive windows; an incomplete window at the end is dropped."""
    windows = len(values) // ticks
    return values[: windows * ticks].reshape(windows, ticks).mean(axis=1)


MetricFormula = RmsMetric | PeakMetric | LaterRmsMetric | SeriesMetric | StartMetric

# Divisors of this project's errors: about what the worst tenth of random gain sets that drive without re-plans reach
# (docs/results/score_shares.md); the peaks' are Apollo's, except that 0.5236 rad of heading is beyond any drive.
METRICS: dict[str, MetricFormula] = {
    "station_err_std": RmsMetric("station_error_m", "VT", Subset.MOVING),
    "station_err_std_harsh": RmsMetric("station_error_m", "VT", Subset.HARSH_ACCEL),
    "speed_err_std": RmsMetric("speed_error_mps", "V", Subset.MOVING),
    "speed_err_std_harsh": RmsMetric("speed_error_mps", "V", Subset.HARSH_ACCEL),
    "lateral_err_std": RmsMetric("lateral_error_m", "CVLT", Subset.MOVING),
    "lateral_err_std_harsh": RmsMetric("lateral_error_m", "CVLT", Subset.HARSH_CURVATURE),
    "heading_err_std": RmsMetric("heading_error_rad", "CVT", Subset.MOVING),
    "heading_err_std_harsh": RmsMetric("heading_error_rad", "CVT", Subset.HARSH_CURVATURE),
    "heading_err_rate_std": RmsMetric("heading_error_rate_radps", "CV", Subset.MOVING),
    "heading_err_rate_std_harsh": RmsMetric("heading_error_rate_radps", "CV", Subset.HARSH_CURVATURE),
    "station_err_peak": PeakMetric("station_error_m", 1.0),
    "speed_err_peak": PeakMetric("speed_error_mps", 0.5),
    "lateral_err_peak": PeakMetric("lateral_error_m", 0.5),
    "heading_err_peak": PeakMetric("heading_error_rad", 0.5236),
    "heading_err_rate_peak": PeakMetric("heading_error_rate_radps", 0.5236),
    "steer_rate_rms": SeriesMetric(steer_rate, ("cmd_steer_rad",)),
    "lateral_jerk_rms": SeriesMetric(lateral_jerk, ("speed_mps", "yaw_rate_radps")),
    "steering_control_usage": SeriesMetric(steering_usage, ("cmd_steer_rad",)),
    "lateral_rms_after_start": LaterRmsMetric("lateral_error_m", 0.1),
    "station_rms_after_start": LaterRmsMetric("station_error_m", 0.5),
    "speed_rms_after_start": LaterRmsMetric("speed_error_mps", 0.15),
    "heading_rms_after_start": LaterRmsMetric("heading_error_rad", 0.03),
    "start_overshoot": StartMetric(start_overshoot),
    "start_settling": StartMetric(start_settling),
    "lateral_peak_after_start": PeakMetric("lateral_error_m", 0.5, after_start=True),
    "station_peak_after_start": PeakMetric("station_error_m", 1.0, after_start=True),
    "speed_peak_after_start": PeakMetric("speed_error_mps", 0.5, after_start=True),
    "heading_peak_after_start": PeakMetric("heading_error_rad", 0.1, after_start=True),
    "longitudinal_jerk_rms": SeriesMetric(longitudinal_jerk, ("accel_mps2",)),
    "pedal_rate_rms": SeriesMetric(pedal_rate, ("cmd_throttle_frac", "cmd_brake_frac")),
}

# Apollo's code divides the heading error itself, not its rate, by C V
AS_PUBLISHED: dict[str, MetricFormula] = {
    "heading_err_rate_std_harsh": RmsMetric("heading_error_rad", "CV", Subset.HARSH_CURVATURE)
}


class MetricEvaluator:
    """Computes the metrics of one drive; masks and divisors that several metrics share are computed once."""

    def __init__(self, samples: MetricSamples, scales: MetricScales) -> None:
        self.samples = samples
        self.scales = scales
        self.start_ticks = start_ticks(scales.dt_s)
        self._masks: dict[Subset, Array | None] = {}
        self._divisors: dict[str, Array | None] = {}
        self._subset_divisors: dict[tuple[str, Subset], Array] = {}

    def series(self, formula: MetricFormula) -> Array | None:
        """Series whose RMS or peak is the metric, one value a counting sample; None where a column is missing.

        A PeakMetric's series is not yet divided by its threshold. Non-finite samples are still included, except in a
        StartMetric's, which is the lateral error during the start.
        """
        if isinstance(formula, SeriesMetric):
            return formula.series(self.samples, self.scales)
        if isinstance(formula, StartMetric):
            return self._start_error()
        error = getattr(self.samples, formula.error)
        if error is None:
            return None
        if isinstance(formula, PeakMetric):
            return error[self.start_ticks :] if formula.after_start else error
        if isinstance(formula, LaterRmsMetric):
            return error[self.start_ticks :] / formula.scale
        mask = self.subset_mask(formula.subset)
        if formula.divisors not in self._divisors:
            self._divisors[formula.divisors] = _divisor(formula.divisors, self.samples, self.scales)
        divisor = self._divisors[formula.divisors]
        if mask is None or divisor is None:
            return None
        key = (formula.divisors, formula.subset)
        if key not in self._subset_divisors:
            self._subset_divisors[key] = divisor[mask]
        return error[mask] / self._subset_divisors[key]

    def subset_mask(self, subset: Subset) -> Array | None:
        """Mask of the samples that count, shape (n_ticks,); None where a column is missing."""
        if subset not in self._masks:
            self._masks[subset] = _subset_mask(subset, self.samples)
        return self._masks[subset]

    def value(self, formula: MetricFormula) -> float | None:
        """Value of a metric; None where it is not available."""
        series = self.series(formula)
        if series is None:
            return None
        if isinstance(formula, StartMetric):
            return formula.value(series, self.scales.dt_s) if len(series) else None
        return peak(series, formula.threshold) if isinstance(formula, PeakMetric) else rms(series)

    def _start_error(self) -> Array | None:
        """Finite lateral errors during the start; empty where it is cut short or begins without an offset."""
        lateral = self.samples.lateral_error_m
        if lateral is None:
            return None
        start = lateral[: self.start_ticks]
        known = start[np.isfinite(start)]
        is_start = len(start) == self.start_ticks and len(known) > 0 and abs(known[0]) >= START.min_offset_m
        return known if is_start else known[:0]


def metric_formula(name: str, *, as_published: bool = False) -> MetricFormula:
    """Formula of a metric; as_published: with Apollo's error. Raises KeyError for an unknown name."""
    return AS_PUBLISHED.get(name, METRICS[name]) if as_published else METRICS[name]


def compute_metric(
    name: str, samples: MetricSamples, scales: MetricScales, *, as_published: bool = False
) -> float | None:
    """One metric by its name in METRICS. Raises KeyError for an unknown name."""
    return MetricEvaluator(samples, scales).value(metric_formula(name, as_published=as_published))


def is_planned(name: str, plan: MetricSamples) -> bool:
    """Whether the plan has the 5 samples that a metric of METRICS needs. plan: from samples_from_plan."""
    return is_formula_planned(METRICS[name], plan)


def is_formula_planned(formula: MetricFormula, plan: MetricSamples) -> bool:
    """As is_planned, for a formula."""
    mask = _subset_mask(formula.subset, plan) if isinstance(formula, RmsMetric) else None
    return mask is None or int(np.count_nonzero(mask)) >= MIN_SAMPLES


def samples_from_plan(course: Course) -> MetricSamples:
    """The planned references of a course, one row a tick; without errors."""
    references = dict.fromkeys(MetricSamples._fields)
    references |= {
        "ref_speed_mps": np.asarray(course.speed_mps),
        "ref_accel_mps2": np.asarray(course.accel_mps2),
        "ref_curvature_1pm": curvature_by_time(course),
    }
    return MetricSamples(**references)


def rms(values: Array) -> float | None:
    """sqrt(sum s^2 / (N - 1)) over the finite values; None for fewer than 5."""
    values = values[np.isfinite(values)]
    if len(values) < MIN_SAMPLES:
        return None
    return math.sqrt(float(values @ values) / (len(values) - 1))


def peak(error: Array, threshold: float) -> float | None:
    """max |error| / threshold over the finite values; None for fewer than 5."""
    error = error[np.isfinite(error)]
    if len(error) < MIN_SAMPLES:
        return None
    return float(np.abs(error).max()) / threshold


def _subset_mask(subset: Subset, samples: MetricSamples) -> Array | None:
    """Samples with v_ref >= 0.03, |a_ref| >= 1 or |kappa_ref| >= 0.05; None where the column is missing."""
    if subset is Subset.MOVING:
        return None if samples.ref_speed_mps is None else samples.ref_speed_mps >= STOP_MPS
    if subset is Subset.HARSH_ACCEL:
        return None if samples.ref_accel_mps2 is None else np.abs(samples.ref_accel_mps2) >= HARSH_ACCEL_MPS2
    return None if samples.ref_curvature_1pm is None else np.abs(samples.ref_curvature_1pm) >= HARSH_CURVATURE_1PM


def _divisor(divisors: str, samples: MetricSamples, scales: MetricScales) -> Array | None:
    """Product of the letters for every sample; None where a column is missing."""
    if samples.ref_speed_mps is None:
        return None
    product = np.maximum(np.abs(samples.ref_speed_mps), MIN_SPEED_MPS)  # every row of the table has a V
    if "C" in divisors:
        if samples.ref_curvature_1pm is None:
            return None
        product = product * np.maximum(np.abs(samples.ref_curvature_1pm), MIN_CURVATURE_1PM)
    if "L" in divisors:
        product = product * scales.wheelbase_m
    return product * HORIZON_S if "T" in divisors else product
