"""Motion of a car from the acceleration and the yaw rate of a learned plant without physics.

The rear axle does not slip sideways. Quantities that are no input of the network are added as accelerations: gravity on
a grade, a dragging brake, air and rolling resistance, the mass of a payload. Friction limits acceleration and
speed * yaw rate to friction * g. Other changes are refused when the plant is built. A road's bank is felt by the
accelerometer and its side wind is not: the axle holds against both, and the path stays as it is.
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

FADE_MPS = 0.3  # below it the yaw rate fades to 0 at standstill
PULL_AWAY_MPS2 = 0.1  # on level ground a standing car moves from this acceleration on; less is network error
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
    """Geometry, and the terms that are added to the plant's own acceleration."""

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
    drag_mps2: float  # of a dragging brake, and of rolling resistance beyond the plant's own
    mass_frac: float  # unladen mass over laden mass
    own_air_per_m: float  # air drag over mass and speed squared, contained in the plant
    air_per_m: float  # the actual one
    head_wind_mps: float


def carriage_of(kind: str, defaults: Mapping[str, float], params: Mapping[str, float], change: BodyChange) -> Carriage:
    """[plant.params] over `defaults`, with the body changes. InputError for an unknown key or an unsupported change."""
    v = filled(defaults, params, kind)
    refuse_changes(kind, change, ABLE)
    mass_kg = v["mass_kg"] + change.payload_kg
    if not mass_kg > 0.0:
        raise InputError(f"{change.payload_kg} kg of payload leave no mass", code="bad_payload", key="payload")
    rolling_mps2 = v["rolling_frac"] * G_MPS2  # of the laden car; the plant's own part is scaled by the mass
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
    """Throttle and brake duty over rest; out of gear the throttle has no effect."""
    throttle = act.throttle_frac - p.rest_frac
    return throttle if act.gear >= GEAR_DRIVE else 0.0, act.brake_frac - p.rest_frac


@kernel
def driven(
    p: Carriage, motion: Motion, accel_mps2: float, yaw_rate_radps: float, x: ChassisInput, dt_s: float
) -> Motion:
    """The motion a tick later, for an acceleration on level ground and a yaw rate at the end of the tick.

    A standing car starts at PULL_AWAY_MPS2; it never rolls back. Out of drive it has no drive force and stays.
    """
    grip = p.grip_mps2 * x.road.friction_frac
    net_mps2 = clamp(accel_mps2 * p.mass_frac, -grip, grip)
    if x.actuation.gear < GEAR_DRIVE and net_mps2 > 0.0:
        net_mps2 = 0.0  # the plant contains creep in drive only
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
    gravity_mps2 = (slope, G_MPS2 * math.sin(x.road.bank_rad))
    return moved(p, motion, velocity, gravity_mps2, (math.cos(angle), math.sin(angle)), dt_s)


@kernel
def own_accel(p: Carriage, accel_mps2: float, motion: Motion, x: ChassisInput) -> float:
    """The plant's own acceleration, its input a tick later. Gravity, drag and payload are not part of it, or the
    network would continue them and they would be counted twice.
    """
    grip = p.grip_mps2 * x.road.friction_frac
    return clamp(accel_mps2, -grip, grip) if motion.speed_mps > 0.0 else 0.0


@kernel
def measured_own_accel(own_mps2: float, motion: Motion, measured: Motion) -> float:
    """The same for a measured motion: without the terms added in the tick before."""
    return measured.speed_rate_mps2 + (own_mps2 - motion.speed_rate_mps2)
