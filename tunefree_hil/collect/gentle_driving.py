"""Gentle driving: a speed is reached, held, varied slowly and left again.

The steps and waves of the cells identify the parts of a vehicle, but normal driving is mostly light throttle, coasting
and light braking. An acceleration bias of some 0.01 m/s^2 there is invisible in a step and is metres after 10 s.

Stages of a stretch: REACH its speed, KEEP it, VARY it, COAST, and SLOW down: to rest if straight, to half if curved.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from tunefree_hil.base.maths import clamp
from tunefree_hil.collect.cells import max_planned_speed_mps
from tunefree_hil.collect.envelope import BORDER_M, Envelope, curvature_1pm, steer_for_curvature_rad, turn_back_room_m
from tunefree_hil.collect.pedals import PedalState

REACH, KEEP, VARY, COAST, SLOW = range(5)
SPEED_SHARES = (0.05, 0.1, 0.15, 0.2, 0.275, 0.35, 0.45)  # of the speed limit
HOLD_QUOTA_FACTOR, HOLD_SHARE = 1.5, 0.15  # duration of KEEP and VARY: in quotas, and at most as a share of a drive
MIN_HOLD_S = 5.0  # a shorter hold contains too little information
MAX_STRETCHES_A_DRIVE = 3  # in a drive without missing cells; otherwise one
ACCEL_SHARE = 0.45  # share of the vehicle's acceleration limit: rate of the target speed, up and down
LATERAL_SHARE, LOCK_SHARE = 0.35, 0.4  # shares of lateral acceleration and steering angle in curves
STEER_RATE_SHARE = 0.2
BEND_S = 12.0  # period from left to right and back
VARY_SHARE = 0.15  # share of the speed, once up and down
REACHED_SHARE, REACHED_MPS = 0.05, 0.15
MAX_REACH_S, COAST_S, MAX_SLOW_S = 30.0, 3.0, 15.0
END_SPEED_SHARE = 0.5  # share of the speed at the end of a curved stretch
RESTING_MPS = 0.1
FACING_RAD = 0.4  # heading error to the middle of the area below which it drives straight on
SPEED_GAIN_PER_S = 0.4  # target acceleration per speed error
PUSH_GAIN_PER_S = 0.3  # rate of a pedal per acceleration error, as share of the acceleration limit
MAX_PUSH_RATE_PER_S = 0.15
MAX_THROTTLE_PUSH, MAX_BRAKE_PUSH = 0.6, 0.3  # shares of the pedal travel
TOO_FAST_SHARE, TOO_FAST_MPS = 0.1, 0.6  # excess over the target speed from which the brake is used


class GentleStretch(NamedTuple):
    """A stretch: speed and duration, straight or in curves, duration of coasting. max_mps: limit of the variation."""

    speed_mps: float
    hold_s: float
    is_curved: bool
    coast_s: float = COAST_S
    max_mps: float = math.inf


class GentleState(NamedTuple):
    """State: number of the stretch in this drive, stage, time in the stage, target speed and acceleration.

    push: of the pedals (pedals.py). side: +1 or -1 while it steers back to the middle of the area, else 0.
    """

    number: int = 0
    stage: int = REACH
    time_s: float = 0.0
    target_mps: float = 0.0
    target_accel_mps2: float = 0.0
    push: float = 0.0
    side: float = 0.0


def plan_stretches(
    envelope: Envelope, quota_s: float, drive_s: float, area_m: float, top_mps: float | None
) -> tuple[GentleStretch, ...]:
    """All stretches of a collection: each speed that vehicle and area allow, once straight and once in curves.

    Empty where quota or drive are too short to hold a speed.
    """
    hold_s = min(HOLD_QUOTA_FACTOR * quota_s, HOLD_SHARE * drive_s)
    if hold_s < MIN_HOLD_S:
        return ()
    most = max_planned_speed_mps(envelope, top_mps)
    speeds = [share * envelope.speed_mps for share in SPEED_SHARES]
    fit = [speed for speed in speeds if speed <= most and area_side_for_holding_m(envelope, speed) <= area_m]
    return tuple(GentleStretch(speed, hold_s, (i + turn) % 2 == 1) for turn in range(2) for i, speed in enumerate(fit))


def area_side_for_holding_m(envelope: Envelope, speed_mps: float) -> float:
    """Side of the square area in which a speed can be held: a gentle circle, and the border."""
    return 2.5 / gentle_curvature_1pm(envelope, speed_mps) + 2.0 * BORDER_M


def gentle_curvature_1pm(envelope: Envelope, speed_mps: float) -> float:
    """Largest curvature of gentle driving at a speed."""
    lock = curvature_1pm(envelope, LOCK_SHARE * envelope.steer_rad)
    return min(lock, LATERAL_SHARE * envelope.lateral_mps2 / max(speed_mps * speed_mps, 1e-6))


def begin_gentle(gentle: GentleState, speed_mps: float) -> GentleState:
    """Begin or resume gentle driving at this speed, with both pedals released."""
    return gentle._replace(target_mps=speed_mps, target_accel_mps2=0.0, push=0.0, side=0.0)


def advance_stage(
    gentle: GentleState, stretch: GentleStretch, envelope: Envelope, speed_mps: float, dt_s: float
) -> GentleState:
    """Advance one tick: next stage where due, and the target speed with its rate limit."""
    gentle = gentle._replace(time_s=gentle.time_s + dt_s)
    if _is_stage_over(gentle, stretch, speed_mps):
        last = gentle.stage == SLOW
        number, stage = (gentle.number + 1, REACH) if last else (gentle.number, gentle.stage + 1)
        return gentle._replace(number=number, stage=stage, time_s=0.0, target_accel_mps2=0.0)
    if gentle.stage == COAST:
        return gentle._replace(target_mps=speed_mps, target_accel_mps2=0.0)
    reach = ACCEL_SHARE * envelope.accel_high_mps2 * dt_s
    change = clamp(_aim_speed_mps(gentle, stretch) - gentle.target_mps, -reach, reach)
    return gentle._replace(target_mps=gentle.target_mps + change, target_accel_mps2=change / dt_s)


def _is_stage_over(gentle: GentleState, stretch: GentleStretch, speed_mps: float) -> bool:
    """Whether the current stage has ended."""
    if gentle.stage == REACH:
        near = abs(speed_mps - stretch.speed_mps) < REACHED_SHARE * stretch.speed_mps + REACHED_MPS
        return (near and gentle.target_mps == stretch.speed_mps) or gentle.time_s >= MAX_REACH_S
    if gentle.stage in (KEEP, VARY):
        return gentle.time_s >= 0.5 * stretch.hold_s
    if gentle.stage == COAST:
        return gentle.time_s >= stretch.coast_s or speed_mps <= RESTING_MPS
    return speed_mps <= max(_aim_speed_mps(gentle, stretch), RESTING_MPS) or gentle.time_s >= MAX_SLOW_S


def _aim_speed_mps(gentle: GentleState, stretch: GentleStretch) -> float:
    if gentle.stage == VARY:
        phase = 2.0 * math.pi * gentle.time_s / (0.5 * stretch.hold_s)
        return min(stretch.speed_mps * (1.0 + VARY_SHARE * math.sin(phase)), stretch.max_mps)
    if gentle.stage == SLOW:
        return END_SPEED_SHARE * stretch.speed_mps if stretch.is_curved else 0.0
    return stretch.speed_mps


def update_push(gentle: GentleState, pedals: PedalState, envelope: Envelope, dt_s: float) -> GentleState:
    """Next push of the pedals: slow integral of the acceleration error, from one pedal through rest to the other.

    While a speed is held, the brake is used only where the vehicle is far too fast.
    """
    if gentle.stage == COAST:
        push_rate = -gentle.push / dt_s
    else:
        target_mps2 = gentle.target_accel_mps2 + SPEED_GAIN_PER_S * (gentle.target_mps - pedals.speed_mps)
        if gentle.stage == SLOW:
            target_mps2 = min(target_mps2, -0.5 * ACCEL_SHARE * envelope.accel_high_mps2)
        push_rate = (
            PUSH_GAIN_PER_S * envelope.accel_share * (target_mps2 - pedals.accel_mps2) / envelope.accel_high_mps2
        )
    push = gentle.push + clamp(push_rate, -MAX_PUSH_RATE_PER_S, MAX_PUSH_RATE_PER_S) * dt_s
    fast = pedals.speed_mps - gentle.target_mps > TOO_FAST_SHARE * gentle.target_mps + TOO_FAST_MPS
    low = -MAX_BRAKE_PUSH if fast or gentle.stage == SLOW else min(0.0, gentle.push + MAX_PUSH_RATE_PER_S * dt_s)
    return gentle._replace(push=clamp(push, low, MAX_THROTTLE_PUSH))


def update_return_side(
    gentle: GentleState, envelope: Envelope, speed_mps: float, error_rad: float, room_m: float
) -> GentleState:
    """Begin or end steering back to the middle of the area; begun while a gentle curve still fits ahead.

    Args:
        error_rad: Heading error to the middle.
        room_m: Distance ahead to the inner border.
    """
    if abs(error_rad) < FACING_RAD:
        return gentle._replace(side=0.0)
    needed_m = 1.3 / gentle_curvature_1pm(envelope, speed_mps) + turn_back_room_m(envelope, speed_mps)
    if gentle.side == 0.0 and room_m < needed_m:
        return gentle._replace(side=math.copysign(1.0, error_rad))
    return gentle


def target_angle_rad(
    gentle: GentleState, stretch: GentleStretch, envelope: Envelope, speed_mps: float, drive_s: float
) -> float:
    """Target steering-wheel angle, drive_s after the start of the drive."""
    most = gentle_curvature_1pm(envelope, speed_mps)
    if gentle.side != 0.0:
        return steer_for_curvature_rad(envelope, gentle.side * most)
    if not stretch.is_curved:
        return 0.0
    return steer_for_curvature_rad(envelope, most * math.sin(2.0 * math.pi * drive_s / BEND_S))


def limit_wheel_rate_rad(target_rad: float, last_rad: float, envelope: Envelope, dt_s: float) -> float:
    """Limit the rate from the last command to the target angle."""
    reach = STEER_RATE_SHARE * envelope.steer_rate_radps * dt_s
    return clamp(target_rad, last_rad - reach, last_rad + reach)
