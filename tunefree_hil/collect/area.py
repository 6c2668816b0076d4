"""The driving area: a square with its sides along the axes of the INS. Lengths in m, angles in rad."""

from __future__ import annotations

import math
from typing import NamedTuple

from tunefree_hil.collect.envelope import BORDER_M, WOBBLE_M

CORNER_INSET_M = 25.0  # distance of a target corner from the inner border


class DrivingArea(NamedTuple):
    """Centre and half the side."""

    x_m: float
    y_m: float
    half_m: float


class Pose(NamedTuple):
    """Position of the middle of the rear axle, and heading."""

    x_m: float
    y_m: float
    heading_rad: float


def room_m(area: DrivingArea, pose: Pose) -> float:
    """Distance straight ahead to the inner border (BORDER_M inside the area); negative once it is crossed."""
    inner = area.half_m - BORDER_M
    along = (math.cos(pose.heading_rad), math.sin(pose.heading_rad))
    distances = []
    for direction, offset in zip(along, (pose.x_m - area.x_m, pose.y_m - area.y_m), strict=True):
        if abs(direction) > 1e-9:
            distances.append((math.copysign(inner, direction) - offset) / direction)
        if abs(offset) > inner and offset * direction > 0.0:
            return inner - abs(offset)
    return min(distances)


def is_circle_inside(area: DrivingArea, pose: Pose, curvature_1pm: float) -> bool:
    """Whether the full circle from this pose at this curvature stays inside, with a margin."""
    if abs(curvature_1pm) < 1e-4:
        return False
    radius = 1.0 / curvature_1pm
    x = pose.x_m - radius * math.sin(pose.heading_rad) - area.x_m
    y = pose.y_m + radius * math.cos(pose.heading_rad) - area.y_m
    return max(abs(x), abs(y)) + 1.1 * abs(radius) + WOBBLE_M < area.half_m - BORDER_M


def bearing_rad(pose: Pose, x_m: float, y_m: float) -> float:
    """Direction from the pose's position to a point, not relative to its heading."""
    return math.atan2(y_m - pose.y_m, x_m - pose.x_m)


def farthest_corner(area: DrivingArea, pose: Pose) -> tuple[float, float]:
    """The corner farthest away, CORNER_INSET_M inside the inner border."""
    reach = max(area.half_m - BORDER_M - CORNER_INSET_M, 0.0)
    x = area.x_m + (-reach if pose.x_m > area.x_m else reach)
    y = area.y_m + (-reach if pose.y_m > area.y_m else reach)
    return x, y
