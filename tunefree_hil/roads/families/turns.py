"""A turn at a junction, with braking before and acceleration after it, and a winding road."""

from __future__ import annotations

import math
from random import Random

from tunefree_hil.roads.draft import RoadDraft, RoadRequest
from tunefree_hil.roads.families.family import LEAD_S, TAIL_S, RoadFamily, usable_lateral_mps2
from tunefree_hil.roads.limits import CRITERIA, RoadLimits
from tunefree_hil.roads.traces import (
    bend_trace,
    bends_duration_s,
    curvature_from_lateral,
    plan_bends,
    plan_speed_change,
    speed_trace,
    time_grid,
)

TURN_RAD = (math.radians(60.0), math.radians(110.0))
LONGEST_HOLD_S = 8.0  # a fast turn ends before its angle is reached: 30 s are soon full
GAP_S = 0.5  # between braking and turning, and between turning and accelerating
APPROACH_S = (0.8, 2.5)  # time of braking at the greatest deceleration
LEAVE_S = 6.0  # longest acceleration after the turn
ARCS = (3, 6)
ARC_HOLD_S = (0.8, 2.2)
LEAST_ARC = 0.6  # of the greatest lateral acceleration


def build_turn(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Brake to the speed, turn by 60 to 110 degrees, accelerate back."""
    speed = request.speed_mps
    lateral = usable_lateral_mps2(request, limits)
    braking = request.longitudinal_share * float(limits.decel_at_mps2(speed))
    approach = min(speed + braking * chance.uniform(*APPROACH_S), 1.8 * speed, limits.speed_mps)
    lead_s, angle = chance.uniform(*LEAD_S), chance.uniform(*TURN_RAD)
    leave = min(approach, speed + LEAVE_S * request.longitudinal_share * float(limits.accel_at_mps2(approach)))
    slow, fast = plan_speed_change(limits, request, approach, speed), plan_speed_change(limits, request, speed, leave)
    ramp_s = plan_bends(limits, request, speed, [(lateral, 0.0)])[0].ramp_s
    hold_s = min(max(angle * speed / lateral - ramp_s, 0.0), LONGEST_HOLD_S)
    bends = plan_bends(limits, request, speed, [(request.side * lateral, hold_s)])
    turn_s = lead_s + slow.duration_s + GAP_S
    leave_s = turn_s + bends_duration_s(bends) + GAP_S
    time = time_grid(leave_s + fast.duration_s + TAIL_S)
    speeds = speed_trace(time, approach, [(lead_s, slow), (leave_s, fast)])
    curvature = curvature_from_lateral(bend_trace(time, turn_s, bends), speeds)
    return RoadDraft(speeds, curvature, f"turn on a radius of {speed * speed / lateral:.0f} m at {speed:.1f} m/s")


def build_winding(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Several bends of both signs, the second half at another speed."""
    speed = request.speed_mps
    lateral = usable_lateral_mps2(request, limits)
    targets, side = [], request.side
    for _ in range(chance.randint(*ARCS)):
        targets.append((side * lateral * chance.uniform(LEAST_ARC, 1.0), chance.uniform(*ARC_HOLD_S)))
        side = -side
    slower = speed * (1.0 - 0.25 * request.longitudinal_share * chance.uniform(0.5, 1.0))
    change = plan_speed_change(limits, request, speed, slower)
    lead_s = chance.uniform(*LEAD_S)
    bends = plan_bends(limits, request, slower, targets)
    while len(targets) > 1 and lead_s + bends_duration_s(bends) + TAIL_S > CRITERIA.max_duration_s:
        targets.pop()  # at low speed the wheel turns for long
        bends = plan_bends(limits, request, slower, targets)
    middle_s = lead_s + 0.4 * bends_duration_s(bends)
    time = time_grid(lead_s + bends_duration_s(bends) + TAIL_S)
    speeds = speed_trace(time, speed, [(middle_s, change)])
    curvature = curvature_from_lateral(bend_trace(time, lead_s, bends), speeds)
    return RoadDraft(speeds, curvature, f"winding road, {len(targets)} bends at {speed:.1f} m/s")


TURN = RoadFamily("turn", 3.0, 25.0, build_turn)
WINDING = RoadFamily("winding", 5.0, 30.0, build_winding)
