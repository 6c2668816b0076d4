"""Steering of the planner: into a cell's band, towards a point, back into the area; within the envelope."""

from __future__ import annotations

import math
from typing import NamedTuple

from tunefree_hil.base.maths import clamp, wrap_rad
from tunefree_hil.collect.area import Pose, bearing_rad
from tunefree_hil.collect.cells import STRAIGHT, BandEdges, CellSignals, TargetCell
from tunefree_hil.collect.envelope import (
    LATERAL_SHARE,
    RATE_SHARE,
    Envelope,
    curvature_1pm,
    max_curvature_1pm,
    steer_for_curvature_rad,
)

TIGHT_M = 60.0  # cells up to this radius are driven in full circles
TIGHT_CELL_S = 4.0  # shortest useful time in a tight cell whose circle does not fit
STRAIGHT_SHARE = 0.7  # share of the straight band for waves about zero
MARGIN = 1.12  # factor from a band's edge
REVERSAL_RAD = 1.2  # a turn keeps its side while the heading error is larger
EASE_SHARE = 0.85  # share of the envelope's lateral acceleration above which the angle is reduced
EASE_PER_S, EASE_BACK_PER_S = 1.0, 0.1  # rates of reduction and recovery


class WheelState(NamedTuple):
    """Last command; side of a turn; ease: factor on the angle after too much lateral acceleration."""

    steer_rad: float = 0.0
    side: float = 1.0
    ease: float = 1.0


def error_rad(pose: Pose, aim: tuple[float, float]) -> float:
    """Heading error to the aim, positive to the left."""
    return wrap_rad(bearing_rad(pose, *aim) - pose.heading_rad)


def steer_band(bands: BandEdges, signals: CellSignals) -> int:
    """Index of the current steering band (cells.STEER_BANDS)."""
    turn = sum(abs(signals.steer_rad) >= edge for edge in bands.steer_rad)
    return STRAIGHT + turn if signals.steer_rad > 0.0 else STRAIGHT - turn


def angle_in_band_rad(envelope: Envelope, bands: BandEdges, target: TargetCell, speed_mps: float, sway: float) -> float:
    """Angle in a cell's steering band with a wave in [-1, 1], within the limit at this speed."""
    turn = target.index.steer - STRAIGHT
    if turn == 0:
        return STRAIGHT_SHARE * bands.steer_rad[0] * sway
    edges = (*bands.steer_rad, envelope.steer_rad)
    low = edges[abs(turn) - 1] * MARGIN
    bound = steer_for_curvature_rad(envelope, max_curvature_1pm(envelope, speed_mps))
    high = max(low, min(edges[abs(turn)] / MARGIN, bound))
    if abs(turn) == 3:
        high = max(low, min(0.95 * envelope.steer_rad, _max_angle_rad(envelope, speed_mps)))
    angle = 0.5 * (low + high) + 0.5 * (high - low) * sway
    return math.copysign(angle, turn)


def is_tight(curvature: float) -> bool:
    """Whether a cell of this curvature is driven in full circles."""
    return abs(curvature) * TIGHT_M >= 1.0


def turn_back_angle_rad(
    envelope: Envelope, pose: Pose, aim: tuple[float, float], speed_mps: float, side: float
) -> float:
    """Angle of a turn to the chosen side until the aim is ahead."""
    error = error_rad(pose, aim)
    if abs(error) > REVERSAL_RAD:
        error = math.copysign(error, side)
    return angle_towards_rad(envelope, error, speed_mps)


def ease_wheel(envelope: Envelope, wheel: WheelState, lateral_mps2: float, dt_s: float) -> WheelState:
    """Adapt the factor on the angle to the measured lateral acceleration."""
    if abs(lateral_mps2) > EASE_SHARE * envelope.lateral_mps2:
        return wheel._replace(ease=max(0.3, wheel.ease - EASE_PER_S * dt_s))
    return wheel._replace(ease=min(1.0, wheel.ease + EASE_BACK_PER_S * dt_s))


def turn_wheel(envelope: Envelope, wheel: WheelState, target_rad: float, speed_mps: float, dt_s: float) -> WheelState:
    """Next command, limited by speed, `ease` and steering rate."""
    bound = _max_angle_rad(envelope, speed_mps) * wheel.ease
    reach = RATE_SHARE * envelope.steer_rate_radps * dt_s
    wanted = clamp(target_rad, -bound, bound)
    return wheel._replace(steer_rad=clamp(wanted, wheel.steer_rad - reach, wheel.steer_rad + reach))


def angle_towards_rad(envelope: Envelope, error: float, speed_mps: float) -> float:
    """Angle that corrects a heading error in about one second, limited by the speed."""
    most = max_curvature_1pm(envelope, speed_mps)
    return steer_for_curvature_rad(envelope, clamp(error / max(0.9 * speed_mps, 4.0), -most, most))


def _max_angle_rad(envelope: Envelope, speed_mps: float) -> float:
    """Largest angle at a speed, up to nearly the full lock."""
    square = speed_mps * speed_mps
    lock = curvature_1pm(envelope, 0.97 * envelope.steer_rad)
    if square * lock <= LATERAL_SHARE * envelope.lateral_mps2:
        return 0.97 * envelope.steer_rad
    return steer_for_curvature_rad(envelope, LATERAL_SHARE * envelope.lateral_mps2 / square)


def cell_curvature_1pm(envelope: Envelope, bands: BandEdges, target: TargetCell) -> float:
    """Curvature in the middle of a cell's steering and speed band."""
    speed = target.low_mps + 0.5 * (target.high_mps - target.low_mps)
    if target.index.steer == STRAIGHT:
        return 0.0
    return curvature_1pm(envelope, angle_in_band_rad(envelope, bands, target, speed, 0.0))
