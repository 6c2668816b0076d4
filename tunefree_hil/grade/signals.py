"""Per-sample formulas of the metrics that no score weighs: endings, comfort, effort, dead band, latency, localisation.

Notation and thresholds of apollo_facts 6.1. A formula takes the signals that its row in table.py names as needed and
gives one value a sample that counts; what is not finite is left out by the caller. Different from the source on
purpose: derivatives are taken between means over 0.1 s (at 100 Hz they would be a sensor's noise), lateral acceleration
is v * yaw rate (the source's is a_lon sin(heading error)), heading acceleration is that of the vehicle, and a course is
taken over 0.1 s of at least 0.1 m.
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
    Scales,
    window_means,
    window_ticks,
)

Array = np.ndarray

# apollo_facts 6.1
NEAR_END_M = 1.0
SPELL_GAP_S = 1.0
# ours
ACTIVE_ABOVE_REST = 0.005  # of a pedal's duty: rounding on the wire stays below
COURSE_WINDOW_S = 0.1
COURSE_LEAST_M = 0.1


class Context(NamedTuple):
    """What a formula needs beside the signals. stops_m: stations at which the plan stands still, ascending."""

    scales: Scales
    rest_pedal_frac: float
    stops_m: Array


Signals = Mapping[str, Array]
Formula = Callable[[Signals, Context], Array]


def ending(error: str, threshold: float) -> Formula:
    """|error| / threshold at the start of each standstill near the end of its stretch of the path."""

    def formula(signals: Signals, context: Context) -> Array:
        rows = standstills(signals["speed_mps"], context.scales.dt_s)
        rows = rows[near_end(signals["station_m"][rows], context.stops_m)]
        return np.abs(signals[error][rows]) / threshold

    return formula


def standstills(speed_mps: Array, dt_s: float) -> Array:
    """First rows of the spells slower than 0.03 m/s; spells less than 1 s apart are one.

    A spell that the recording begins with is the end of nothing and does not count.
    """
    rows = np.flatnonzero(np.abs(speed_mps) < STOP_MPS)
    if len(rows) == 0:
        return rows
    apart = np.concatenate([[True], np.diff(rows) * dt_s > SPELL_GAP_S])
    heard = np.flatnonzero(np.isfinite(speed_mps))[0]
    return rows[apart & (rows > heard)]


def near_end(station_m: Array, stops_m: Array) -> Array:
    """Whether less than 1 m remains to the planned stop nearest to each station (beyond it counts as none left)."""
    if len(stops_m) == 0:
        return np.zeros(len(station_m), dtype=bool)
    nearest = stops_m[np.abs(stops_m[None, :] - station_m[:, None]).argmin(axis=1)]
    return nearest - station_m < NEAR_END_M


def acceleration(signals: Signals, context: Context) -> Array:
    """|longitudinal acceleration|, m/s^2."""
    return np.abs(signals["accel_mps2"])


def jerk(signals: Signals, context: Context) -> Array:
    """|d/dt longitudinal acceleration|, m/s^3."""
    return np.abs(derivative(signals["accel_mps2"], context))


def lateral_acceleration(signals: Signals, context: Context) -> Array:
    """|v * yaw rate|, m/s^2."""
    return np.abs(signals["speed_mps"] * signals["yaw_rate_radps"])


def lateral_jerk(signals: Signals, context: Context) -> Array:
    """|d/dt (v * yaw rate)|, m/s^3."""
    return np.abs(derivative(signals["speed_mps"] * signals["yaw_rate_radps"], context))


def heading_acceleration(signals: Signals, context: Context) -> Array:
    """|d/dt yaw rate|, rad/s^2."""
    return np.abs(derivative(signals["yaw_rate_radps"], context))


def heading_jerk(signals: Signals, context: Context) -> Array:
    """|d2/dt2 yaw rate|, rad/s^3."""
    window_s = window_ticks(context.scales.dt_s) * context.scales.dt_s
    return np.abs(np.diff(derivative(signals["yaw_rate_radps"], context))) / window_s


def derivative(values: Array, context: Context) -> Array:
    """d/dt between means over 0.1 s."""
    ticks = window_ticks(context.scales.dt_s)
    return np.diff(window_means(values, ticks)) / (ticks * context.scales.dt_s)


def usage(command: str) -> Formula:
    """A pedal's command as duty (its rest included, as the source's percent are)."""
    return lambda signals, context: signals[command]


def harsh_usage(command: str) -> Formula:
    """The same where |a_ref| >= 1 m/s^2."""
    return lambda signals, context: signals[command][np.abs(signals["ref_accel_mps2"]) >= HARSH_ACCEL_MPS2]


def harsh_steering(signals: Signals, context: Context) -> Array:
    """Steering command / limit where |kappa_ref| >= 0.05 1/m."""
    harsh = np.abs(signals["ref_curvature_1pm"]) >= HARSH_CURVATURE_1PM
    return signals["cmd_steer_rad"][harsh] / context.scales.steer_rad


def idle(report: str, other_command: str) -> Formula:
    """What a pedal's actuator reports (duty) while the other pedal is commanded above its rest."""

    def formula(signals: Signals, context: Context) -> Array:
        active = signals[other_command] > context.rest_pedal_frac + ACTIVE_ABOVE_REST
        return signals[report][active]

    return formula


def time_usage(signals: Signals, context: Context) -> Array:
    """Compute time of a control cycle / its period."""
    return signals["control_time_s"] / context.scales.dt_s


def overrun(signals: Signals, context: Context) -> Array:
    """1 where a cycle computed for longer than its period."""
    return (signals["control_time_s"] > context.scales.dt_s).astype(float)


def flagged(name: str) -> Formula:
    """A flag as it is: 1 where it holds."""
    return lambda signals, context: signals[name]


def pose_heading_offset(signals: Signals, context: Context) -> Array:
    """(course over ground - heading) / pi, moving: the course from positions 0.1 s apart, heading in their middle."""
    ticks = max(2, 2 * round(0.5 * COURSE_WINDOW_S / context.scales.dt_s))
    if len(signals["x_m"]) <= ticks:
        return np.empty(0)
    gone_x = signals["x_m"][ticks:] - signals["x_m"][:-ticks]
    gone_y = signals["y_m"][ticks:] - signals["y_m"][:-ticks]
    heading = signals["heading_rad"][ticks // 2 : -(ticks // 2)]
    offset = np.arctan2(gone_y, gone_x) - heading
    offset = offset - 2.0 * math.pi * np.ceil((offset - math.pi) / (2.0 * math.pi))
    return offset[gone_x * gone_x + gone_y * gone_y >= COURSE_LEAST_M**2] / math.pi
