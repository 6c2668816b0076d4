"""Signals that the families are made of: speeds with bounded jerk, bends with smooth ramps, sines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.roads.draft import STEP_S, RoadRequest
from tunefree_hil.roads.limits import CRITERIA, RoadLimits, jerk_at_mps3

MIN_RAMP_S = 0.6  # shortest ramp: six steps of the grid


class SpeedChange(NamedTuple):
    """A change of speed: acceleration rises with a constant jerk, stays, and falls with the same jerk.

    Attributes:
        accel_mps2: Greatest acceleration, positive also where it brakes.
        rise_s: Time in which it is reached.
    """

    from_mps: float
    to_mps: float
    accel_mps2: float
    rise_s: float

    @property
    def duration_s(self) -> float:
        """Time from the first to the last moment of the change."""
        return self.rise_s + abs(self.to_mps - self.from_mps) / self.accel_mps2 if self.accel_mps2 > 0.0 else 0.0


class Bend(NamedTuple):
    """A value that is reached smoothly, held and left for the next one.

    Attributes:
        value: What is held, lateral acceleration or grade.
        ramp_s: Time of the ramp that leads to it.
        hold_s: Time for which it is held.
    """

    value: float
    ramp_s: float
    hold_s: float


def time_grid(duration_s: float) -> np.ndarray:
    """Grid from 0 to the duration, rounded up to a step; a road lasts min_duration_s at least."""
    steps = math.ceil(max(duration_s, CRITERIA.min_duration_s) / STEP_S - 1e-9)
    return np.arange(steps + 1) * STEP_S


def plan_speed_change(limits: RoadLimits, request: RoadRequest, from_mps: float, to_mps: float) -> SpeedChange:
    """The change of speed that takes the requested share of what the limits allow."""
    fastest, change = max(from_mps, to_mps), abs(to_mps - from_mps)
    allowed = limits.accel_at_mps2(fastest) if to_mps > from_mps else limits.decel_at_mps2(fastest)
    accel = request.longitudinal_share * float(allowed)
    jerk = CRITERIA.design_share * float(jerk_at_mps3(fastest)) / request.ease
    if accel <= 0.0 or change <= 0.0:
        return SpeedChange(from_mps, from_mps, 0.0, 0.0)
    rise_s = max(accel / jerk, MIN_RAMP_S)
    if accel * rise_s > change:  # the change ends before the acceleration is reached
        rise_s = max(math.sqrt(change / jerk), MIN_RAMP_S)
        accel = change / rise_s
    return SpeedChange(from_mps, to_mps, accel, rise_s)


def speed_trace(time_s: np.ndarray, start_mps: float, changes: Sequence[tuple[float, SpeedChange]]) -> np.ndarray:
    """Speed from `start_mps` on, with changes that begin at the given times and do not overlap."""
    speed = np.full(len(time_s), start_mps)
    for begin_s, change in changes:
        speed += (change.to_mps - change.from_mps) * _trapezoid_integral(time_s - begin_s, change)
    return np.maximum(speed, 0.0)


def _trapezoid_integral(since_s: np.ndarray, change: SpeedChange) -> np.ndarray:
    """Share of the change that is done: integral of a trapezoid of area 1."""
    if change.accel_mps2 <= 0.0:
        return np.zeros(len(since_s))
    rise_s, whole_s = change.rise_s, change.duration_s
    height = 1.0 / (whole_s - rise_s)
    first = np.clip(since_s, 0.0, rise_s)
    last = np.clip(since_s - (whole_s - rise_s), 0.0, rise_s)
    level = np.clip(since_s - rise_s, 0.0, whole_s - rise_s)  # runs on through the fall, which is taken off
    return height * (0.5 * first * first / rise_s + level - 0.5 * last * last / rise_s)


def smooth_step(time_s: np.ndarray, begin_s: float, duration_s: float) -> np.ndarray:
    """From 0 to 1 along half a cosine."""
    share = np.clip((time_s - begin_s) / max(duration_s, STEP_S), 0.0, 1.0)
    return 0.5 - 0.5 * np.cos(np.pi * share)


def ramp_time_s(limits: RoadLimits, request: RoadRequest, speed_mps: float, change_mps2: float) -> float:
    """Time in which a smooth step changes the lateral acceleration within lateral jerk and steering rate."""
    change = abs(change_mps2)
    jerk = min(CRITERIA.max_lateral_jerk_mps3, speed_mps * speed_mps * float(limits.curvature_rate_1pmps(speed_mps)))
    steepest = math.pi / 2.0  # of a smooth step, times its mean slope
    return max(MIN_RAMP_S, request.ease * steepest * change / (CRITERIA.design_share * jerk))


def bend_trace(time_s: np.ndarray, begin_s: float, bends: Sequence[Bend]) -> np.ndarray:
    """Bends one after another; the last ramp back to 0 is a bend of value 0."""
    trace, value = np.zeros(len(time_s)), 0.0
    for bend in bends:
        trace += (bend.value - value) * smooth_step(time_s, begin_s, bend.ramp_s)
        value = bend.value
        begin_s += bend.ramp_s + bend.hold_s
    return trace


def bends_duration_s(bends: Sequence[Bend]) -> float:
    """Time from the first ramp to the end of the last bend."""
    return sum(bend.ramp_s + bend.hold_s for bend in bends)


def plan_bends(
    limits: RoadLimits, request: RoadRequest, speed_mps: float, targets: Sequence[tuple[float, float]]
) -> list[Bend]:
    """Bends through (lateral acceleration, hold in s), with ramps within the limits, and back to straight on."""
    bends, value = [], 0.0
    for target, hold_s in [*targets, (0.0, 0.0)]:
        bends.append(Bend(target, ramp_time_s(limits, request, speed_mps, target - value), hold_s))
        value = target
    return bends


def half_wave_s(limits: RoadLimits, request: RoadRequest, speed_mps: float, lateral_accel_mps2: float) -> float:
    """Shortest half period of a sine of this lateral acceleration within lateral jerk and steering rate."""
    jerk = min(CRITERIA.max_lateral_jerk_mps3, speed_mps * speed_mps * float(limits.curvature_rate_1pmps(speed_mps)))
    return request.ease * math.pi * lateral_accel_mps2 / (CRITERIA.design_share * jerk)


def wave_trace(time_s: np.ndarray, begin_s: float, half_s: float, amplitudes: Sequence[float]) -> np.ndarray:
    """Half waves of a sine one after another, with these amplitudes."""
    phase = (time_s - begin_s) / half_s
    index = np.floor(phase).astype(int)
    inside = (index >= 0) & (index < len(amplitudes))
    height = np.asarray(amplitudes, dtype=float)[np.clip(index, 0, len(amplitudes) - 1)]
    return np.where(inside, height * np.sin(np.pi * (phase - index)), 0.0)


def gust_trace(time_s: np.ndarray, begin_s: float, duration_s: float, peak: float) -> np.ndarray:
    """One gust of the shape 1 - cos, as gust standards have it (CS 25.341): the peak at half of its duration."""
    share = np.clip((time_s - begin_s) / duration_s, 0.0, 1.0)
    return 0.5 * peak * (1.0 - np.cos(2.0 * np.pi * share))


def curvature_from_lateral(lateral_accel_mps2: np.ndarray, speed_mps: np.ndarray) -> np.ndarray:
    """Curvature at which the speeds give the lateral accelerations; 0 at a crawl."""
    return np.where(speed_mps > 0.5, lateral_accel_mps2 / np.maximum(speed_mps, 0.5) ** 2, 0.0)


def turned_rad(curvature_1pm: np.ndarray, speed_mps: np.ndarray) -> float:
    """Change of heading over a road."""
    return float(np.sum(curvature_1pm * speed_mps) * STEP_S)
