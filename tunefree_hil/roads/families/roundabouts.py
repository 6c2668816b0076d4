"""A roundabout: brake, deflect at the entry, circulate on a radius of 12 to 30 m, leave."""

from __future__ import annotations

import math
from random import Random
from typing import NamedTuple

from tunefree_hil.roads.draft import RoadDraft, RoadRequest
from tunefree_hil.roads.families.family import LEAD_S, STEER_RESERVE, TAIL_S, RoadFamily
from tunefree_hil.roads.limits import CRITERIA, RoadLimits
from tunefree_hil.roads.traces import (
    Bend,
    bend_trace,
    bends_duration_s,
    curvature_from_lateral,
    plan_bends,
    plan_speed_change,
    speed_trace,
    time_grid,
)

RADIUS_M = (12.0, 30.0)
ARCS_RAD = (math.radians(90.0), math.radians(180.0), math.radians(270.0))  # on the circle: straight on, left, back
DEFLECTION = 0.85  # of the circle's lateral acceleration, to the other side
DEFLECTION_RAD = math.radians(45.0)  # change of heading at entry and exit
APPROACH_MPS = 5.0  # faster than in the circle, at most
LEAVE_S = 4.0  # longest acceleration at the exit
GAP_S = 0.3


class CirclePlan(NamedTuple):
    """A way round: radius, arc that is driven, and the lateral accelerations."""

    radius_m: float
    arc_rad: float
    bends: list[Bend]


def build_roundabout(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Enter, circulate to an exit, leave; to the left: traffic drives on the right-hand side."""
    most = STEER_RESERVE * limits.lateral_at_mps2(request.speed_mps)
    speed, lead_s = min(request.speed_mps, math.sqrt(most * RADIUS_M[1])), chance.uniform(*LEAD_S)
    approach = min(speed + APPROACH_MPS * request.longitudinal_share, limits.speed_mps)
    leave = min(approach, speed + LEAVE_S * request.longitudinal_share * float(limits.accel_at_mps2(approach)))
    slow, fast = plan_speed_change(limits, request, approach, speed), plan_speed_change(limits, request, speed, leave)
    turn_s = lead_s + slow.duration_s + GAP_S
    left_s = CRITERIA.max_duration_s - turn_s - GAP_S - fast.duration_s - TAIL_S
    tightest = max(RADIUS_M[0], speed * speed / most)
    wanted = min(max(speed * speed / request.lateral_accel_mps2, tightest), RADIUS_M[1])
    arcs_rad = list(ARCS_RAD)
    chance.shuffle(arcs_rad)
    circles = [
        CirclePlan(radius, arc_rad, _circle_bends(request, limits, speed, radius, arc_rad))
        for radius in (wanted, math.sqrt(wanted * tightest), tightest)
        for arc_rad in arcs_rad
    ]
    in_time = [circle for circle in circles if bends_duration_s(circle.bends) <= left_s]
    radius, arc_rad, bends = in_time[0] if in_time else min(circles, key=lambda plan: bends_duration_s(plan.bends))
    leave_s = turn_s + bends_duration_s(bends) + GAP_S
    time = time_grid(leave_s + fast.duration_s + TAIL_S)
    speeds = speed_trace(time, approach, [(lead_s, slow), (leave_s, fast)])
    return RoadDraft(
        speeds,
        curvature_from_lateral(bend_trace(time, turn_s, bends), speeds),
        f"roundabout of radius {radius:.0f} m at {speed:.1f} m/s, {math.degrees(arc_rad):.0f} degrees of it",
    )


def _circle_bends(request: RoadRequest, limits: RoadLimits, speed: float, radius: float, arc_rad: float) -> list[Bend]:
    """Deflection, circle, deflection; the ramps count for the heading too."""
    lateral = speed * speed / radius
    aside = DEFLECTION * lateral
    entry, circle = plan_bends(limits, request, speed, [(-aside, 0.0), (lateral, 0.0)])[:2]
    circle_share = lateral / (lateral + aside)  # of the ramp between the two, that turns with the circle
    circle_s = arc_rad * speed / lateral - circle_share * circle.ramp_s
    aside_s = DEFLECTION_RAD * speed / aside - 0.5 * entry.ramp_s - 0.5 * (1.0 - circle_share) * circle.ramp_s
    side, aside_s = request.side, max(aside_s, 0.0)
    targets = [(-side * aside, aside_s), (side * lateral, max(circle_s, 0.0)), (-side * aside, aside_s)]
    return plan_bends(limits, request, speed, targets)


ROUNDABOUT = RoadFamily("roundabout", 4.0, 9.5, build_roundabout)
