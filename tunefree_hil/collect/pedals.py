"""Pedal feedback control of the acceleration, without a vehicle model or calibration map.

A push is a number from -1 to 1: the share of the travel from rest to the limit of the throttle (> 0) or brake (< 0).
"""

from __future__ import annotations

from typing import NamedTuple

from tunefree_hil.base.maths import clamp
from tunefree_hil.collect.cells import SPEED_BAND_COUNT, CellIndex
from tunefree_hil.collect.envelope import Envelope

THROTTLE_GUESS = 0.35  # throttle for the vehicle's largest acceleration; feedback corrects it
BRAKE_PLAY, BRAKE_GUESS = 0.12, 0.53  # brake travel before it acts, and travel for the largest deceleration
POWER_SHARE = 0.25  # share of the speed limit at which a pedal has half of its force
TRIM_PER_S = 0.25  # integral gain per m/s^2 and second
MAX_TRIM = 0.6
COAST_MPS2 = 0.35  # a smaller deceleration is reached by coasting
HOLD_PUSH = -0.35  # brake at standstill
SMOOTH_S = 0.2  # time constant of the acceleration, which is the filtered rate of the speed

# Pushes of the pedal bands, inside the edges of cells.py with a margin for noise and overshoot
THROTTLE_PUSHES = ((0.025, 0.14), (0.162, 0.224), (0.25, 0.65))
BRAKE_PUSHES = ((0.025, 0.13), (0.155, 0.272))
BRAKE_HARD = 0.31  # lower end of the hardest band; its upper end is adapted while driving
INITIAL_BRAKE_CAP, CAP_PER_S, CAP_BACK_PER_S = 0.42, 0.04, 0.5
MIN_THROTTLE_CAP, THROTTLE_CAP_PER_S = 0.1, 0.01  # lowest throttle limit, and the rate at which it rises again
CAP_GENTLE, CAP_HARSH = 0.55, 0.75  # shares of the largest deceleration


class PedalState(NamedTuple):
    """State of the feedback: integral of the acceleration error, filtered acceleration, limit of the brake.

    throttle_cap: the largest throttle that did not exceed the acceleration limit of the drive.
    """

    trim: float = 0.0
    accel_mps2: float = 0.0
    speed_mps: float = 0.0
    brake_cap: float = INITIAL_BRAKE_CAP
    throttle_cap: float = 1.0


def update_acceleration(pedal: PedalState, speed_mps: float, dt_s: float) -> PedalState:
    """Update the filtered acceleration."""
    rate = (speed_mps - pedal.speed_mps) / dt_s
    accel = pedal.accel_mps2 + (rate - pedal.accel_mps2) * dt_s / (SMOOTH_S + dt_s)
    return pedal._replace(accel_mps2=accel, speed_mps=speed_mps)


def push_for_acceleration(
    pedal: PedalState, envelope: Envelope, accel_mps2: float, dt_s: float
) -> tuple[PedalState, float]:
    """Push for a target acceleration: feedforward plus integral of the error."""
    if -COAST_MPS2 < accel_mps2 <= 0.0:
        return pedal._replace(trim=0.0), 0.0
    if accel_mps2 > 0.0:
        less = 1.0 + pedal.speed_mps / (POWER_SHARE * envelope.speed_mps)  # power limits the force
        guess = min(THROTTLE_GUESS * less * envelope.accel_share * accel_mps2 / envelope.accel_high_mps2, 1.0)
        low, high = 0.0, 1.0
    else:
        guess = -BRAKE_PLAY - BRAKE_GUESS * envelope.decel_share * accel_mps2 / envelope.accel_low_mps2
        low, high = -1.0, -0.02
    trim = pedal.trim if pedal.trim * accel_mps2 > 0.0 or abs(pedal.trim) < 0.15 else 0.0
    trim = clamp(trim + TRIM_PER_S * dt_s * (accel_mps2 - pedal.accel_mps2), -MAX_TRIM, MAX_TRIM)
    trim = clamp(trim, low - guess, high - guess)
    return pedal._replace(trim=trim), guess + trim


def cell_push(index: CellIndex, hold: int, cap: float, wave: float, max_push: float = 1.0) -> float:
    """Push in a cell's pedal band for the hold of this number, with a wave in [-1, 1]; at most `max_push`."""
    pedal = index.pedal
    if pedal == 0:
        gentle = 0.05 if index.speed == SPEED_BAND_COUNT - 1 else 1.0  # a high speed is left quickly when braking
        low, high = BRAKE_HARD, max(min(cap, BRAKE_HARD + gentle), BRAKE_HARD + 0.03)
    elif pedal < 3:
        low, high = BRAKE_PUSHES[2 - pedal]
    else:
        low, high = THROTTLE_PUSHES[pedal - 3]
    if pedal == 5:
        high = low + (high - low) * (0.25, 0.6, 1.0)[hold % 3]
    high = max(low, min(high, max_push))
    push = 0.5 * (low + high) + 0.5 * (high - low) * wave
    return -push if pedal < 3 else push


def min_push(index: CellIndex) -> float:
    """Smallest push of a cell's pedal band, as a positive number."""
    if index.pedal == 0:
        return BRAKE_HARD
    return BRAKE_PUSHES[2 - index.pedal][0] if index.pedal < 3 else THROTTLE_PUSHES[index.pedal - 3][0]


def push_limits(envelope: Envelope, pedal: PedalState) -> tuple[float, float]:
    """Lowest and highest push within the bounds of the drive."""
    return -envelope.max_brake_push, min(envelope.max_throttle_push, pedal.throttle_cap)


def update_push_caps(pedal: PedalState, envelope: Envelope, push: float, dt_s: float) -> PedalState:
    """Adapt the limits of brake and throttle to the measured acceleration."""
    if push > 0.0 and pedal.accel_mps2 > envelope.throttle_release_mps2:
        pedal = pedal._replace(
            throttle_cap=max(MIN_THROTTLE_CAP, min(pedal.throttle_cap, push) - CAP_BACK_PER_S * dt_s)
        )
    elif pedal.throttle_cap < 1.0:
        pedal = pedal._replace(throttle_cap=min(1.0, pedal.throttle_cap + THROTTLE_CAP_PER_S * dt_s))
    if pedal.accel_mps2 < CAP_HARSH * envelope.accel_low_mps2:
        return pedal._replace(brake_cap=max(BRAKE_HARD + 0.03, pedal.brake_cap - CAP_BACK_PER_S * dt_s))
    if push < -BRAKE_HARD and pedal.accel_mps2 > CAP_GENTLE * envelope.accel_low_mps2:
        return pedal._replace(brake_cap=min(0.9, pedal.brake_cap + CAP_PER_S * dt_s))
    return pedal


def pedal_duties(envelope: Envelope, push: float) -> tuple[float, float]:
    """Throttle and brake as duty on the bus; the other pedal is at rest."""
    rest = envelope.rest_frac
    if push >= 0.0:
        return rest + min(push, 1.0) * (envelope.throttle_frac - rest), rest
    return rest, rest + min(-push, 1.0) * (envelope.brake_frac - rest)
