"""Stop and go in traffic, and one hard stop from speed with a start after it."""

from __future__ import annotations

from random import Random

import numpy as np

from tunefree_hil.roads.draft import RoadDraft, RoadRequest
from tunefree_hil.roads.families.family import LEAD_S, RoadFamily
from tunefree_hil.roads.limits import CRITERIA, RoadLimits
from tunefree_hil.roads.traces import SpeedChange, plan_speed_change, speed_trace, time_grid

STANDSTILL_S = (1.5, 2.5)
CRUISE_S = (0.5, 2.0)
LOWEST_PEAK = 0.5  # of the request's speed, of the later starts
RESTART_S = 5.0  # a start after the hard stop, if so much time is left
LATEST_START_S = 22.0  # a later start of a cycle would not be ended


def build_stop_and_go(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Come up to a queue, then start and stop; it ends at standstill."""
    speed, now_s = request.speed_mps, chance.uniform(*LEAD_S)
    changes: list[tuple[float, SpeedChange]] = []
    peak, starts = speed, 0
    while True:
        stop = plan_speed_change(limits, request, peak, 0.0)
        changes.append((now_s, stop))
        now_s += stop.duration_s + chance.uniform(*STANDSTILL_S)
        peak = speed * chance.uniform(LOWEST_PEAK, 1.0)
        start = plan_speed_change(limits, request, 0.0, peak)
        cruise_s = chance.uniform(*CRUISE_S)
        ends_s = now_s + start.duration_s + cruise_s + plan_speed_change(limits, request, peak, 0.0).duration_s
        if ends_s + STANDSTILL_S[1] > CRITERIA.max_duration_s or now_s > LATEST_START_S:
            break
        changes.append((now_s, start))
        now_s += start.duration_s + cruise_s
        starts += 1
    speeds = speed_trace(time_grid(now_s), speed, changes)
    return RoadDraft(speeds, np.zeros(len(speeds)), f"stop and go to {speed:.1f} m/s, {starts + 1} stops")


def build_full_stop(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Brake from speed to standstill, straight on; start again where time is left."""
    speed, lead_s = request.speed_mps, chance.uniform(*LEAD_S)
    stop = plan_speed_change(limits, request, speed, 0.0)
    start_s = lead_s + stop.duration_s + chance.uniform(*STANDSTILL_S)
    restart = plan_speed_change(limits, request, 0.0, min(0.5 * speed, 5.0))
    changes = [(lead_s, stop)]
    end_s = start_s
    if start_s + restart.duration_s + RESTART_S <= CRITERIA.max_duration_s:
        changes.append((start_s, restart))
        end_s = start_s + restart.duration_s + RESTART_S
    speeds = speed_trace(time_grid(end_s), speed, changes)
    return RoadDraft(speeds, np.zeros(len(speeds)), f"stop from {speed:.1f} m/s at {stop.accel_mps2:.1f} m/s2")


STOP_AND_GO = RoadFamily("stop_and_go", 1.0, 14.0, build_stop_and_go)
FULL_STOP = RoadFamily("full_stop", 5.0, 30.0, build_full_stop)
