"""All 42 metrics of the source (apollo_facts 6.1), by aspect, and two of ours: one row each, formula and source in it.

Two ways of summing up a series s of N samples: how the value is made, and how values of several drives become one:
  std    sqrt(sum s^2 / (N - 1))     pooled: sqrt((x^2 (nx - 1) + y^2 (ny - 1)) / (nx + ny - 1))
  peak   max |s|                     the largest
  share  mean of a yes or no         mean weighted by N
  mean   mean of s                   mean weighted by N
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from tunefree_hil.grade import signals
from tunefree_hil.grade.metrics import LEAST_SAMPLES, METRICS, Own, Peak, Rms

How = Literal["std", "peak", "share", "mean"]
PERFORMANCE, SAFETY, COMFORT, EFFORT = "performance", "safety", "comfort", "effort"
DEAD_BAND, LATENCY, LOCALISATION = "dead band", "latency", "localisation"
ASPECTS = (PERFORMANCE, SAFETY, COMFORT, EFFORT, DEAD_BAND, LATENCY, LOCALISATION)


class Metric(NamedTuple):
    """One row. words: the formula for people. formula: None where the row is one of grade/metrics.py.

    limit: of a share, what |s| must reach. least: samples below which there is no value. ours: not of the source's 42.
    """

    aspect: str
    how: How
    words: str
    needs: tuple[str, ...]
    formula: signals.Formula | None = None
    limit: float = 0.0
    least: int = LEAST_SAMPLES
    ours: bool = False


NEEDED_FOR = {"moving": "ref_speed_mps", "harsh accel": "ref_accel_mps2", "harsh curvature": "ref_curvature_1pm"}
_OVER = {"V": "V", "C": "C", "L": "L", "T": "1 s"}
_WHERE = {"moving": "v_ref >= 0.03", "harsh accel": "|a_ref| >= 1", "harsh curvature": "|kappa_ref| >= 0.05"}

# what the source profiles and does not weigh, in the same form as the rows of METRICS
RATES: dict[str, Rms | Peak] = {
    "lateral_err_rate_std": Rms("lateral_error_rate_mps", "CVL", "moving"),
    "lateral_err_rate_std_harsh": Rms("lateral_error_rate_mps", "CVL", "harsh curvature"),
    "lateral_err_rate_peak": Peak("lateral_error_rate_mps", 0.5),
}
ROWS: dict[str, Rms | Peak | Own] = {**METRICS, **RATES}


def _error(name: str) -> Metric:
    """The row of an error metric, read off its row in ROWS."""
    row = ROWS[name]
    if isinstance(row, Rms):
        over = " ".join(_OVER[letter] for letter in row.by)
        needs = [row.error, "ref_speed_mps", NEEDED_FOR[row.where]] + (["ref_curvature_1pm"] if "C" in row.by else [])
        return Metric(PERFORMANCE, "std", f"{row.error} / ({over}), {_WHERE[row.where]}", tuple(dict.fromkeys(needs)))
    assert isinstance(row, Peak)
    return Metric(PERFORMANCE, "peak", f"|{row.error}| / {row.threshold:g}", (row.error,))


def _own(name: str, aspect: str, words: str, *, ours: bool) -> Metric:
    row = ROWS[name]
    assert isinstance(row, Own)
    return Metric(aspect, "std", words, row.needs, ours=ours)


def _ending(error: str, threshold: float) -> Metric:
    words = f"|{error}| / {threshold:g} when it comes to stand, less than 1 m before a planned stop"
    return Metric(SAFETY, "peak", words, (error, "speed_mps", "station_m"), signals.ending(error, threshold), least=1)


def _felt(formula: signals.Formula, limit: float, words: str, *needs: str) -> Metric:
    return Metric(COMFORT, "share", f"share of |{words}| >= {limit:g}", needs, formula, limit)


def _pedal(command: str, *, harsh: bool) -> Metric:
    if harsh:
        return Metric(
            EFFORT, "std", f"{command}, |a_ref| >= 1", (command, "ref_accel_mps2"), signals.harsh_usage(command)
        )
    return Metric(EFFORT, "std", f"{command} (duty)", (command,), signals.usage(command))


_GROUPS = ("station_err", "speed_err", "lateral_err", "lateral_err_rate", "heading_err", "heading_err_rate")
_TURNED = "v yaw_rate"

TABLE: dict[str, Metric] = {
    **{f"{group}_{kind}": _error(f"{group}_{kind}") for kind in ("std", "std_harsh", "peak") for group in _GROUPS},
    "ending_station_err": _ending("station_error_m", 1.0),
    "ending_lateral_err": _ending("lateral_error_m", 0.5),
    "ending_heading_err": _ending("heading_error_rad", 0.5236),
    "replan_trajectory_count": Metric(
        SAFETY, "share", "share of ticks with a re-plan", ("replan",), signals.flagged("replan"), 0.5
    ),
    "control_error_code_count": Metric(
        SAFETY,
        "share",
        "share of ticks with a control error (code >= 1000, or no command computed)",
        ("control_error",),
        signals.flagged("control_error"),
        0.5,
    ),
    "acc_bad_sensation": _felt(signals.acceleration, 4.0, "accel_mps2", "accel_mps2"),
    "jerk_bad_sensation": _felt(signals.jerk, 2.0, "d/dt accel_mps2", "accel_mps2"),
    "lateral_acc_bad_sensation": _felt(signals.lateral_acceleration, 4.0, _TURNED, "speed_mps", "yaw_rate_radps"),
    "lateral_jerk_bad_sensation": _felt(signals.lateral_jerk, 2.0, f"d/dt ({_TURNED})", "speed_mps", "yaw_rate_radps"),
    "heading_acc_bad_sensation": _felt(signals.heading_acceleration, 3.1416, "d/dt yaw_rate", "yaw_rate_radps"),
    "heading_jerk_bad_sensation": _felt(signals.heading_jerk, 1.5708, "d2/dt2 yaw_rate", "yaw_rate_radps"),
    "throttle_control_usage": _pedal("cmd_throttle_frac", harsh=False),
    "throttle_control_usage_harsh": _pedal("cmd_throttle_frac", harsh=True),
    "brake_control_usage": _pedal("cmd_brake_frac", harsh=False),
    "brake_control_usage_harsh": _pedal("cmd_brake_frac", harsh=True),
    "steering_control_usage": _own("steering_control_usage", EFFORT, "cmd_steer_rad / limit", ours=False),
    "steering_control_usage_harsh": Metric(
        EFFORT,
        "std",
        "cmd_steer_rad / limit, |kappa_ref| >= 0.05",
        ("cmd_steer_rad", "ref_curvature_1pm"),
        signals.harsh_steering,
    ),
    "throttle_deadzone_mean": Metric(
        DEAD_BAND,
        "mean",
        "out_throttle_frac while braking",
        ("out_throttle_frac", "cmd_brake_frac"),
        signals.idle("out_throttle_frac", "cmd_brake_frac"),
    ),
    "brake_deadzone_mean": Metric(
        DEAD_BAND,
        "mean",
        "out_brake_frac while on throttle",
        ("out_brake_frac", "cmd_throttle_frac"),
        signals.idle("out_brake_frac", "cmd_throttle_frac"),
    ),
    "total_time_usage": Metric(LATENCY, "std", "control time / period", ("control_time_s",), signals.time_usage),
    "total_time_peak": Metric(LATENCY, "peak", "control time / period", ("control_time_s",), signals.time_usage),
    "total_time_exceeded_count": Metric(
        LATENCY, "share", "share of cycles over their period", ("control_time_s",), signals.overrun, 0.5
    ),
    "pose_heading_offset_std": Metric(
        LOCALISATION,
        "std",
        "(course over ground - heading) / pi, moving",
        ("x_m", "y_m", "heading_rad"),
        signals.pose_heading_offset,
    ),
    "pose_heading_offset_peak": Metric(
        LOCALISATION,
        "peak",
        "(course over ground - heading) / pi, moving",
        ("x_m", "y_m", "heading_rad"),
        signals.pose_heading_offset,
    ),
    "lateral_jerk_rms": _own("lateral_jerk_rms", COMFORT, f"d/dt ({_TURNED}) / 2 m/s3", ours=True),
    "steer_rate_rms": _own("steer_rate_rms", EFFORT, "d/dt cmd_steer_rad / limit of the rate", ours=True),
}

PUBLISHED = tuple(name for name, row in TABLE.items() if not row.ours)  # the 42

# 6.1: highlighted in reports
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


def by_aspect() -> dict[str, list[str]]:
    """Names of all rows, by aspect, the source's before ours."""
    return {aspect: [name for name, row in TABLE.items() if row.aspect == aspect] for aspect in ASPECTS}
