"""Forces on the single-track car: drive, creep, brake, slope and air along it, and the side force of an axle."""

from __future__ import annotations

import math
from typing import NamedTuple

from tunefree_hil.base.contracts import LEAST_BRAKE_GAIN
from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import GEAR_DRIVE, GEAR_PARK
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.plant.data_sheet import SingleTrack
from tunefree_hil.plant.types import ChassisInput

GAMMA = 1.0 - math.sqrt(0.5)  # makes ROS2 L-stable
LOW_MPS = 0.5  # the car is kinematic below
PARKED_N = 1.0e6  # holding force of a locked gearbox


class Push(NamedTuple):
    """Forces along the car and from its side, constant for one tick; the drive depends on the speed."""

    drive_n: float  # at standstill
    drive_power_w: float
    creep_n: float
    overrun_n: float  # braking by engine or motor, reduced as the throttle is pressed
    passive_n: float  # brake and rolling: only against the motion
    slope_n: float
    brake_n: float  # the brakes' part of passive_n
    side_n: float  # of wind and bank, to the left
    bank_mps2: float  # gravity to the right, measured by an accelerometer as specific force to the left


@kernel
def push_of(p: SingleTrack, x: ChassisInput, braked_j: float) -> Push:
    """The forces of pedals, gear, road and side wind; braked_j: energy dissipated by the brakes."""
    act, road = x.actuation, x.road
    throttle = clamp((act.throttle_frac - p.throttle_zero_frac) * p.inverse_throttle_span, 0.0, 1.0)
    braked = act.brake_frac - p.rest_frac
    left = 1.0 - p.brake_loss_per_j * braked_j
    gain_n = p.brake_gain_n * (left if left > LEAST_BRAKE_GAIN else LEAST_BRAKE_GAIN)
    brake_n = gain_n * braked * (1.0 + p.brake_rise_per_frac * braked) if braked > 0.0 else 0.0
    grip_n = p.friction * road.friction_frac * p.mass_kg * G_MPS2
    if brake_n > grip_n:
        brake_n = grip_n
    slope_n = p.mass_kg * G_MPS2 * math.sin(road.grade_rad + p.grade_rad)
    fall = math.sin(road.bank_rad + p.bank_rad)
    side_n = p.side_force_n + p.mass_kg * road.side_wind_mps2 - p.mass_kg * G_MPS2 * fall
    bank_mps2 = G_MPS2 * fall
    if act.gear < GEAR_DRIVE:
        held_n = PARKED_N if act.gear == GEAR_PARK else 0.0
        passive_n = brake_n + p.rolling_n + p.brake_drag_n + held_n
        return Push(0.0, 0.0, 0.0, 0.0, passive_n, slope_n, brake_n, side_n, bank_mps2)
    released = math.exp(-throttle * p.inverse_knee)
    drive_n = p.drive_force_n * (1.0 - released)
    if drive_n > 0.5 * grip_n:
        drive_n = 0.5 * grip_n
    passive_n = brake_n + p.rolling_n + p.brake_drag_n
    power_w, overrun_n = p.drive_power_w * throttle, p.overrun_force_n * released
    return Push(drive_n, power_w, p.creep_force_n, overrun_n, passive_n, slope_n, brake_n, side_n, bank_mps2)


@kernel
def yielded(share: float, corner: float) -> float:
    """Divisor of a force of which the power allows 1/share: (1 + share^corner)^(1/corner)."""
    if corner == 2.0:
        return math.sqrt(1.0 + share * share)
    if share <= 0.0:
        return 1.0
    # not 0: the corner is in POSITIVE of plant/constants.py. No power overflows in either branch
    if share <= 1.0:
        return math.exp(math.log(1.0 + math.exp(corner * math.log(share))) / corner)
    return share * math.exp(math.log(1.0 + math.exp(-corner * math.log(share))) / corner)


@kernel
def forward_n(p: SingleTrack, push: Push, speed_mps: float) -> float:
    """Force along the car at a speed, tyre forces of cornering aside.

    Drive: F / (1 + (F v / P)^c)^(1/c), c the drive_corner.
    Creep fades out up to creep_speed_mps; overrun fades in from there, to all of it at twice that speed.
    """
    if p.head_wind_mps != 0.0:
        air_mps = speed_mps + p.head_wind_mps
        drag_n = p.drag_kgpm * air_mps * abs(air_mps)
    else:
        drag_n = p.drag_kgpm * speed_mps * speed_mps
    force_n = -push.passive_n - push.slope_n - drag_n
    if push.drive_n > 0.0:
        asked_w = push.drive_n * speed_mps
        share = asked_w / max(push.drive_power_w, 1.0)
        drive_n = push.drive_n / yielded(share, p.drive_corner)  # not 0: 1 or more
        if drive_n * speed_mps > p.power_w:
            drive_n = p.power_w / speed_mps  # not 0: the power above is not 0
        force_n = force_n + drive_n
    fade = 1.0 - speed_mps * p.inverse_creep_speed
    if fade > 0.0:
        return force_n + push.creep_n * fade
    return force_n - push.overrun_n * (-fade if fade > -1.0 else 1.0)


@kernel
def axle_n(slip_rad: float, stiffness: float, grip_n: float) -> float:
    """Side force of an axle: linear for small slip, grip_n for large."""
    linear_n = stiffness * slip_rad
    share = linear_n / max(grip_n, 1.0)
    return linear_n / math.sqrt(1.0 + share * share)
