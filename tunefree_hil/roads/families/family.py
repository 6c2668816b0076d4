"""A family of roads: its name, the speeds of its manoeuvre, and the function that makes one."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import NamedTuple

from tunefree_hil.roads.draft import RoadDraft, RoadRequest
from tunefree_hil.roads.limits import RoadLimits

STEER_RESERVE = 0.95  # of the lateral acceleration that the steering range allows at low speed
LEAD_S = (1.5, 2.5)  # straight on before the manoeuvre: a start beside the road has settled in part
TAIL_S = 2.5  # straight on after it: what rings on is seen

Build = Callable[[RoadRequest, RoadLimits, Random], RoadDraft]


class RoadFamily(NamedTuple):
    """One kind of manoeuvre.

    Attributes:
        name: Begins the names of its roads.
        low_mps: Lowest speed of the manoeuvre.
        high_mps: Highest speed of the manoeuvre, before the vehicle's limits.
        build: Makes a road from a request, the vehicle's limits and a source of chance.
    """

    name: str
    low_mps: float
    high_mps: float
    build: Build


def usable_lateral_mps2(request: RoadRequest, limits: RoadLimits) -> float:
    """The requested lateral acceleration, or what the steering range allows at the speed."""
    return min(request.lateral_accel_mps2, STEER_RESERVE * limits.lateral_at_mps2(request.speed_mps))
