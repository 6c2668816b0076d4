"""Straight on: at speed over changing friction and slope, and with steps of speed."""

from __future__ import annotations

from random import Random

import numpy as np

from tunefree_hil.roads.draft import RoadDraft, RoadRequest
from tunefree_hil.roads.families.family import LEAD_S, TAIL_S, RoadFamily
from tunefree_hil.roads.families.hills import crest_time_s
from tunefree_hil.roads.limits import GRAVITY_MPS2, RoadLimits
from tunefree_hil.roads.traces import Bend, SpeedChange, bend_trace, plan_speed_change, speed_trace, time_grid

STRAIGHT_S = (18.0, 24.0)
WET_FRICTION = (0.6, 0.9)  # share of the friction of a dry road
WET_RAMP_S, WET_HOLD_S = 0.5, (2.0, 4.0)
SLOPE_RAD = 0.02
SLOPE_SHARE = 0.5  # of the longest acceleration, for the slope
LOWEST_SPEED = 0.5  # of the request's speed
STEPS_END_S = 24.0  # no step begins that would end later
CRUISE_S = (1.0, 2.5)


def build_straight(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """A constant speed over two wet patches and a gentle slope; only what disturbs the vehicle moves the wheel."""
    speed, lead_s = request.speed_mps, chance.uniform(*LEAD_S)
    time = time_grid(chance.uniform(*STRAIGHT_S))
    patches = [
        Bend(chance.uniform(*WET_FRICTION) - 1.0, WET_RAMP_S, chance.uniform(*WET_HOLD_S)),
        Bend(0.0, WET_RAMP_S, chance.uniform(*WET_HOLD_S)),
        Bend(chance.uniform(*WET_FRICTION) - 1.0, WET_RAMP_S, chance.uniform(*WET_HOLD_S)),
        Bend(0.0, WET_RAMP_S, 0.0),
    ]
    fits = SLOPE_SHARE * float(limits.accel_at_mps2(speed)) / GRAVITY_MPS2
    slope = min(SLOPE_RAD, fits) * chance.uniform(-1.0, 1.0)
    crest_s = crest_time_s(speed, abs(slope))
    grade = bend_trace(time, lead_s, [Bend(slope, crest_s, 4.0), Bend(0.0, crest_s, 0.0)])
    return RoadDraft(
        np.full(len(time), speed),
        np.zeros(len(time)),
        f"straight on at {speed:.1f} m/s over wet patches",
        grade_rad=grade,
        friction_frac=1.0 + bend_trace(time, lead_s, patches),
    )


def build_speed_steps(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Brake and accelerate between the speed and half of it, straight on."""
    highest, begin_s = request.speed_mps, chance.uniform(*LEAD_S)
    speed, changes = highest, list[tuple[float, SpeedChange]]()
    while True:
        low, high = LOWEST_SPEED * highest, highest
        target = chance.uniform(low, 0.8 * high) if speed > 0.8 * highest else chance.uniform(0.85, 1.0) * high
        change = plan_speed_change(limits, request, speed, target)
        if changes and begin_s + change.duration_s > STEPS_END_S:
            break
        changes.append((begin_s, change))
        begin_s += change.duration_s + chance.uniform(*CRUISE_S)
        speed = target
    speeds = speed_trace(time_grid(begin_s + TAIL_S), highest, changes)
    return RoadDraft(speeds, np.zeros(len(speeds)), f"{len(changes)} changes of speed below {highest:.1f} m/s")


STRAIGHT = RoadFamily("straight", 8.0, 30.0, build_straight)
SPEED_STEPS = RoadFamily("speed_steps", 4.0, 30.0, build_speed_steps)
