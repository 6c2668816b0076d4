"""Sines of lateral acceleration: a slalom between cones, and the weave of ISO 13674-1 about straight on."""

from __future__ import annotations

import math
from random import Random

from tunefree_hil.roads.draft import RoadDraft, RoadRequest
from tunefree_hil.roads.families.family import LEAD_S, TAIL_S, RoadFamily, usable_lateral_mps2
from tunefree_hil.roads.limits import CRITERIA, RoadLimits
from tunefree_hil.roads.traces import (
    curvature_from_lateral,
    half_wave_s,
    plan_speed_change,
    speed_trace,
    time_grid,
    wave_trace,
)

SPACING_M = (18.0, 36.0)  # of the cones
SWING_M = 2.5  # widest swing to one side
SLALOM_S = 15.0  # time between the first and the last cone, about
HALF_WAVES = (4, 12)
WEAVE_HZ = (0.2, 0.35)  # ISO 13674-1: 0.2 Hz; on-centre driving has its answer below 0.5 Hz
WEAVE_MPS2 = 2.0  # ISO 13674-1: small, 1 to 2 m/s2
WEAVE_PERIODS = (3, 5)


def build_slalom(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Swing round evenly spaced cones, then brake or accelerate."""
    speed = request.speed_mps
    lateral = usable_lateral_mps2(request, limits)
    half_s = max(chance.uniform(*SPACING_M) / speed, half_wave_s(limits, request, speed, lateral))
    lateral = min(lateral, SWING_M * (math.pi / half_s) ** 2)
    count = min(max(round(SLALOM_S / half_s), HALF_WAVES[0]), HALF_WAVES[1])
    return _waves(request, limits, chance, half_s, lateral, count)._replace(
        description=f"slalom round cones every {half_s * speed:.0f} m at {speed:.1f} m/s"
    )


def build_weave(request: RoadRequest, limits: RoadLimits, chance: Random) -> RoadDraft:
    """Small sines at speed."""
    speed = request.speed_mps
    lateral = min(usable_lateral_mps2(request, limits), WEAVE_MPS2)
    half_s = max(0.5 / chance.uniform(*WEAVE_HZ), half_wave_s(limits, request, speed, lateral))
    count = 2 * chance.randint(*WEAVE_PERIODS)
    return _waves(request, limits, chance, half_s, lateral, count)._replace(
        description=f"weave of {lateral:.1f} m/s2 and {0.5 / half_s:.2f} Hz at {speed:.1f} m/s"
    )


def _waves(
    request: RoadRequest, limits: RoadLimits, chance: Random, half_s: float, lateral_mps2: float, count: int
) -> RoadDraft:
    """Half waves about straight on: the first and the last have half the height, so that the heading swings evenly."""
    speed, lead_s = request.speed_mps, chance.uniform(*LEAD_S)
    change = plan_speed_change(limits, request, speed, 0.8 * speed)
    fits = int((CRITERIA.max_duration_s - lead_s - change.duration_s - TAIL_S) / half_s)
    count = min(count, fits)
    end_s = lead_s + count * half_s
    heights = [request.side * lateral_mps2 * (-1.0) ** index for index in range(count)]
    heights[0], heights[-1] = 0.5 * heights[0], 0.5 * heights[-1]
    time = time_grid(end_s + change.duration_s + TAIL_S)
    speeds = speed_trace(time, speed, [(end_s, change)])
    return RoadDraft(speeds, curvature_from_lateral(wave_trace(time, lead_s, half_s, heights), speeds), "")


SLALOM = RoadFamily("slalom", 4.0, 20.0, build_slalom)
WEAVE = RoadFamily("weave", 15.0, 30.0, build_weave)
