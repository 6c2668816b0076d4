"""Straight on: at speed over changing friction, slope and bank, and in gusts; and with steps of speed."""

from __future__ import annotations

import math
from random import Random

import numpy as np

from tunefree_hil.roads.draft import RoadDraft, RoadRequest
from tunefree_hil.roads.families.family import LEAD_S, TAIL_S, RoadFamily
from tunefree_hil.roads.families.hills import crest_time_s
from tunefree_hil.roads.limits import GRAVITY_MPS2, RoadLimits
from tunefree_hil.roads.traces import (
    MIN_RAMP_S,
    Bend,
    SpeedChange,
    bend_trace,
    gust_trace,
    plan_speed_change,
    speed_trace,
    time_grid,
)

STRAIGHT_S = (18.0, 24.0)
WET_FRICTION = (0.6, 0.9)  # share of the friction of a dry road
WET_RAMP_S, WET_HOLD_S = 0.5, (2.0, 4.0)
SLOPE_RAD = 0.02
SLOPE_SHARE = 0.5  # of the longest acceleration, for the slope
# From the crossfall that drains a straight (2.5 %) to the superelevation of a bend (6 to 8 % at most), whose run-off
# begins on the straight before it. The rate is a choice: 0.06 rad in 2.4 s.
BANK_RAD = (0.025, 0.06)
BANK_RATE_RADPS = 0.025
BANK_HOLD_S = (3.0, 5.0)
# Of 1/2 rho v^2 on 2.2 m2 with a coefficient of side force near 1, over 1.7 t: 0.3 at 20 m/s relative to the air, and
# 0.7 at 30 m/s; a little more for larger sides.
GUST_MPS2 = (0.3, 0.8)
GUST_S = (1.0, 2.0)
GUSTS = (1, 2)
SIDE_SHARE = 0.8  # of the lateral limit, for bank and gust at their largest together
LOWEST_SPEED = 0.5  # of the request's speed
STEPS_END_S = 24.0  # no step begins that would end later
CRUISE_S = (1.0, 2.5)


def build_straight(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """A constant speed over wet patches, a gentle slope and a bank, in gusts: only disturbances move the wheel."""
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
    bank, wind = _bank_and_gusts(time, lead_s, limits, chance)
    return RoadDraft(
        np.full(len(time), speed),
        np.zeros(len(time)),
        f"straight on at {speed:.1f} m/s over wet patches, a bank and gusts of side wind",
        grade_rad=grade,
        friction_frac=1.0 + bend_trace(time, lead_s, patches),
        bank_rad=bank,
        side_wind_mps2=wind,
    )


def _bank_and_gusts(
    time_s: np.ndarray, lead_s: float, limits: RoadLimits, chance: Random
) -> tuple[np.ndarray, np.ndarray]:
    """A bank to either side, left again, and gusts from one side; smaller for a vehicle with little lateral grip."""
    most_mps2 = GRAVITY_MPS2 * math.sin(BANK_RAD[1]) + GUST_MPS2[1]
    share = min(1.0, SIDE_SHARE * limits.lateral_accel_mps2 / most_mps2)
    bank_rad = share * chance.uniform(*BANK_RAD) * chance.choice((-1.0, 1.0))
    ramp_s = max(abs(bank_rad) / BANK_RATE_RADPS, MIN_RAMP_S)
    bank = bend_trace(time_s, lead_s, [Bend(bank_rad, ramp_s, chance.uniform(*BANK_HOLD_S)), Bend(0.0, ramp_s, 0.0)])
    wind, side, count = np.zeros(len(time_s)), share * chance.choice((-1.0, 1.0)), chance.choice(GUSTS)
    each_s = (float(time_s[-1]) - TAIL_S - lead_s) / count  # one gust at any time within it
    for number in range(count):
        duration_s = chance.uniform(*GUST_S)
        begin_s = lead_s + number * each_s + chance.uniform(0.0, each_s - duration_s)
        wind += gust_trace(time_s, begin_s, duration_s, side * chance.uniform(*GUST_MPS2))
    return bank, wind


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
