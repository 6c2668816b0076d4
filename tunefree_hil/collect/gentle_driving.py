"""Gentle stretches: a speed is held, varied slowly and given up again, as a person drives who has nowhere to hurry.

Cells with their steps and waves tell a vehicle's parts apart, but on the road most of the time is spent here: light
throttle, coasting, light braking. A bias of some hundredths of a m/s2 there shows in no step, and is metres after 10 s.

A stretch: REACH its speed, KEEP it, VARY it, COAST, and SLOW down: to rest where it was straight, to half where bent.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from tunefree_hil.base.maths import clamp
from tunefree_hil.collect import steering
from tunefree_hil.collect.area import Ground, Pose
from tunefree_hil.collect.cells import fastest_mps
from tunefree_hil.collect.envelope import BORDER_M, Envelope, curvature_1pm, room_to_turn_m, steer_rad
from tunefree_hil.collect.pedals import Pedal

REACH, KEEP, VARY, COAST, SLOW = range(5)
HELD_SHARES = (0.05, 0.1, 0.15, 0.2, 0.275, 0.35, 0.45)  # of the speed limit
HOLD_QUOTAS, HOLD_SHARE = 1.5, 0.15  # KEEP and VARY together last so many quotas, and at most this share of a drive
LEAST_HOLD_S = 5.0  # less teaches nothing
TOGETHER = 3  # stretches a drive, where it has nothing else to do; otherwise one
ACCEL_SHARE = 0.45  # of the vehicle's greatest acceleration: how fast the wished speed changes, up and down
LATERAL_SHARE, LOCK_SHARE = 0.35, 0.4  # of the limits: how sharply it bends
STEER_RATE_SHARE = 0.2
BEND_S = 12.0  # from left to right and back
VARY_SHARE = 0.15  # of the speed, up and down once
REACHED_SHARE, REACHED_MPS = 0.05, 0.15
REACH_MOST_S, COAST_S, SLOW_MOST_S = 30.0, 3.0, 15.0
LEFT_SHARE = 0.5  # of the speed, at the end of a bent stretch
RESTING_MPS = 0.1
FACING_RAD = 0.4  # from the middle of the area, it goes straight on
PULL_PER_S = 0.4  # of an error in speed
LEARN_PER_S, PUSH_PER_S = 0.3, 0.15  # how fast a pedal follows the error in acceleration, in its greatest; at most
THROTTLE_MOST, BRAKE_MOST = 0.6, 0.3  # of the pedals' ways
TOO_FAST_SHARE, TOO_FAST_MPS = 0.1, 0.6  # over the wished speed before a speed that is held is braked for


class Stretch(NamedTuple):
    """What is driven: at which speed, for how long, straight or from side to side, and how long it coasts then.

    most_mps: the speed that is not varied beyond.
    """

    speed_mps: float
    hold_s: float
    bent: bool
    coast_s: float = COAST_S
    most_mps: float = math.inf


class Gait(NamedTuple):
    """Where it stands: number of the stretch in the drive's own, stage, time in it, and the speed wished for now.

    push: of the pedals (pedals.py). side: +1 or -1 while it bends back to the middle of the area, else 0.
    """

    number: int = 0
    stage: int = REACH
    time_s: float = 0.0
    wish_mps: float = 0.0
    slope_mps2: float = 0.0
    push: float = 0.0
    side: float = 0.0


def stretches_of(
    envelope: Envelope, quota_s: float, drive_s: float, area_m: float, top_mps: float | None
) -> tuple[Stretch, ...]:
    """All stretches of a collection: each speed that the vehicle and the area allow, once straight and once bent.

    None where so small a quota or so short a drive leaves too little time to hold a speed.
    """
    hold_s = min(HOLD_QUOTAS * quota_s, HOLD_SHARE * drive_s)
    if hold_s < LEAST_HOLD_S:
        return ()
    most = fastest_mps(envelope, top_mps)
    speeds = [share * envelope.speed_mps for share in HELD_SHARES]
    fit = [speed for speed in speeds if speed <= most and side_needed_m(envelope, speed) <= area_m]
    return tuple(Stretch(speed, hold_s, (i + turn) % 2 == 1) for turn in range(2) for i, speed in enumerate(fit))


def side_needed_m(envelope: Envelope, speed_mps: float) -> float:
    """Side of the square area in which a speed can be held: a circle of gentle bend, and the border."""
    return 2.5 / bend_1pm(envelope, speed_mps) + 2.0 * BORDER_M


def bend_1pm(envelope: Envelope, speed_mps: float) -> float:
    """The greatest curvature that is bent at a speed."""
    lock = curvature_1pm(envelope, LOCK_SHARE * envelope.steer_rad)
    return min(lock, LATERAL_SHARE * envelope.lateral_mps2 / max(speed_mps * speed_mps, 1e-6))


def taken_up(gait: Gait, speed_mps: float) -> Gait:
    """Gentle driving begins, or goes on after turning back, at this speed and with both pedals at rest."""
    return gait._replace(wish_mps=speed_mps, slope_mps2=0.0, push=0.0, side=0.0)


def gone_on(gait: Gait, stretch: Stretch, envelope: Envelope, speed_mps: float, dt_s: float) -> Gait:
    """A tick later: the stage, and the wished speed, which changes no faster than gently."""
    gait = gait._replace(time_s=gait.time_s + dt_s)
    if _is_over(gait, stretch, speed_mps):
        last = gait.stage == SLOW
        number, stage = (gait.number + 1, REACH) if last else (gait.number, gait.stage + 1)
        return gait._replace(number=number, stage=stage, time_s=0.0, slope_mps2=0.0)
    if gait.stage == COAST:
        return gait._replace(wish_mps=speed_mps, slope_mps2=0.0)
    reach = ACCEL_SHARE * envelope.accel_high_mps2 * dt_s
    change = clamp(_aimed_mps(gait, stretch) - gait.wish_mps, -reach, reach)
    return gait._replace(wish_mps=gait.wish_mps + change, slope_mps2=change / dt_s)


def _is_over(gait: Gait, stretch: Stretch, speed_mps: float) -> bool:
    """Whether the stage has come to its end."""
    if gait.stage == REACH:
        near = abs(speed_mps - stretch.speed_mps) < REACHED_SHARE * stretch.speed_mps + REACHED_MPS
        return (near and gait.wish_mps == stretch.speed_mps) or gait.time_s >= REACH_MOST_S
    if gait.stage in (KEEP, VARY):
        return gait.time_s >= 0.5 * stretch.hold_s
    if gait.stage == COAST:
        return gait.time_s >= stretch.coast_s or speed_mps <= RESTING_MPS
    return speed_mps <= max(_aimed_mps(gait, stretch), RESTING_MPS) or gait.time_s >= SLOW_MOST_S


def _aimed_mps(gait: Gait, stretch: Stretch) -> float:
    if gait.stage == VARY:
        phase = 2.0 * math.pi * gait.time_s / (0.5 * stretch.hold_s)
        return min(stretch.speed_mps * (1.0 + VARY_SHARE * math.sin(phase)), stretch.most_mps)
    if gait.stage == SLOW:
        return LEFT_SHARE * stretch.speed_mps if stretch.bent else 0.0
    return stretch.speed_mps


def pushed(gait: Gait, pedal: Pedal, envelope: Envelope, dt_s: float) -> Gait:
    """The next push of the pedals: it follows the error in acceleration slowly, through rest from one to the other.

    A speed that is held is not braked for unless it is far too fast: the foot comes off the throttle.
    """
    if gait.stage == COAST:
        wanted = -gait.push / dt_s
    else:
        wish = gait.slope_mps2 + PULL_PER_S * (gait.wish_mps - pedal.speed_mps)
        if gait.stage == SLOW:
            wish = min(wish, -0.5 * ACCEL_SHARE * envelope.accel_high_mps2)
        wanted = LEARN_PER_S * envelope.high_share * (wish - pedal.accel_mps2) / envelope.accel_high_mps2
    push = gait.push + clamp(wanted, -PUSH_PER_S, PUSH_PER_S) * dt_s
    fast = pedal.speed_mps - gait.wish_mps > TOO_FAST_SHARE * gait.wish_mps + TOO_FAST_MPS
    low = -BRAKE_MOST if fast or gait.stage == SLOW else min(0.0, gait.push + PUSH_PER_S * dt_s)
    return gait._replace(push=clamp(push, low, THROTTLE_MOST))


def bent_back(gait: Gait, envelope: Envelope, ground: Ground, pose: Pose, speed_mps: float, room_m: float) -> Gait:
    """Whether it bends to the middle of the area: begun where a gentle bend still fits before turning back does not."""
    error = steering.error_rad(pose, (ground.x_m, ground.y_m))
    if abs(error) < FACING_RAD:
        return gait._replace(side=0.0)
    if gait.side == 0.0 and room_m < 1.3 / bend_1pm(envelope, speed_mps) + room_to_turn_m(envelope, speed_mps):
        return gait._replace(side=math.copysign(1.0, error))
    return gait


def angle_rad(gait: Gait, stretch: Stretch, envelope: Envelope, speed_mps: float, drive_s: float) -> float:
    """The steering-wheel angle wished for, drive_s after the drive began."""
    most = bend_1pm(envelope, speed_mps)
    if gait.side != 0.0:
        return steer_rad(envelope, gait.side * most)
    return steer_rad(envelope, most * math.sin(2.0 * math.pi * drive_s / BEND_S)) if stretch.bent else 0.0


def calm_rad(wish_rad: float, last_rad: float, envelope: Envelope, dt_s: float) -> float:
    """The wish, approached from the last command no faster than a calm hand turns the wheel."""
    reach = STEER_RATE_SHARE * envelope.steer_rate_radps * dt_s
    return clamp(wish_rad, last_rad - reach, last_rad + reach)
