"""Constants of the single-track car: those of the data sheet, and those derived for the step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.units import AIR_DENSITY_KGPM3, G_MPS2
from tunefree_hil.plant.types import filled, laden, more_drag_m2, rolling_share

DEFAULTS: dict[str, float] = {
    "mass_kg": 2080.0,
    "wheelbase_m": 2.8448,
    "front_axle_m": 1.4224,
    "yaw_inertia_kgm2": 4208.3,
    "front_stiffness_n_per_rad": 155494.663,
    "rear_stiffness_n_per_rad": 155494.663,
    "friction": 0.9,
    "steer_ratio": 16.0,
    "linkage_bend": 0.0,  # share of the road-wheel angle that is lost, per square of the angle
    "wheel_radius_m": 0.335,
    "track_m": 1.5824,
    "rest_pedal_frac": 0.15,
    "throttle_zero_frac": 0.165,  # duty at which the drive force begins (docs/reference/by_wire.md)
    "throttle_full_frac": 0.80,
    "drive_force_n": 6500.0,  # at full throttle, standing
    "drive_knee_frac": 0.12,  # throttle share that gives 63 % of it
    "drive_power_w": 94.0e3,  # at full throttle
    "drive_corner": 2.0,  # sharpness of the change from constant force to constant power: 2 smooth, 20 abrupt
    "creep_force_n": 1000.0,
    "creep_speed_mps": 2.0,  # above it there is no creep
    "overrun_force_n": 0.0,  # braking by engine or motor with the pedal at rest, above twice creep_speed_mps
    "brake_force_n_per_frac": 56.6e3,  # 3412 Nm over 0.18 duty at the wheel radius, smoothed
    "brake_rise_per_frac": 0.0,  # share of the brake force beyond proportional, per duty from rest
    "rolling_frac": 0.012,
    "drag_area_m2": 0.70,
}


class SingleTrack(NamedTuple):
    """Constants as the step uses them, laden; with inverses."""

    mass_kg: float
    inverse_mass: float
    inverse_inertia: float
    front_axle_m: float
    rear_axle_m: float
    inverse_wheelbase: float
    front_stiffness: float
    rear_stiffness: float
    front_load_n: float
    rear_load_n: float
    friction: float
    inverse_ratio: float
    linkage_bend: float
    wheel_radius_m: float
    inverse_radius: float
    half_track_m: float
    rest_frac: float
    throttle_zero_frac: float
    inverse_throttle_span: float
    drive_force_n: float
    inverse_knee: float
    drive_power_w: float
    drive_corner: float
    creep_force_n: float
    inverse_creep_speed: float
    overrun_force_n: float
    brake_gain_n: float
    brake_rise_per_frac: float
    rolling_n: float
    drag_kgpm: float
    grade_rad: float
    power_w: float  # inf: the drive's own limit only
    brake_drag_n: float
    brake_loss_per_j: float
    head_wind_mps: float
    side_force_n: float  # of wind, to the left
    bank_rad: float
    relaxation_m: float  # 0: the side force follows the slip without lag


def constants_of(params: Mapping[str, float], change: BodyChange) -> SingleTrack:
    """[plant.params] over DEFAULTS, with the body changes applied."""
    v = filled(DEFAULTS, params, "physics")
    car = laden(v["mass_kg"], v["wheelbase_m"], v["front_axle_m"], v["yaw_inertia_kgm2"], change)
    weight_n = car.mass_kg * G_MPS2
    return SingleTrack(
        mass_kg=car.mass_kg,
        inverse_mass=1.0 / car.mass_kg,
        inverse_inertia=1.0 / car.yaw_inertia_kgm2,
        front_axle_m=car.front_axle_m,
        rear_axle_m=car.rear_axle_m,
        inverse_wheelbase=1.0 / v["wheelbase_m"],
        front_stiffness=v["front_stiffness_n_per_rad"] * change.front_stiffness_frac,
        rear_stiffness=v["rear_stiffness_n_per_rad"] * change.rear_stiffness_frac,
        front_load_n=weight_n * car.rear_axle_m / v["wheelbase_m"],
        rear_load_n=weight_n * car.front_axle_m / v["wheelbase_m"],
        friction=v["friction"] * change.friction_frac,
        inverse_ratio=1.0 / v["steer_ratio"],
        linkage_bend=v["linkage_bend"],
        wheel_radius_m=v["wheel_radius_m"],
        inverse_radius=1.0 / v["wheel_radius_m"],
        half_track_m=0.5 * v["track_m"],
        rest_frac=v["rest_pedal_frac"],
        throttle_zero_frac=v["throttle_zero_frac"],
        inverse_throttle_span=1.0 / (v["throttle_full_frac"] - v["throttle_zero_frac"]),
        drive_force_n=v["drive_force_n"],
        inverse_knee=1.0 / v["drive_knee_frac"],
        drive_power_w=v["drive_power_w"],
        drive_corner=v["drive_corner"],
        creep_force_n=v["creep_force_n"],
        inverse_creep_speed=1.0 / v["creep_speed_mps"],
        overrun_force_n=v["overrun_force_n"],
        brake_gain_n=v["brake_force_n_per_frac"],
        brake_rise_per_frac=v["brake_rise_per_frac"],
        rolling_n=v["rolling_frac"] * weight_n * rolling_share(change),
        drag_kgpm=0.5 * AIR_DENSITY_KGPM3 * more_drag_m2(v["drag_area_m2"], change),
        grade_rad=change.grade_rad,
        power_w=change.power_w,
        brake_drag_n=change.brake_drag_n,
        brake_loss_per_j=1e-6 * change.brake_loss_per_mj,
        head_wind_mps=change.head_wind_mps,
        side_force_n=change.side_force_n,
        bank_rad=change.bank_rad,
        relaxation_m=change.relaxation_m,
    )
