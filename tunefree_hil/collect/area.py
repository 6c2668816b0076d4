"""The bounded area: a square about a centre, its sides along the axes of the INS. Lengths in m, angles in rad."""

from __future__ import annotations

import math
from typing import NamedTuple

from tunefree_hil.collect.envelope import BORDER_M, WOBBLE_M

CORNER_M = 25.0  # corners are aimed at so far inside the border


class Ground(NamedTuple):
    """Centre and half the side."""

    x_m: float
    y_m: float
    half_m: float


class Pose(NamedTuple):
    """Where the rear axle's middle is, and where the vehicle points."""

    x_m: float
    y_m: float
    heading_rad: float


def room_m(ground: Ground, pose: Pose) -> float:
    """Way straight ahead to the inner border (BORDER_M inside the area); negative where it is crossed already."""
    inner = ground.half_m - BORDER_M
    along = (math.cos(pose.heading_rad), math.sin(pose.heading_rad))
    ways = []
    for direction, offset in zip(along, (pose.x_m - ground.x_m, pose.y_m - ground.y_m), strict=True):
        if abs(direction) > 1e-9:
            ways.append((math.copysign(inner, direction) - offset) / direction)
        if abs(offset) > inner and offset * direction > 0.0:
            return inner - abs(offset)
    return min(ways)


def circle_fits(ground: Ground, pose: Pose, curvature_1pm: float) -> bool:
    """Whether the whole circle that is driven from here at this curvature stays inside, with a little to spare."""
    if abs(curvature_1pm) < 1e-4:
        return False
    radius = 1.0 / curvature_1pm
    x = pose.x_m - radius * math.sin(pose.heading_rad) - ground.x_m
    y = pose.y_m + radius * math.cos(pose.heading_rad) - ground.y_m
    return max(abs(x), abs(y)) + 1.1 * abs(radius) + WOBBLE_M < ground.half_m - BORDER_M


def bearing_rad(pose: Pose, x_m: float, y_m: float) -> float:
    """Direction of a point as seen from the pose's place, not relative to its heading."""
    return math.atan2(y_m - pose.y_m, x_m - pose.x_m)


def far_corner(ground: Ground, pose: Pose) -> tuple[float, float]:
    """The corner that is farthest away, CORNER_M inside the border."""
    reach = max(ground.half_m - BORDER_M - CORNER_M, 0.0)
    x = ground.x_m + (-reach if pose.x_m > ground.x_m else reach)
    y = ground.y_m + (-reach if pose.y_m > ground.y_m else reach)
    return x, y
