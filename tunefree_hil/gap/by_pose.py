"""Speed and yaw rate of an INS that says places and heading and no rates: their slopes over a few values.

A motion capture, or a receiver with two antennae, says where a car is and which way it heads. What that comes to in
speed along the car and in yaw rate is the only second opinion that such a recording has on wheels and gyro.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tunefree_hil.learn.runs import every_of
from tunefree_hil.learn.smooth import between_fresh, rate_of

Array = np.ndarray

X, Y, HEADING, SPEED, YAW_RATE = (
    "ins.x_m", "ins.y_m", "ins.heading_rad", "ins.speed_mps", "ins.yaw_rate_radps"
)  # fmt: skip
MADE_FROM = {YAW_RATE: (HEADING,), SPEED: (HEADING, X, Y)}
VALUES = 5  # under a slope: over more, what a quick car does would be taken off
SLOWEST_S = 0.06  # between two values: a slope over more than a quarter of a second is no rate
LEAST_VALUES = 20
USUAL, JUMP = 0.99, 5.0  # a step so many times as long as 99 of 100 others is no motion


def rates_by_pose(fields: Mapping[str, Array], fresh: Mapping[str, Array], dt_s: float) -> dict[str, Array]:
    """The rates [m/s, rad/s] that an INS does not say and its pose tells, on every tick; fresh where HEADING is.

    Empty where it says them itself, where values come too seldom for slopes, and where the pose jumps (a camera that
    lost the car, a correction): of such a pose no slope is sure. Speed is that along the heading, of the point whose
    places they are. NaN before the first pose.
    """
    found: dict[str, Array] = {}
    jump = jumps_of(fields, fresh, dt_s)
    if not _often(fresh, (HEADING,), dt_s) or HEADING in jump:
        return found
    heading = _unwrapped(fields[HEADING], fresh[HEADING])
    if YAW_RATE not in fields:
        found[YAW_RATE] = _slope(heading, fresh[HEADING], dt_s)
    if SPEED not in fields and _often(fresh, (X, Y), dt_s) and not jump:
        even = between_fresh(heading, fresh[HEADING])
        east, north = (_slope(fields[name], fresh[name], dt_s) for name in (X, Y))
        found[SPEED] = east * np.cos(even) + north * np.sin(even)
    return found


def jumps_of(fields: Mapping[str, Array], fresh: Mapping[str, Array], dt_s: float) -> tuple[str, ...]:
    """The fields of a pose that jump, of those whose slopes would be taken."""
    if not _often(fresh, (HEADING,), dt_s):
        return ()
    asked = ((HEADING,) if YAW_RATE not in fields else ()) + ((HEADING, X, Y) if SPEED not in fields else ())
    return tuple(
        name
        for name in dict.fromkeys(asked)
        if _often(fresh, (name,), dt_s)
        and _jumps(_unwrapped(fields[name], fresh[name]) if name == HEADING else fields[name], fresh[name])
    )


def window_of(fresh: Array) -> int:
    """Ticks under a slope."""
    return (VALUES - 1) * round(every_of(fresh)) | 1


def _jumps(values: Array, fresh: Array) -> bool:
    """Whether a value is far from where the one before it was, for the time between them: over frames that are lost a
    car goes on.
    """
    rows = np.flatnonzero(fresh & np.isfinite(values))
    pace = np.abs(np.diff(values[rows])) / np.diff(rows)
    return bool(pace.max() > JUMP * max(float(np.quantile(pace, USUAL)), 1e-12))


def _often(fresh: Mapping[str, Array], names: tuple[str, ...], dt_s: float) -> bool:
    """Whether values of all of these are there, and come often enough for slopes."""
    if any(name not in fresh or fresh[name].sum() < LEAST_VALUES for name in names):
        return False
    return all(round(every_of(fresh[name])) * dt_s <= SLOWEST_S for name in names)


def _unwrapped(values: Array, fresh: Array) -> Array:
    found, rows = values.copy(), np.flatnonzero(fresh & np.isfinite(values))
    found[rows] = np.unwrap(values[rows])
    return found


def _slope(values: Array, fresh: Array, dt_s: float) -> Array:
    """Rate per s; NaN before the first value."""
    return rate_of(values, fresh, window_of(fresh), dt_s)
