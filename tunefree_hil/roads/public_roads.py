"""229 roads modelled on public definitions, as many as Apollo names scenarios: a fixed grid, without chance.

Lane changes after ISO 3888, steady circles after ISO 4138, weaves after ISO 13674-1, road classes by design speed and
smallest radius, roundabouts, ramps, stop and go, emergency stops.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

from tunefree_hil.roads.design import PlannedRoad
from tunefree_hil.roads.draft import RoadRequest
from tunefree_hil.roads.families import FAMILIES
from tunefree_hil.roads.limits import RoadLimits

FAMILY = {family.name: family for family in FAMILIES}
SIDES = (True, False)


class RoadClass(NamedTuple):
    """A class of roads: design speed, and the smallest radius that belongs to it (design guides of roads)."""

    speed_mps: float
    radius_m: float


class Grid(NamedTuple):
    """Speeds, shares of the greatest lateral and longitudinal acceleration, and sides of one family."""

    family: str
    speeds_mps: Sequence[float]
    lateral: Sequence[float] = (0.8,)
    longitudinal: Sequence[float] = (0.7,)
    sides: Sequence[bool] = (True,)


ROAD_CLASSES = (RoadClass(8.3, 27.0), RoadClass(13.9, 77.0), RoadClass(22.2, 240.0), RoadClass(27.8, 435.0))
CLASS_SHARES = (1.0, 0.9, 0.8, 0.7)  # of the design speed
ROUNDABOUT_RADII_M = (12.0, 16.0, 20.0, 25.0, 30.0)
CIRCLE_RADII_M = (30.0, 50.0, 100.0)  # ISO 4138: 30 m at least, 100 m as the standard one
LEVELS = (0.5, 0.75, 1.0)  # of the greatest lateral acceleration

GRIDS = (
    Grid("turn", (4.0, 7.0, 10.0, 14.0, 18.0), (0.6, 1.0), sides=SIDES),
    Grid("lane_change", (6.0, 10.0, 14.0, 17.0, 20.0, 23.0, 26.0, 30.0), sides=SIDES),
    Grid("double_lane_change", (6.0, 10.0, 14.0, 17.0, 20.0, 22.2, 25.0, 28.0), (1.0,), sides=SIDES),
    Grid("evasion", (8.0, 11.0, 14.0, 18.0, 22.0, 27.0), (1.0,), (1.0,), SIDES),
    Grid("slalom", (6.0, 9.0, 12.0, 15.0, 18.0), LEVELS),
    Grid("weave", (16.0, 20.0, 25.0, 28.0), LEVELS),
    Grid("off_ramp", (14.0, 19.0, 24.0, 29.0), LEVELS),
    Grid("on_ramp", (14.0, 19.0, 24.0, 29.0), LEVELS),
    Grid("u_turn", (2.5, 3.5, 4.5), (1.0,), sides=SIDES),
    Grid("hills", (7.0, 11.0, 15.0, 19.0, 24.0, 29.0)),
    Grid("stop_and_go", (3.0, 6.0, 9.0, 12.0), longitudinal=(0.6, 1.0)),
    Grid("full_stop", (6.0, 10.0, 14.0, 18.0, 23.0, 28.0), longitudinal=(0.6, 1.0)),
    Grid("speed_steps", (8.0, 14.0, 21.0, 28.0), longitudinal=(0.6, 1.0)),
    Grid("straight", tuple(9.0 + 2.3 * step for step in range(10))),
)


def plan_public_roads(limits: RoadLimits) -> list[PlannedRoad]:
    """The grid, with speeds and accelerations cut at what the vehicle may do."""
    return [
        PlannedRoad(FAMILY[name], request._replace(speed_mps=min(request.speed_mps, limits.speed_mps)))
        for name, request in _requests(limits.lateral_accel_mps2)
    ]


def _requests(most_mps2: float) -> Iterator[tuple[str, RoadRequest]]:
    for name, speeds, lateral, longitudinal, sides in GRIDS:
        for speed, level, share, left in product(speeds, lateral, longitudinal, sides):
            yield name, RoadRequest(speed, level * most_mps2, share, left)
    for (speed, radius), share in product(ROAD_CLASSES, CLASS_SHARES):
        driven = share * speed
        yield "winding", RoadRequest(driven, min(driven * driven / radius, most_mps2), 0.7)
    for name, radii in (("roundabout", ROUNDABOUT_RADII_M), ("steady_circle", CIRCLE_RADII_M)):
        for radius, level, left in product(radii, LEVELS, SIDES):
            yield name, RoadRequest(math.sqrt(level * most_mps2 * radius), level * most_mps2, 0.7, left)
