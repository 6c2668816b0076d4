"""An evasion: a fast move to the side while braking, and back behind the obstacle."""

from __future__ import annotations

from random import Random

import numpy as np

from tunefree_hil.roads.draft import RoadDraft, RoadRequest
from tunefree_hil.roads.families.family import LEAD_S, TAIL_S, RoadFamily
from tunefree_hil.roads.families.lane_changes import shift_half_s, shift_peak_mps2
from tunefree_hil.roads.limits import RoadLimits
from tunefree_hil.roads.traces import (
    curvature_from_lateral,
    plan_speed_change,
    speed_trace,
    time_grid,
    turned_rad,
    wave_trace,
)

OFFSET_M = (1.8, 3.5)
PASS_S = (0.8, 2.0)  # beside the obstacle
SLOWEST = 0.5  # of the first speed
LEAVE_S = 6.0  # longest acceleration after it


def build_evasion(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Brake and move to the side at once, pass, come back, accelerate."""
    speed, offset = request.speed_mps, chance.uniform(*OFFSET_M)
    lead_s, pass_s = chance.uniform(*LEAD_S), chance.uniform(*PASS_S)
    half_s = shift_half_s(limits, request, speed, offset)
    braking = request.longitudinal_share * float(limits.decel_at_mps2(speed))
    slower = max(speed - braking * 2.0 * half_s, SLOWEST * speed)
    brake = plan_speed_change(limits, request, speed, slower)
    back_half_s = shift_half_s(limits, request, slower, offset)
    back_s = lead_s + max(2.0 * half_s, brake.duration_s) + pass_s
    leave_s = back_s + 2.0 * back_half_s + 0.5
    most = LEAVE_S * request.longitudinal_share * float(limits.accel_at_mps2(speed))
    faster = plan_speed_change(limits, request, slower, slower + min(0.5 * (speed - slower), most))
    time = time_grid(leave_s + faster.duration_s + TAIL_S)
    speeds = speed_trace(time, speed, [(lead_s, brake), (leave_s, faster)])
    away = _straightened(time, speeds, lead_s, half_s, request.side * shift_peak_mps2(offset, half_s))
    back = _straightened(time, speeds, back_s, back_half_s, -request.side * shift_peak_mps2(offset, back_half_s))
    return RoadDraft(speeds, away + back, f"evade by {offset:.1f} m while braking from {speed:.1f} to {slower:.1f} m/s")


def _straightened(
    time_s: np.ndarray, speed_mps: np.ndarray, begin_s: float, half_s: float, peak_mps2: float
) -> np.ndarray:
    """Curvature of a move to the side that ends with the heading that it began with.

    A slower second half wave turns the vehicle further than the first; the stronger one is made weaker.
    """
    first = curvature_from_lateral(wave_trace(time_s, begin_s, half_s, (peak_mps2,)), speed_mps)
    second = curvature_from_lateral(wave_trace(time_s, begin_s, half_s, (0.0, -peak_mps2)), speed_mps)
    turned, returned = abs(turned_rad(first, speed_mps)), abs(turned_rad(second, speed_mps))
    least = min(turned, returned)
    return first * (least / turned) + second * (least / returned)


EVASION = RoadFamily("evasion", 8.0, 30.0, build_evasion)
