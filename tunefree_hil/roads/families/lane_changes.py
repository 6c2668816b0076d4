"""Lane changes: one with a way back later, and a double one after the geometry of ISO 3888-1."""

from __future__ import annotations

import math
from random import Random

import numpy as np

from tunefree_hil.roads.draft import RoadDraft, RoadRequest
from tunefree_hil.roads.families.family import LEAD_S, TAIL_S, RoadFamily, usable_lateral_mps2
from tunefree_hil.roads.limits import RoadLimits
from tunefree_hil.roads.traces import (
    curvature_from_lateral,
    half_wave_s,
    plan_speed_change,
    speed_trace,
    time_grid,
    wave_trace,
)

LANE_M = (2.7, 3.7)  # widths of lanes, m
ISO_3888_OFFSET_M = 3.5
ISO_3888_HOLD_M = 25.0  # length of the second lane
HOLD_S = (0.6, 3.0)  # shortest and longest time in the second lane
WAY_BACK_S = (2.5, 4.0)
CHANGE_S = 2.0  # time of acceleration or braking before the way back


def shift_half_s(limits: RoadLimits, request: RoadRequest, speed_mps: float, offset_m: float) -> float:
    """Half the time in which one period of a sine moves the vehicle sideways: offset = a T^2 / (2 pi).

    The time grows until lateral acceleration, lateral jerk and steering rate are within their limits.
    """
    lateral = usable_lateral_mps2(request._replace(speed_mps=speed_mps), limits)
    whole_s = math.sqrt(2.0 * math.pi * offset_m / lateral)
    half_s = half_wave_s(limits, request, speed_mps, lateral)
    # jerk 2 pi a / T with a = 2 pi offset / T^2: the shortest time grows with the third root
    if 2.0 * half_s > whole_s:
        whole_s = (2.0 * half_s * whole_s * whole_s) ** (1.0 / 3.0)
    return 0.5 * whole_s


def shift_peak_mps2(offset_m: float, half_s: float) -> float:
    """Lateral acceleration of the sine that moves the vehicle sideways in two half periods."""
    return 2.0 * math.pi * offset_m / (4.0 * half_s * half_s)


def build_lane_change(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Change the lane, speed up or slow down, and change back."""
    speed, offset = request.speed_mps, chance.uniform(*LANE_M)
    lead_s, pause_s = chance.uniform(*LEAD_S), chance.uniform(*WAY_BACK_S)
    is_faster = chance.random() < 0.5
    allowed = float(limits.accel_at_mps2(speed) if is_faster else -limits.decel_at_mps2(speed))
    wanted = speed + CHANGE_S * request.longitudinal_share * allowed
    second = min(max(wanted, 0.7 * speed), limits.speed_mps)
    half_s, back_half_s = (shift_half_s(limits, request, one, offset) for one in (speed, second))
    change = plan_speed_change(limits, request, speed, second)
    back_s = lead_s + 2.0 * half_s + max(pause_s, change.duration_s + 0.5)
    time = time_grid(back_s + 2.0 * back_half_s + TAIL_S)
    first = shift_peak_mps2(offset, half_s) * request.side
    back = shift_peak_mps2(offset, back_half_s) * request.side
    lateral = wave_trace(time, lead_s, half_s, (first, -first)) + wave_trace(time, back_s, back_half_s, (-back, back))
    speeds = speed_trace(time, speed, [(lead_s + 2.0 * half_s, change)])
    return RoadDraft(
        speeds,
        curvature_from_lateral(lateral, speeds),
        f"lane change of {offset:.1f} m at {speed:.1f} m/s, back at {second:.1f} m/s",
    )


def build_double_lane_change(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Evade by 3.5 m, pass 25 m, come back: at a constant speed, then brake."""
    speed, lead_s = request.speed_mps, chance.uniform(*LEAD_S)
    half_s = shift_half_s(limits, request, speed, ISO_3888_OFFSET_M)
    pause_s = min(max(ISO_3888_HOLD_M / speed, HOLD_S[0]), HOLD_S[1])
    peak = shift_peak_mps2(ISO_3888_OFFSET_M, half_s) * request.side
    back_s = lead_s + 2.0 * half_s + pause_s
    brake_s = back_s + 2.0 * half_s + 0.5
    braking = request.longitudinal_share * float(limits.decel_at_mps2(speed))
    change = plan_speed_change(limits, request, speed, max(speed - CHANGE_S * braking, 0.5 * speed))
    time = time_grid(brake_s + change.duration_s + TAIL_S)
    lateral = wave_trace(time, lead_s, half_s, (peak, -peak)) + wave_trace(time, back_s, half_s, (-peak, peak))
    speeds = speed_trace(time, speed, [(brake_s, change)])
    curvature = np.where(time < brake_s, curvature_from_lateral(lateral, speeds), 0.0)
    return RoadDraft(speeds, curvature, f"double lane change of {ISO_3888_OFFSET_M} m at {speed:.1f} m/s")


LANE_CHANGE = RoadFamily("lane_change", 5.0, 30.0, build_lane_change)
DOUBLE_LANE_CHANGE = RoadFamily("double_lane_change", 5.0, 30.0, build_double_lane_change)
