"""A car as a learned plant without physics moves it: acceleration and yaw rate are given, the rest is kinematics.

The rear axle does not slip sideways. What the network was not told of comes on top as acceleration: gravity on a grade,
a dragging brake, air and rolling resistance, the mass of a payload. Friction caps acceleration and speed * yaw rate at
friction * g. What cannot be had so is refused when the plant is built.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import GEAR_DRIVE, Actuation, Motion
from tunefree_hil.base.units import AIR_DENSITY_KGPM3, G_MPS2
from tunefree_hil.plant.data_sheet import DEFAULTS as PHYSICS
from tunefree_hil.plant.kinematics import Velocity, moved
from tunefree_hil.plant.types import ChassisInput, filled, more_drag_m2, refuse_changes, rolling_share

FADE_MPS = 0.3  # below it a car turns less and less: one that stands does not turn
PULL_AWAY_MPS2 = 0.1  # what a plant must ask for on level ground before a standing car moves: less is its error
LEAST_MPS = 0.5
KEYS = (
    "mass_kg", "wheelbase_m", "front_axle_m", "friction", "steer_ratio", "wheel_radius_m", "track_m", "rolling_frac",
    "drag_area_m2",
)  # fmt: skip
ABLE = {
    "payload_kg", "friction_frac", "grade_rad", "brake_drag_n", "rolling_extra_frac", "drag_area_m2", "head_wind_mps",
}  # fmt: skip
DEFAULTS: dict[str, float] = {key: PHYSICS[key] for key in (*KEYS, "rest_pedal_frac")}


class Carriage(NamedTuple):
    """Geometry, and what comes on top of the plant's own acceleration."""

    wheel_radius_m: float
    inverse_radius: float
    half_track_m: float
    front_axle_m: float
    rear_axle_m: float
    inverse_wheelbase: float
    inverse_ratio: float
    rest_frac: float
    grip_mps2: float
    grade_rad: float
    drag_mps2: float  # a dragging brake's, and of rolling resistance what is more than the plant's own part
    mass_frac: float  # the car's own mass over its laden one
    own_air_per_m: float  # air drag over mass and speed squared, as the plant knows it
    air_per_m: float  # and as it is
    head_wind_mps: float


def carriage_of(kind: str, defaults: Mapping[str, float], params: Mapping[str, float], change: BodyChange) -> Carriage:
    """[plant.params] over `defaults`, with the body changes. InputError for a key or a change that does not fit."""
    v = filled(defaults, params, kind)
    refuse_changes(kind, change, ABLE)
    mass_kg = v["mass_kg"] + change.payload_kg
    if not mass_kg > 0.0:
        raise InputError(f"{change.payload_kg} kg of payload leave no mass", code="bad_payload", key="payload")
    rolling_mps2 = v["rolling_frac"] * G_MPS2  # what rolls is laden; the plant's own part of it is scaled by the mass
    dynamic = 0.5 * AIR_DENSITY_KGPM3 / mass_kg
    return Carriage(
        wheel_radius_m=v["wheel_radius_m"],
        inverse_radius=1.0 / v["wheel_radius_m"],
        half_track_m=0.5 * v["track_m"],
        front_axle_m=v["front_axle_m"],
        rear_axle_m=v["wheelbase_m"] - v["front_axle_m"],
        inverse_wheelbase=1.0 / v["wheelbase_m"],
        inverse_ratio=1.0 / v["steer_ratio"],
        rest_frac=v["rest_pedal_frac"],
        grip_mps2=v["friction"] * change.friction_frac * G_MPS2,
        grade_rad=change.grade_rad,
        drag_mps2=change.brake_drag_n / mass_kg + rolling_mps2 * (rolling_share(change) - v["mass_kg"] / mass_kg),
        mass_frac=v["mass_kg"] / mass_kg,
        own_air_per_m=dynamic * v["drag_area_m2"],
        air_per_m=dynamic * more_drag_m2(v["drag_area_m2"], change),
        head_wind_mps=change.head_wind_mps,
    )


@kernel
def over_rest(p: Carriage, act: Actuation) -> tuple[float, float]:
    """Throttle and brake duty over rest; out of gear the throttle does nothing."""
    throttle = act.throttle_frac - p.rest_frac
    return throttle if act.gear >= GEAR_DRIVE else 0.0, act.brake_frac - p.rest_frac


@kernel
def driven(
    p: Carriage, motion: Motion, accel_mps2: float, yaw_rate_radps: float, x: ChassisInput, dt_s: float
) -> Motion:
    """The motion a tick later, for an acceleration along level ground and a yaw rate at the tick's end.

    Standing, the car stays until at least PULL_AWAY_MPS2 is asked for; it never rolls back. Out of drive nothing drives
    it, so that it then stays.
    """
    grip = p.grip_mps2 * x.road.friction_frac
    net_mps2 = clamp(accel_mps2 * p.mass_frac, -grip, grip)
    if x.actuation.gear < GEAR_DRIVE and net_mps2 > 0.0:
        net_mps2 = 0.0  # the plant knows its creep only in drive
    slope = G_MPS2 * math.sin(x.road.grade_rad + p.grade_rad)
    air = motion.speed_mps + p.head_wind_mps
    against = p.drag_mps2 + (p.air_per_m * air * abs(air) - p.own_air_per_m * motion.speed_mps * abs(motion.speed_mps))
    speed = motion.speed_mps + dt_s * (net_mps2 - slope - against)
    if speed < 0.0 or (motion.speed_mps <= 0.0 and net_mps2 < PULL_AWAY_MPS2):
        speed = 0.0
    most = grip / max(speed, LEAST_MPS)
    yaw = clamp(yaw_rate_radps, -most, most) * clamp(speed / FADE_MPS, 0.0, 1.0)
    angle = x.actuation.steer_rad * p.inverse_ratio
    velocity = Velocity(speed, p.rear_axle_m * yaw, yaw)
    return moved(p, motion, velocity, (slope, 0.0), (math.cos(angle), math.sin(angle)), dt_s)


@kernel
def said_of(p: Carriage, accel_mps2: float, motion: Motion, x: ChassisInput) -> float:
    """The plant's own acceleration, as it takes it in again a tick later. Gravity, drag and payload are no part of it:
    a network that has always seen its own acceleration go on would go on with them, and they come on top once more.
    """
    grip = p.grip_mps2 * x.road.friction_frac
    return clamp(accel_mps2, -grip, grip) if motion.speed_mps > 0.0 else 0.0


@kernel
def seen_of(own_mps2: float, motion: Motion, seen: Motion) -> float:
    """The same of a measured motion: what came on top in the tick before is taken off."""
    return seen.speed_rate_mps2 + (own_mps2 - motion.speed_rate_mps2)
