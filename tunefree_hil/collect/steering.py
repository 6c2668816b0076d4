"""Where the planner turns the wheel: into a cell's band, towards a point, back into the area; always within bounds."""

from __future__ import annotations

import math
from typing import NamedTuple

from tunefree_hil.base.maths import clamp, wrap_rad
from tunefree_hil.collect.area import Ground, Pose, bearing_rad, circle_fits, room_m
from tunefree_hil.collect.cells import STRAIGHT, Bands, Seen, Target
from tunefree_hil.collect.envelope import (
    LATERAL_SHARE,
    RATE_SHARE,
    Envelope,
    curvature_1pm,
    room_to_turn_m,
    sharpest_1pm,
    steer_rad,
)

TIGHT_M = 60.0  # circles up to this radius are driven whole
WHILE_S = 4.0  # of driving a tight cell that turning back will cut short
STRAIGHT_SHARE = 0.7  # of the straight band, for waves about zero
MARGIN = 1.12  # from a band's edge
REVERSAL_RAD = 1.2  # a turn keeps its side while the aim is farther round than this
EASE_SHARE, EASE_PER_S, EASE_BACK_PER_S = 0.85, 1.0, 0.1  # of the envelope's lateral acceleration


class Wheel(NamedTuple):
    """The last command; the side to which a turn goes; ease: what is left of the angle after it felt too much."""

    steer_rad: float = 0.0
    side: float = 1.0
    ease: float = 1.0


def error_rad(pose: Pose, aim: tuple[float, float]) -> float:
    """How far to the left of the heading the aim is."""
    return wrap_rad(bearing_rad(pose, *aim) - pose.heading_rad)


def band_of(bands: Bands, seen: Seen) -> int:
    """Index of the steering band (cells.STEERS) that is driven now."""
    turn = sum(abs(seen.steer_rad) >= edge for edge in bands.steer_rad)
    return STRAIGHT + turn if seen.steer_rad > 0.0 else STRAIGHT - turn


def in_band(envelope: Envelope, bands: Bands, target: Target, speed_mps: float, sway: float) -> float:
    """The angle for a target's steering band with a wave of [-1, 1] laid over it, within the bound of the speed."""
    turn = target.place.steer - STRAIGHT
    if turn == 0:
        return STRAIGHT_SHARE * bands.steer_rad[0] * sway
    edges = (*bands.steer_rad, envelope.steer_rad)
    low = edges[abs(turn) - 1] * MARGIN
    bound = steer_rad(envelope, sharpest_1pm(envelope, speed_mps))
    high = max(low, min(edges[abs(turn)] / MARGIN, bound))
    if abs(turn) == 3:
        high = max(low, min(0.95 * envelope.steer_rad, _bound_rad(envelope, speed_mps)))
    angle = 0.5 * (low + high) + 0.5 * (high - low) * sway
    return math.copysign(angle, turn)


def has_place(
    envelope: Envelope, bands: Bands, target: Target, ground: Ground | None, pose: Pose, speed_mps: float
) -> bool:
    """Whether a cell can be driven from here: a tight one needs its whole circle inside, or room for a while."""
    bend = _bend(envelope, bands, target)
    if ground is None or abs(bend) * TIGHT_M < 1.0 or circle_fits(ground, pose, bend):
        return True
    return room_m(ground, pose) > room_to_turn_m(envelope, speed_mps) + WHILE_S * speed_mps


def approach(
    envelope: Envelope,
    bands: Bands,
    target: Target,
    ground: Ground | None,
    pose: Pose,
    aim: tuple[float, float],
    speed_mps: float,
) -> float:
    """While the speed is not there yet: round the circle of a tight cell, to the middle for want of place, else on."""
    if abs(_bend(envelope, bands, target)) * TIGHT_M >= 1.0 and ground is not None:
        if has_place(envelope, bands, target, ground, pose, speed_mps):
            return in_band(envelope, bands, target, speed_mps, 0.0)
        aim = (ground.x_m, ground.y_m)
    return _towards(envelope, error_rad(pose, aim), speed_mps)


def turn_back(envelope: Envelope, pose: Pose, aim: tuple[float, float], speed_mps: float, side: float) -> float:
    """As tight as the speed allows to the chosen side, until the aim is ahead."""
    error = error_rad(pose, aim)
    if abs(error) > REVERSAL_RAD:
        error = math.copysign(error, side)
    return _towards(envelope, error, speed_mps)


def turned(
    envelope: Envelope, wheel: Wheel, wish_rad: float, speed_mps: float, lateral_mps2: float, dt_s: float
) -> Wheel:
    """The next command: within what the speed allows and what is felt, and no faster than the wheel may turn."""
    if abs(lateral_mps2) > EASE_SHARE * envelope.lateral_mps2:
        ease = max(0.3, wheel.ease - EASE_PER_S * dt_s)
    else:
        ease = min(1.0, wheel.ease + EASE_BACK_PER_S * dt_s)
    bound = _bound_rad(envelope, speed_mps) * ease
    reach = RATE_SHARE * envelope.steer_rate_radps * dt_s
    wanted = clamp(wish_rad, -bound, bound)
    return wheel._replace(steer_rad=clamp(wanted, wheel.steer_rad - reach, wheel.steer_rad + reach), ease=ease)


def _towards(envelope: Envelope, error: float, speed_mps: float) -> float:
    """Turn the heading by `error`: in about a second, as far as the speed allows."""
    most = sharpest_1pm(envelope, speed_mps)
    return steer_rad(envelope, clamp(error / max(0.9 * speed_mps, 4.0), -most, most))


def _bound_rad(envelope: Envelope, speed_mps: float) -> float:
    """The most steering at a speed, the whole lock included."""
    square = speed_mps * speed_mps
    lock = curvature_1pm(envelope, 0.97 * envelope.steer_rad)
    if square * lock <= LATERAL_SHARE * envelope.lateral_mps2:
        return 0.97 * envelope.steer_rad
    return steer_rad(envelope, LATERAL_SHARE * envelope.lateral_mps2 / square)


def _bend(envelope: Envelope, bands: Bands, target: Target) -> float:
    """Curvature in the middle of a target's band at its slower speeds."""
    speed = target.low_mps + 0.5 * (target.high_mps - target.low_mps)
    if target.place.steer == STRAIGHT:
        return 0.0
    return curvature_1pm(envelope, in_band(envelope, bands, target, speed, 0.0))
