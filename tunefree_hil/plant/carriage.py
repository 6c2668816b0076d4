"""A car as a learned plant without physics moves it: acceleration and yaw rate are given, the rest is kinematics.

The rear axle does not slip sideways. What the network was not told of comes on top as acceleration: gravity on a grade,
a dragging brake, the mass of a payload. Friction caps acceleration and speed * yaw rate at friction * g. What cannot be
had so is refused when the plant is built.
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
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.plant.body import ChassisInput, filled
from tunefree_hil.plant.data_sheet import DEFAULTS as PHYSICS
from tunefree_hil.plant.kinematics import Velocity, moved

FADE_MPS = 0.3  # below it a car turns less and less: one that stands does not turn
PULL_AWAY_MPS2 = 0.1  # what a plant must ask for on level ground before a standing car moves: less is its error
LEAST_MPS = 0.5
KEYS = ("mass_kg", "wheelbase_m", "front_axle_m", "friction", "steer_ratio", "wheel_radius_m", "track_m")
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
    drag_mps2: float  # a dragging brake's
    mass_frac: float  # the car's own mass over its laden one


def carriage_of(kind: str, defaults: Mapping[str, float], params: Mapping[str, float], change: BodyChange) -> Carriage:
    """[plant.params] over `defaults`, with the body changes. InputError for a key or a change that does not fit."""
    v = filled(defaults, params, kind)
    _refuse(kind, change, v["mass_kg"])
    mass_kg = v["mass_kg"] + change.payload_kg
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
        drag_mps2=change.brake_drag_n / mass_kg,
        mass_frac=v["mass_kg"] / mass_kg,
    )


@kernel
def over_rest(p: Carriage, act: Actuation) -> tuple[float, float]:
    """Throttle and brake duty over rest; out of gear the throttle does nothing."""
    throttle = act.throttle_frac - p.rest_frac
    return throttle if act.gear >= GEAR_DRIVE else 0.0, act.brake_frac - p.rest_frac


@kernel
def driven(p: Carriage, was: Motion, accel_mps2: float, yaw_rate_radps: float, x: ChassisInput, dt_s: float) -> Motion:
    """The motion a tick later, for an acceleration along level ground and a yaw rate at the tick's end.

    Standing, the car stays until at least PULL_AWAY_MPS2 is asked for; it never rolls back.
    """
    grip = p.grip_mps2 * x.road.friction_frac
    own = clamp(accel_mps2 * p.mass_frac, -grip, grip)
    slope = G_MPS2 * math.sin(x.road.grade_rad + p.grade_rad)
    speed = was.speed_mps + dt_s * (own - slope - p.drag_mps2)
    if speed < 0.0 or (was.speed_mps <= 0.0 and own < PULL_AWAY_MPS2):
        speed = 0.0
    most = grip / max(speed, LEAST_MPS)
    yaw = clamp(yaw_rate_radps, -most, most) * clamp(speed / FADE_MPS, 0.0, 1.0)
    angle = x.actuation.steer_rad * p.inverse_ratio
    now = Velocity(speed, p.rear_axle_m * yaw, yaw)
    return moved(p, was, now, slope, (math.cos(angle), math.sin(angle)), dt_s)


def _refuse(kind: str, change: BodyChange, mass_kg: float) -> None:
    """InputError for what acceleration alone cannot show."""
    without_physics = {
        "payload.ahead_m": change.payload_moment_kgm != 0.0 or change.payload_inertia_kgm2 != 0.0,
        "power_limit": math.isfinite(change.power_w),
        "brake_fade": change.brake_loss_per_mj != 0.0,
    }
    cannot = [name for name, asked in without_physics.items() if asked]
    if cannot:
        raise InputError(
            f"a plant of kind {kind!r} has no physics that {', '.join(cannot)} could change",
            code="not_in_this_plant",
            key="effects",
            hint="take a model of kind hybrid or physics, or leave the effect out",
        )
    if not mass_kg + change.payload_kg > 0.0:
        raise InputError(f"{change.payload_kg} kg of payload leave no mass", code="bad_payload", key="payload")
