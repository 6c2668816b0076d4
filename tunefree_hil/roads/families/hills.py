"""A hilly road: crests and sags, a bend, and a change of speed on the slope."""

from __future__ import annotations

import math
from random import Random

from tunefree_hil.roads.draft import RoadDraft, RoadRequest
from tunefree_hil.roads.families.family import LEAD_S, TAIL_S, RoadFamily, usable_lateral_mps2
from tunefree_hil.roads.limits import CRITERIA, GRAVITY_MPS2, RoadLimits
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

GRADE_RAD = (0.03, 0.08)  # slopes of country roads
SLOPE_SHARE = 0.6  # of the longest acceleration; the rest is for the change of speed
SLOPE_HOLD_S = (1.5, 4.0)
BEND_HOLD_S = 3.0
SPEED_SHARE = 0.25  # of the speed, changed at most
CHANGE_S = 7.0  # longest change of speed
CRESTS_S = 16.0  # all crests and sags together


def build_hills(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Up and down, or down and up, with a bend on the first slope and a change of speed on the second."""
    speed, lead_s = request.speed_mps, chance.uniform(*LEAD_S)
    # the crests take crest_time_s of twice the sum of both slopes
    soon_over = CRESTS_S / (2.0 * crest_time_s(speed, 1.0))
    fits = min(SLOPE_SHARE * float(limits.accel_at_mps2(speed)) / GRAVITY_MPS2, soon_over / 2.0)
    first, second = (min(chance.uniform(*GRADE_RAD), fits) for _ in range(2))
    upward = 1.0 if chance.random() < 0.5 else -1.0
    slopes = [
        Bend(upward * first, crest_time_s(speed, first), chance.uniform(*SLOPE_HOLD_S)),
        Bend(-upward * second, crest_time_s(speed, first + second), chance.uniform(*SLOPE_HOLD_S)),
        Bend(0.0, crest_time_s(speed, second), 0.0),
    ]
    rest = request._replace(longitudinal_share=(1.0 - SLOPE_SHARE) * request.longitudinal_share)
    sign = -1.0 if upward < 0.0 else 1.0  # downhill it speeds up, uphill it slows down
    most = CHANGE_S * rest.longitudinal_share * float(limits.accel_at_mps2(speed))
    other = min(speed + sign * min(SPEED_SHARE * request.longitudinal_share * speed, most), limits.speed_mps)
    change = plan_speed_change(limits, rest, speed, other)
    lateral = usable_lateral_mps2(request, limits)
    bends = plan_bends(limits, request, speed, [(request.side * lateral, BEND_HOLD_S)])
    change_s = lead_s + max(bends_duration_s(bends), slopes[0].ramp_s + slopes[0].hold_s + 0.5 * slopes[1].ramp_s)
    time = time_grid(max(lead_s + bends_duration_s(slopes), change_s + change.duration_s) + TAIL_S)
    speeds = speed_trace(time, speed, [(change_s, change)])
    return RoadDraft(
        speeds,
        curvature_from_lateral(bend_trace(time, lead_s, bends), speeds),
        f"hills of {100.0 * first:.0f} and {100.0 * second:.0f} % at {speed:.1f} m/s",
        grade_rad=bend_trace(time, lead_s, slopes),
    )


def crest_time_s(speed_mps: float, change_rad: float) -> float:
    """Time of a crest or sag whose vertical acceleration stays within the comfortable."""
    return max(math.pi / 2.0 * speed_mps * change_rad / CRITERIA.max_vertical_accel_mps2, 1.0)


HILLS = RoadFamily("hills", 5.0, 30.0, build_hills)
