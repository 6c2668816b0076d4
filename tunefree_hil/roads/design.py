"""A covering design of requests: every family, every speed and the whole range of accelerations in few roads.

Speeds are drawn one from each of N equal cells between 0 and the top speed (Latin hypercube), and matched with families
that drive there; both accelerations are Latin hypercubes of their own, the most evenly spread of several.
"""

from __future__ import annotations

from collections.abc import Sequence
from random import Random
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.roads.draft import RoadRequest
from tunefree_hil.roads.families import RoadFamily
from tunefree_hil.roads.limits import RoadLimits

LEAST_LATERAL = 0.35  # of the limit
LEAST_LONGITUDINAL = 0.35  # share
SHUFFLES = 20  # pairings of the coordinates that are compared
MAX_COMPARED = 200  # roads; more are spread evenly enough by number
SWAPS_PER_ROAD = 10


class PlannedRoad(NamedTuple):
    """A family and what its road is to ask for."""

    family: RoadFamily
    request: RoadRequest


def plan_roads(families: Sequence[RoadFamily], limits: RoadLimits, count: int, chance: Random) -> list[PlannedRoad]:
    """As many requests, spread over the families and the accelerations that the limits allow.

    Raises:
        InputError: The vehicle is slower than every family.
    """
    usable = [family for family in families if family.low_mps < limits.speed_mps]
    if not usable:
        raise InputError(
            f"no family of roads drives below {limits.speed_mps:g} m/s",
            code="no_roads",
            key="limits.speed_mps",
            hint="name scenarios instead of `roads`",
        )
    members = _deal_families(usable, count, chance)
    speeds = _match_speeds(members, limits.speed_mps, chance)
    shares = _spread(speeds / limits.speed_mps, chance)
    lateral = limits.lateral_accel_mps2 * (LEAST_LATERAL + (1.0 - LEAST_LATERAL) * shares[:, 0])
    longitudinal = LEAST_LONGITUDINAL + (1.0 - LEAST_LONGITUDINAL) * shares[:, 1]
    return [
        PlannedRoad(family, RoadRequest(float(speeds[i]), float(lateral[i]), float(longitudinal[i]), left))
        for i, (family, left) in enumerate(zip(members, _sides(count, chance), strict=True))
    ]


def _deal_families(families: Sequence[RoadFamily], count: int, chance: Random) -> list[RoadFamily]:
    """Every family once before one comes again, in rounds of changing order."""
    dealt: list[RoadFamily] = []
    while len(dealt) < count:
        hand = list(families)
        chance.shuffle(hand)
        dealt += hand
    return dealt[:count]


def _sides(count: int, chance: Random) -> list[bool]:
    """Half of the roads begin to the left."""
    sides = [index % 2 == 0 for index in range(count)]
    chance.shuffle(sides)
    return sides


def _match_speeds(members: Sequence[RoadFamily], top_mps: float, chance: Random) -> np.ndarray:
    """A speed for each road, inside its family's range; as many cells as possible have one.

    Cells are filled from the slowest on, each by the family that ends first (no matching fills more); swaps then mix
    which family drives at which speed.
    """
    count = len(members)
    speeds = [(cell + chance.random()) * top_mps / count for cell in range(count)]
    matched: dict[int, float] = {}
    for speed in speeds:
        fits = [i for i in range(count) if i not in matched and members[i].low_mps <= speed <= members[i].high_mps]
        if fits:
            matched[min(fits, key=lambda i: members[i].high_mps)] = speed
    for i, family in enumerate(members):
        if i not in matched:
            matched[i] = chance.uniform(family.low_mps, min(family.high_mps, top_mps))
    for _ in range(SWAPS_PER_ROAD * count):
        i, j = chance.randrange(count), chance.randrange(count)
        if _drives_at(members[i], matched[j]) and _drives_at(members[j], matched[i]):
            matched[i], matched[j] = matched[j], matched[i]
    return np.array([matched[i] for i in range(count)])


def _drives_at(family: RoadFamily, speed_mps: float) -> bool:
    return family.low_mps <= speed_mps <= family.high_mps


def _spread(speed_share: np.ndarray, chance: Random) -> np.ndarray:
    """Two coordinates of a Latin hypercube, shape (n_roads, 2), the pairing whose closest points are furthest apart."""
    count = len(speed_share)
    best, distance = np.zeros((count, 2)), -1.0
    for _ in range(SHUFFLES if count <= MAX_COMPARED else 1):
        pair = np.array([_latin(count, chance), _latin(count, chance)]).T
        least = _closest(np.column_stack([speed_share, pair])) if count <= MAX_COMPARED else 0.0
        if least > distance:
            best, distance = pair, least
    return best


def _latin(count: int, chance: Random) -> list[float]:
    cells = list(range(count))
    chance.shuffle(cells)
    return [(cell + chance.random()) / count for cell in cells]


def _closest(points: np.ndarray) -> float:
    """Smallest distance of two points."""
    apart = np.sum((points[:, None, :] - points[None, :, :]) ** 2, axis=2)
    return float(np.min(apart + np.eye(len(points)) * 9.0))
