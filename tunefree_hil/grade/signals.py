"""Per-sample formulas of the metrics that no score weighs: stops, comfort, effort, dead band, latency, localisation.

Thresholds of Apollo's control profiling (docs/reference/grading.md). A formula uses the signals listed in its row of
table.py and returns one value a counting sample; the caller drops non-finite values. Deliberate differences from
Apollo: derivatives between means over 0.1 s (at 100 Hz they would be sensor noise), lateral acceleration v * yaw rate
instead of a_lon sin(heading error), heading acceleration of the vehicle, course over ground from 0.1 s and at least
0.1 m.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from tunefree_hil.grade.metrics import (
    HARSH_ACCEL_MPS2,
    HARSH_CURVATURE_1PM,
    STOP_MPS,
    MetricScales,
    window_means,
    window_ticks,
)

Array = np.ndarray

# Apollo's control profiling
NEAR_END_M = 1.0
STANDSTILL_GAP_S = 1.0
# this project
ACTIVE_ABOVE_REST = 0.005  # duty above rest from which a pedal is active; above the rounding of a CAN signal
COURSE_WINDOW_S = 0.1
COURSE_MIN_M = 0.1


class FormulaContext(NamedTuple):
    """Constants of a formula. stops_m: stations at which the plan stands still, ascending."""

    scales: MetricScales
    rest_pedal_frac: float
    stops_m: Array


Signals = Mapping[str, Array]
Formula = Callable[[Signals, FormulaContext], Array]


def ending_error(error: str, threshold: float) -> Formula:
    """|error| / threshold at the start of each standstill near a planned stop."""

    def formula(signals: Signals, context: FormulaContext) -> Array:
        rows = standstills(signals["speed_mps"], context.scales.dt_s)
        rows = rows[is_near_stop(signals["station_m"][rows], context.stops_m)]
        return np.abs(signals[error][rows]) / threshold

    return formula


def standstills(speed_mps: Array, dt_s: float) -> Array:
    """First rows of the periods slower than 0.03 m/s; periods less than 1 s apart are merged.

    A standstill at the start of the recording does not count.
    """
    rows = np.flatnonzero(np.abs(speed_mps) < STOP_MPS)
    if len(rows) == 0:
        return rows
    apart = np.concatenate([[True], np.diff(rows) * dt_s > STANDSTILL_GAP_S])
    first = np.flatnonzero(np.isfinite(speed_mps))[0]
    return rows[apart & (rows > first)]


def is_near_stop(station_m: Array, stops_m: Array) -> Array:
    """Whether each station is less than 1 m before the nearest planned stop, or beyond it."""
    if len(stops_m) == 0:
        return np.zeros(len(station_m), dtype=bool)
    nearest_m = stops_m[np.abs(stops_m[None, :] - station_m[:, None]).argmin(axis=1)]
    return nearest_m - station_m < NEAR_END_M


def acceleration(signals: Signals, context: FormulaContext) -> Array:
    """|longitudinal acceleration|, m/s^2."""
    return np.abs(signals["accel_mps2"])


def jerk(signals: Signals, context: FormulaContext) -> Array:
    """|d/dt longitudinal acceleration|, m/s^3."""
    return np.abs(derivative(signals["accel_mps2"], context))


def lateral_acceleration(signals: Signals, context: FormulaContext) -> Array:
    """|v * yaw rate|, m/s^2."""
    return np.abs(signals["speed_mps"] * signals["yaw_rate_radps"])


def lateral_jerk(signals: Signals, context: FormulaContext) -> Array:
    """|d/dt (v * yaw rate)|, m/s^3."""
    return np.abs(derivative(signals["speed_mps"] * signals["yaw_rate_radps"], context))


def heading_acceleration(signals: Signals, context: FormulaContext) -> Array:
    """|d/dt yaw rate|, rad/s^2."""
    return np.abs(derivative(signals["yaw_rate_radps"], context))


def heading_jerk(signals: Signals, context: FormulaContext) -> Array:
    """|d2/dt2 yaw rate|, rad/s^3."""
    window_s = window_ticks(context.scales.dt_s) * context.scales.dt_s
    return np.abs(np.diff(derivative(signals["yaw_rate_radps"], context))) / window_s


def derivative(values: Array, context: FormulaContext) -> Array:
    """d/dt between means over 0.1 s."""
    ticks = window_ticks(context.scales.dt_s)
    return np.diff(window_means(values, ticks)) / (ticks * context.scales.dt_s)


def usage(command: str) -> Formula:
    """A pedal command as duty, including its rest value (as Apollo's percentages)."""
    return lambda signals, context: signals[command]


def harsh_usage(command: str) -> Formula:
    """The same where |a_ref| >= 1 m/s^2."""
    return lambda signals, context: signals[command][np.abs(signals["ref_accel_mps2"]) >= HARSH_ACCEL_MPS2]


def harsh_steering(signals: Signals, context: FormulaContext) -> Array:
    """Steering command / limit where |kappa_ref| >= 0.05 1/m."""
    harsh = np.abs(signals["ref_curvature_1pm"]) >= HARSH_CURVATURE_1PM
    return signals["cmd_steer_rad"][harsh] / context.scales.steer_rad


def reported_while_other_pedal(report: str, other_command: str) -> Formula:
    """Reported duty of a pedal while the other pedal is commanded above its rest."""

    def formula(signals: Signals, context: FormulaContext) -> Array:
        active = signals[other_command] > context.rest_pedal_frac + ACTIVE_ABOVE_REST
        return signals[report][active]

    return formula


def time_usage(signals: Signals, context: FormulaContext) -> Array:
    """Compute time of a control cycle / its period."""
    return signals["control_time_s"] / context.scales.dt_s


def overrun(signals: Signals, context: FormulaContext) -> Array:
    """1 where the compute time of a cycle exceeded its period."""
    return (signals["control_time_s"] > context.scales.dt_s).astype(float)


def plain_signal(name: str) -> Formula:
    """A signal as it is; a flag is 1 where it is set."""
    return lambda signals, context: signals[name]


def pose_heading_offset(signals: Signals, context: FormulaContext) -> Array:
    """(course over ground - heading) / pi while moving: course from positions 0.1 s apart, heading between them."""
    ticks = max(2, 2 * round(0.5 * COURSE_WINDOW_S / context.scales.dt_s))
    if len(signals["x_m"]) <= ticks:
        return np.empty(0)
    moved_x = signals["x_m"][ticks:] - signals["x_m"][:-ticks]
    moved_y = signals["y_m"][ticks:] - signals["y_m"][:-ticks]
    heading = signals["heading_rad"][ticks // 2 : -(ticks // 2)]
    offset = np.arctan2(moved_y, moved_x) - heading
    offset = offset - 2.0 * math.pi * np.ceil((offset - math.pi) / (2.0 * math.pi))
    return offset[moved_x * moved_x + moved_y * moved_y >= COURSE_MIN_M**2] / math.pi
