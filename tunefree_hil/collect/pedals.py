"""Speed by feedback on the pedals alone: no model of the vehicle, no calibration map.

A push is one number, -1 to 1: the share of the way from rest to the limit of the throttle (above 0) or the brake.
"""

from __future__ import annotations

from typing import NamedTuple

from tunefree_hil.base.maths import clamp
from tunefree_hil.collect.cells import SPEEDS, Place
from tunefree_hil.collect.envelope import Envelope

THROTTLE_GUESS = 0.35  # of the throttle's way for the vehicle's greatest acceleration; feedback does the rest
BRAKE_PLAY, BRAKE_GUESS = 0.12, 0.53  # of the brake's way: before it bites, and for the greatest deceleration
POWER_SHARE = 0.25  # of the speed limit: the speed at which half the force is left of a pedal
TRIM_PER_S = 0.25  # per m/s2 of error and second
TRIM_MOST = 0.6
COAST_MPS2 = 0.35  # a weaker deceleration is left to coasting
HOLD_PUSH = -0.35  # stands on the brake
SMOOTH_S = 0.2  # of the acceleration, which is the rate of the speed

# Pushes of the pedal bands: inside the edges of cells.py by a margin for noise and overshoot.
THROTTLE_PUSHES = ((0.025, 0.14), (0.162, 0.224), (0.25, 0.65))
BRAKE_PUSHES = ((0.025, 0.13), (0.155, 0.272))
BRAKE_HARD = 0.31  # least of the hardest band; its most is found while driving
CAP_FIRST, CAP_PER_S, CAP_BACK_PER_S = 0.42, 0.04, 0.5
CALM_LEAST, CALM_PER_S = 0.1, 0.01  # of the throttle's way: so much is never too much; tried again so slowly
CAP_GENTLE, CAP_HARSH = 0.55, 0.75  # of the greatest deceleration


class Pedal(NamedTuple):
    """State of the feedback: integral of the acceleration error, filtered acceleration, how hard braking may get.

    calm: the most throttle that did not quicken the vehicle more than the drive is to.
    """

    trim: float = 0.0
    accel_mps2: float = 0.0
    speed_mps: float = 0.0
    cap: float = CAP_FIRST
    calm: float = 1.0


def felt(pedal: Pedal, speed_mps: float, dt_s: float) -> Pedal:
    """The next filtered acceleration."""
    rate = (speed_mps - pedal.speed_mps) / dt_s
    accel = pedal.accel_mps2 + (rate - pedal.accel_mps2) * dt_s / (SMOOTH_S + dt_s)
    return pedal._replace(accel_mps2=accel, speed_mps=speed_mps)


def push_for(pedal: Pedal, envelope: Envelope, accel_mps2: float, dt_s: float) -> tuple[Pedal, float]:
    """The push that makes this acceleration, by a guess and the integral of the error."""
    if -COAST_MPS2 < accel_mps2 <= 0.0:
        return pedal._replace(trim=0.0), 0.0
    if accel_mps2 > 0.0:
        less = 1.0 + pedal.speed_mps / (POWER_SHARE * envelope.speed_mps)  # power limits the force
        guess = min(THROTTLE_GUESS * less * envelope.high_share * accel_mps2 / envelope.accel_high_mps2, 1.0)
        low, high = 0.0, 1.0
    else:
        guess = -BRAKE_PLAY - BRAKE_GUESS * envelope.low_share * accel_mps2 / envelope.accel_low_mps2
        low, high = -1.0, -0.02
    trim = pedal.trim if pedal.trim * accel_mps2 > 0.0 or abs(pedal.trim) < 0.15 else 0.0
    trim = clamp(trim + TRIM_PER_S * dt_s * (accel_mps2 - pedal.accel_mps2), -TRIM_MOST, TRIM_MOST)
    trim = clamp(trim, low - guess, high - guess)
    return pedal._replace(trim=trim), guess + trim


def level(place: Place, hold: int, cap: float, wave: float, most: float = 1.0) -> float:
    """The push of a cell's pedal band in the hold of this number, with a wave of [-1, 1]; at most `most`."""
    pedal = place.pedal
    if pedal == 0:
        gentle = 0.05 if place.speed == SPEEDS - 1 else 1.0  # a high speed is soon lost
        low, high = BRAKE_HARD, max(min(cap, BRAKE_HARD + gentle), BRAKE_HARD + 0.03)
    elif pedal < 3:
        low, high = BRAKE_PUSHES[2 - pedal]
    else:
        low, high = THROTTLE_PUSHES[pedal - 3]
    if pedal == 5:
        high = low + (high - low) * (0.25, 0.6, 1.0)[hold % 3]
    high = max(low, min(high, most))
    push = 0.5 * (low + high) + 0.5 * (high - low) * wave
    return -push if pedal < 3 else push


def least_push(place: Place) -> float:
    """The least push of a cell's pedal band, whichever pedal it is."""
    if place.pedal == 0:
        return BRAKE_HARD
    return BRAKE_PUSHES[2 - place.pedal][0] if place.pedal < 3 else THROTTLE_PUSHES[place.pedal - 3][0]


def ends(envelope: Envelope, pedal: Pedal) -> tuple[float, float]:
    """(least, most) push that the drive's bounds leave."""
    return -envelope.brake_most, min(envelope.throttle_most, pedal.calm)


def learned_cap(pedal: Pedal, envelope: Envelope, push: float, dt_s: float) -> Pedal:
    """How hard the brake may be pressed: more where it is weak, less where it is strong; and the throttle, calmly."""
    if push > 0.0 and pedal.accel_mps2 > envelope.calm_mps2:
        pedal = pedal._replace(calm=max(CALM_LEAST, min(pedal.calm, push) - CAP_BACK_PER_S * dt_s))
    elif pedal.calm < 1.0:
        pedal = pedal._replace(calm=min(1.0, pedal.calm + CALM_PER_S * dt_s))
    if pedal.accel_mps2 < CAP_HARSH * envelope.accel_low_mps2:
        return pedal._replace(cap=max(BRAKE_HARD + 0.03, pedal.cap - CAP_BACK_PER_S * dt_s))
    if push < -BRAKE_HARD and pedal.accel_mps2 > CAP_GENTLE * envelope.accel_low_mps2:
        return pedal._replace(cap=min(0.9, pedal.cap + CAP_PER_S * dt_s))
    return pedal


def duties(envelope: Envelope, push: float) -> tuple[float, float]:
    """(throttle, brake) as duty on the wire; the pedal that is not pressed rests."""
    rest = envelope.rest_frac
    if push >= 0.0:
        return rest + min(push, 1.0) * (envelope.throttle_frac - rest), rest
    return rest, rest + min(-push, 1.0) * (envelope.brake_frac - rest)
