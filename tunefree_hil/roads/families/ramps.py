"""Ramps of a motorway: off, a bend that tightens while braking; on, one that opens while accelerating."""

from __future__ import annotations

from random import Random

from tunefree_hil.roads.draft import RoadDraft, RoadRequest
from tunefree_hil.roads.families.family import LEAD_S, TAIL_S, RoadFamily, usable_lateral_mps2
from tunefree_hil.roads.limits import RoadLimits
from tunefree_hil.roads.traces import (
    Bend,
    bend_trace,
    curvature_from_lateral,
    plan_speed_change,
    ramp_time_s,
    speed_trace,
    time_grid,
)

RAMP_SPEED = (0.5, 0.7)  # speed in the tight part, of the speed on the motorway
SLOWEST_MPS = 7.0
HOLD_S = (2.0, 4.0)  # in the tight part, at a constant speed
SLOW_ENTRY = 2.0  # the bend begins in so many times the shortest time of its ramp: a transition curve
MAX_CHANGE_S = 10.0  # longest acceleration; a gentle one begins at a higher speed


def build_off_ramp(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Leave at speed into a bend that tightens as the vehicle slows down: constant lateral acceleration."""
    fast, slow = request.speed_mps, _ramp_speed_mps(request, chance)
    lateral, lead_s, hold_s = _lateral_mps2(request, limits, slow), chance.uniform(*LEAD_S), chance.uniform(*HOLD_S)
    change = plan_speed_change(limits, request, fast, slow)
    entry_s = SLOW_ENTRY * ramp_time_s(limits, request, fast, lateral)
    exit_s = SLOW_ENTRY * ramp_time_s(limits, request, slow, lateral)
    held_s = max(change.duration_s - 0.5 * entry_s, 0.0) + hold_s
    bends = [Bend(request.side * lateral, entry_s, held_s), Bend(0.0, exit_s, 0.0)]
    time = time_grid(lead_s + entry_s + held_s + exit_s + TAIL_S)
    speeds = speed_trace(time, fast, [(lead_s + 0.5 * entry_s, change)])
    curvature = curvature_from_lateral(bend_trace(time, lead_s, bends), speeds)
    return RoadDraft(speeds, curvature, f"motorway ramp, off: {fast:.1f} to {slow:.1f} m/s in a tightening bend")


def build_on_ramp(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Accelerate out of a tight bend that opens: constant lateral acceleration."""
    fast, slow = request.speed_mps, _ramp_speed_mps(request, chance)
    most = request.longitudinal_share * float(limits.accel_at_mps2(fast)) * MAX_CHANGE_S
    slow = max(slow, fast - most)
    lateral, lead_s, hold_s = _lateral_mps2(request, limits, slow), chance.uniform(*LEAD_S), chance.uniform(*HOLD_S)
    change = plan_speed_change(limits, request, slow, fast)
    entry_s = SLOW_ENTRY * ramp_time_s(limits, request, slow, lateral)
    exit_s = SLOW_ENTRY * ramp_time_s(limits, request, fast, lateral)
    held_s = hold_s + max(change.duration_s - 0.5 * exit_s, 0.0)
    bends = [Bend(request.side * lateral, entry_s, held_s), Bend(0.0, exit_s, 0.0)]
    time = time_grid(lead_s + entry_s + held_s + exit_s + TAIL_S)
    speeds = speed_trace(time, slow, [(lead_s + entry_s + hold_s, change)])
    curvature = curvature_from_lateral(bend_trace(time, lead_s, bends), speeds)
    return RoadDraft(speeds, curvature, f"motorway ramp, on: {slow:.1f} to {fast:.1f} m/s in an opening bend")


def _ramp_speed_mps(request: RoadRequest, chance: Random) -> float:
    return min(max(request.speed_mps * chance.uniform(*RAMP_SPEED), SLOWEST_MPS), request.speed_mps)


def _lateral_mps2(request: RoadRequest, limits: RoadLimits, slow_mps: float) -> float:
    return usable_lateral_mps2(request._replace(speed_mps=slow_mps), limits)


OFF_RAMP = RoadFamily("off_ramp", 12.0, 30.0, build_off_ramp)
ON_RAMP = RoadFamily("on_ramp", 12.0, 30.0, build_on_ramp)
