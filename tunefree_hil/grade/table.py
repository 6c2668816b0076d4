"""Table of all metrics by aspect: the 42 of Apollo's control profiling and twenty of this project.

Aggregation of a series s of N samples to a value, and combination of the values of several drives:
  std    sqrt(sum s^2 / (N - 1))     pooled: sqrt((x^2 (nx - 1) + y^2 (ny - 1)) / (nx + ny - 1))
  peak   max |s|                     the largest
  share  mean of a yes/no value      mean weighted by N
  mean   mean of s                   mean weighted by N
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from tunefree_hil.grade import signals
from tunefree_hil.grade.metrics import (
    METRICS,
    MIN_SAMPLES,
    START,
    LaterRmsMetric,
    MetricFormula,
    PeakMetric,
    RmsMetric,
    SeriesMetric,
    StartMetric,
    Subset,
)

Aggregation = Literal["std", "peak", "share", "mean"]
PERFORMANCE, SAFETY, COMFORT, EFFORT = "performance", "safety", "comfort", "effort"
DEAD_BAND, LATENCY, LOCALISATION = "dead band", "latency", "localisation"
ASPECTS = (PERFORMANCE, SAFETY, COMFORT, EFFORT, DEAD_BAND, LATENCY, LOCALISATION)


class MetricRow(NamedTuple):
    """A metric. description: its formula as text. formula: None where it is one of FORMULAS.

    limit: of a share, the threshold of |s|. min_samples: no value with fewer. ours: not one of Apollo's 42.
    """

    aspect: str
    aggregation: Aggregation
    description: str
    needs: tuple[str, ...]
    formula: signals.Formula | None = None
    limit: float = 0.0
    min_samples: int = MIN_SAMPLES
    ours: bool = False


SUBSET_COLUMN = {
    Subset.MOVING: "ref_speed_mps",
    Subset.HARSH_ACCEL: "ref_accel_mps2",
    Subset.HARSH_CURVATURE: "ref_curvature_1pm",
}
_DIVISOR_TEXT = {"V": "V", "C": "C", "L": "L", "T": "1 s"}
_SUBSET_TEXT = {
    Subset.MOVING: "v_ref >= 0.03",
    Subset.HARSH_ACCEL: "|a_ref| >= 1",
    Subset.HARSH_CURVATURE: "|kappa_ref| >= 0.05",
}

# metrics that Apollo reports and does not weigh, in the form of METRICS
RATE_FORMULAS: dict[str, RmsMetric | PeakMetric] = {
    "lateral_err_rate_std": RmsMetric("lateral_error_rate_mps", "CVL", Subset.MOVING),
    "lateral_err_rate_std_harsh": RmsMetric("lateral_error_rate_mps", "CVL", Subset.HARSH_CURVATURE),
    "lateral_err_rate_peak": PeakMetric("lateral_error_rate_mps", 0.5),
}
FORMULAS: dict[str, MetricFormula] = {**METRICS, **RATE_FORMULAS}


def _error_row(name: str) -> MetricRow:
    """Row of an error metric, from its formula."""
    row = FORMULAS[name]
    if isinstance(row, RmsMetric):
        over = " ".join(_DIVISOR_TEXT[letter] for letter in row.divisors)
        needs = [row.error, "ref_speed_mps", SUBSET_COLUMN[row.subset]] + (
            ["ref_curvature_1pm"] if "C" in row.divisors else []
        )
        return MetricRow(
            PERFORMANCE, "std", f"{row.error} / ({over}), {_SUBSET_TEXT[row.subset]}", tuple(dict.fromkeys(needs))
        )
    assert isinstance(row, PeakMetric)
    return MetricRow(PERFORMANCE, "peak", f"|{row.error}| / {row.threshold:g}", (row.error,))


def _series_row(name: str, aspect: str, description: str, *, ours: bool) -> MetricRow:
    row = FORMULAS[name]
    assert isinstance(row, SeriesMetric)
    return MetricRow(aspect, "std", description, row.needs, ours=ours)


def _later_row(name: str, aspect: str) -> MetricRow:
    """Row of a metric of the errors after the start, from its formula."""
    formula, after = FORMULAS[name], f", t >= {START.duration_s:g} s"
    if isinstance(formula, LaterRmsMetric):
        return MetricRow(aspect, "std", f"{formula.error} / {formula.scale:g}{after}", (formula.error,), ours=True)
    assert isinstance(formula, PeakMetric) and formula.after_start
    return MetricRow(aspect, "peak", f"|{formula.error}| / {formula.threshold:g}{after}", (formula.error,), ours=True)


def _start_row(name: str, description: str) -> MetricRow:
    assert isinstance(FORMULAS[name], StartMetric)
    return MetricRow(PERFORMANCE, "peak", description, ("lateral_error_m",), ours=True)


def _ending_row(error: str, threshold: float) -> MetricRow:
    description = f"|{error}| / {threshold:g} at standstill, less than 1 m before a planned stop"
    return MetricRow(
        SAFETY,
        "peak",
        description,
        (error, "speed_mps", "station_m"),
        signals.ending_error(error, threshold),
        min_samples=1,
    )


def _sensation_row(formula: signals.Formula, limit: float, signal_text: str, *needs: str) -> MetricRow:
    return MetricRow(COMFORT, "share", f"share of |{signal_text}| >= {limit:g}", needs, formula, limit)


def _pedal_row(command: str, *, harsh: bool) -> MetricRow:
    if harsh:
        return MetricRow(
            EFFORT, "std", f"{command}, |a_ref| >= 1", (command, "ref_accel_mps2"), signals.harsh_usage(command)
        )
    return MetricRow(EFFORT, "std", f"{command} (duty)", (command,), signals.usage(command))


def _oscillation_row(name: str, aspect: str, signal_text: str) -> MetricRow:
    """Row of grade/oscillation.py; its signal is one number a drive."""
    return MetricRow(aspect, "peak", signal_text, (name,), signals.plain_signal(name), min_samples=1, ours=True)


_GROUPS = ("station_err", "speed_err", "lateral_err", "lateral_err_rate", "heading_err", "heading_err_rate")
_ERRORS = ("lateral", "station", "speed", "heading")
_LATERAL_ACCEL = "v yaw_rate"

TABLE: dict[str, MetricRow] = {
    **{f"{group}_{kind}": _error_row(f"{group}_{kind}") for kind in ("std", "std_harsh", "peak") for group in _GROUPS},
    "ending_station_err": _ending_row("station_error_m", 1.0),
    "ending_lateral_err": _ending_row("lateral_error_m", 0.5),
    "ending_heading_err": _ending_row("heading_error_rad", 0.5236),
    "replan_trajectory_count": MetricRow(
        SAFETY, "share", "share of ticks with a re-plan", ("replan",), signals.plain_signal("replan"), 0.5
    ),
    "control_error_code_count": MetricRow(
        SAFETY,
        "share",
        "share of ticks with a control error (code >= 1000, or no command computed)",
        ("control_error",),
        signals.plain_signal("control_error"),
        0.5,
    ),
    "acc_bad_sensation": _sensation_row(signals.acceleration, 4.0, "accel_mps2", "accel_mps2"),
    "jerk_bad_sensation": _sensation_row(signals.jerk, 2.0, "d/dt accel_mps2", "accel_mps2"),
    "lateral_acc_bad_sensation": _sensation_row(
        signals.lateral_acceleration, 4.0, _LATERAL_ACCEL, "speed_mps", "yaw_rate_radps"
    ),
    "lateral_jerk_bad_sensation": _sensation_row(
        signals.lateral_jerk, 2.0, f"d/dt ({_LATERAL_ACCEL})", "speed_mps", "yaw_rate_radps"
    ),
    "heading_acc_bad_sensation": _sensation_row(
        signals.heading_acceleration, 3.1416, "d/dt yaw_rate", "yaw_rate_radps"
    ),
    "heading_jerk_bad_sensation": _sensation_row(signals.heading_jerk, 1.5708, "d2/dt2 yaw_rate", "yaw_rate_radps"),
    "throttle_control_usage": _pedal_row("cmd_throttle_frac", harsh=False),
    "throttle_control_usage_harsh": _pedal_row("cmd_throttle_frac", harsh=True),
    "brake_control_usage": _pedal_row("cmd_brake_frac", harsh=False),
    "brake_control_usage_harsh": _pedal_row("cmd_brake_frac", harsh=True),
    "steering_control_usage": _series_row("steering_control_usage", EFFORT, "cmd_steer_rad / limit", ours=False),
    "steering_control_usage_harsh": MetricRow(
        EFFORT,
        "std",
        "cmd_steer_rad / limit, |kappa_ref| >= 0.05",
        ("cmd_steer_rad", "ref_curvature_1pm"),
        signals.harsh_steering,
    ),
    "throttle_deadzone_mean": MetricRow(
        DEAD_BAND,
        "mean",
        "out_throttle_frac while braking",
        ("out_throttle_frac", "cmd_brake_frac"),
        signals.reported_while_other_pedal("out_throttle_frac", "cmd_brake_frac"),
    ),
    "brake_deadzone_mean": MetricRow(
        DEAD_BAND,
        "mean",
        "out_brake_frac while on throttle",
        ("out_brake_frac", "cmd_throttle_frac"),
        signals.reported_while_other_pedal("out_brake_frac", "cmd_throttle_frac"),
    ),
    "total_time_usage": MetricRow(LATENCY, "std", "control time / period", ("control_time_s",), signals.time_usage),
    "total_time_peak": MetricRow(LATENCY, "peak", "control time / period", ("control_time_s",), signals.time_usage),
    "total_time_exceeded_count": MetricRow(
        LATENCY, "share", "share of cycles over their period", ("control_time_s",), signals.overrun, 0.5
    ),
    "pose_heading_offset_std": MetricRow(
        LOCALISATION,
        "std",
        "(course over ground - heading) / pi, moving",
        ("x_m", "y_m", "heading_rad"),
        signals.pose_heading_offset,
    ),
    "pose_heading_offset_peak": MetricRow(
        LOCALISATION,
        "peak",
        "(course over ground - heading) / pi, moving",
        ("x_m", "y_m", "heading_rad"),
        signals.pose_heading_offset,
    ),
    "lateral_jerk_rms": _series_row("lateral_jerk_rms", COMFORT, f"d/dt ({_LATERAL_ACCEL}) / 2 m/s3", ours=True),
    "steer_rate_rms": _series_row("steer_rate_rms", EFFORT, "d/dt cmd_steer_rad / limit of the rate", ours=True),
    **{f"{error}_rms_after_start": _later_row(f"{error}_rms_after_start", PERFORMANCE) for error in _ERRORS},
    "start_overshoot": _start_row("start_overshoot", "lateral error beyond the road / initial offset"),
    "start_settling": _start_row("start_settling", f"time until within {START.settled_m:g} m / {START.duration_s:g} s"),
    **{f"{error}_peak_after_start": _later_row(f"{error}_peak_after_start", SAFETY) for error in _ERRORS},
    "longitudinal_jerk_rms": _series_row("longitudinal_jerk_rms", COMFORT, "d/dt accel_mps2 / 2 m/s3", ours=True),
    "pedal_rate_rms": _series_row("pedal_rate_rms", EFFORT, "d/dt (throttle - brake) / 0.5 duty/s", ours=True),
    "oscillation_steer": _oscillation_row("oscillation_steer", COMFORT, "sustained swing of the wheel / limit"),
    "oscillation_accel": _oscillation_row("oscillation_accel", COMFORT, "sustained swing of accel_mps2 / limit"),
    "oscillation_speed": _oscillation_row("oscillation_speed", COMFORT, "sustained swing of speed_mps / limit"),
    "oscillation_throttle": _oscillation_row("oscillation_throttle", EFFORT, "sustained swing of throttle / limit"),
    "oscillation_brake": _oscillation_row("oscillation_brake", EFFORT, "sustained swing of brake / limit"),
    "pedal_alternation": _oscillation_row("pedal_alternation", EFFORT, "throttle/brake switches a second / limit"),
}

PUBLISHED = tuple(name for name, row in TABLE.items() if not row.ours)  # the 42

# highlighted in Apollo's reports
HIGHLIGHTED = (
    "station_err_std",
    "speed_err_std",
    "lateral_err_std",
    "heading_err_std",
    "station_err_peak",
    "speed_err_peak",
    "lateral_err_peak",
    "heading_err_peak",
    "total_time_peak",
)


def names_by_aspect() -> dict[str, list[str]]:
    """Names of all rows by aspect, Apollo's first."""
    return {aspect: [name for name, row in TABLE.items() if row.aspect == aspect] for aspect in ASPECTS}
