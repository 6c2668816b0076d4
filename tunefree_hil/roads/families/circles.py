"""A steady circle (ISO 4138) and a U-turn at low speed."""

from __future__ import annotations

import math
from random import Random

from tunefree_hil.roads.draft import RoadDraft, RoadRequest
from tunefree_hil.roads.families.family import LEAD_S, TAIL_S, RoadFamily, usable_lateral_mps2
from tunefree_hil.roads.limits import RoadLimits
from tunefree_hil.roads.traces import (
    bend_trace,
    bends_duration_s,
    curvature_from_lateral,
    plan_bends,
    plan_speed_change,
    speed_trace,
    time_grid,
)

ENTRY_S = 4.0  # ramp of the circle; longer where the steering rate needs it
CIRCLE_S = (9.0, 13.0)
APPROACH_MPS = 3.0  # faster than in the U-turn, at most
WIDEST_U_TURN_M = 14.0  # radius: a road of two lanes with its shoulders
LEAVE_S = 4.0  # longest acceleration after the U-turn
GAP_S = 0.5


def build_steady_circle(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """A long bend of constant radius at a constant speed, entered slowly."""
    speed, lead_s = request.speed_mps, chance.uniform(*LEAD_S)
    lateral = usable_lateral_mps2(request, limits)
    shortest = plan_bends(limits, request, speed, [(request.side * lateral, chance.uniform(*CIRCLE_S))])
    bends = [bend._replace(ramp_s=max(bend.ramp_s, ENTRY_S)) for bend in shortest]
    time = time_grid(lead_s + bends_duration_s(bends) + TAIL_S)
    speeds = speed_trace(time, speed, [])
    curvature = curvature_from_lateral(bend_trace(time, lead_s, bends), speeds)
    return RoadDraft(speeds, curvature, f"circle of radius {speed * speed / lateral:.0f} m at {speed:.1f} m/s")


def build_u_turn(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Slow down, turn by 180 degrees, accelerate."""
    speed, lead_s = request.speed_mps, chance.uniform(*LEAD_S)
    tight = request._replace(lateral_accel_mps2=max(request.lateral_accel_mps2, speed * speed / WIDEST_U_TURN_M))
    lateral = usable_lateral_mps2(tight, limits)
    approach = min(speed + APPROACH_MPS * request.longitudinal_share, limits.speed_mps)
    leave = min(approach, speed + LEAVE_S * request.longitudinal_share * float(limits.accel_at_mps2(approach)))
    slow, fast = plan_speed_change(limits, request, approach, speed), plan_speed_change(limits, request, speed, leave)
    ramp_s = plan_bends(limits, request, speed, [(lateral, 0.0)])[0].ramp_s
    hold_s = max(math.pi * speed / lateral - ramp_s, 0.0)
    bends = plan_bends(limits, request, speed, [(request.side * lateral, hold_s)])
    turn_s = lead_s + slow.duration_s + GAP_S
    leave_s = turn_s + bends_duration_s(bends) + GAP_S
    time = time_grid(leave_s + fast.duration_s + TAIL_S)
    speeds = speed_trace(time, approach, [(lead_s, slow), (leave_s, fast)])
    curvature = curvature_from_lateral(bend_trace(time, turn_s, bends), speeds)
    return RoadDraft(speeds, curvature, f"U-turn on a radius of {speed * speed / lateral:.1f} m at {speed:.1f} m/s")


STEADY_CIRCLE = RoadFamily("steady_circle", 4.0, 30.0, build_steady_circle)
U_TURN = RoadFamily("u_turn", 2.0, 6.0, build_u_turn)
