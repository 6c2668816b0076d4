"""Constants of the reference vehicle: published values, and plausible ones where there are none."""

from __future__ import annotations

from collections.abc import Mapping

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.units import AIR_DENSITY_KGPM3, G_MPS2
from tunefree_hil.plant.reference_vehicle import actuators
from tunefree_hil.plant.reference_vehicle.maps import MapShape, maps_of
from tunefree_hil.plant.reference_vehicle.tyres import Chassis, static_loads_n
from tunefree_hil.plant.types import filled, laden, more_drag_m2, rolling_share

DEFAULTS: dict[str, float] = {
    **actuators.DEFAULTS,
    "mass_kg": 1736.35,  # by-wire kit; below, numbers without a source are plausible for a car of this size
    "wheelbase_m": 2.8498,
    "front_axle_m": 1.27,
    "yaw_inertia_kgm2": 3050.0,
    "track_m": 1.5824,
    "height_m": 0.55,
    "roll_front_frac": 0.58,
    "front_stiffness_n_per_rad": 118.0e3,
    "rear_stiffness_n_per_rad": 152.0e3,
    "friction": 0.95,
    "relaxation_m": 0.45,
    "hold_s": 0.05,
    "compliance_rad_per_n": 8.0e-7,
    "steer_ratio": 16.0,
    "wheel_radius_m": 0.335,
    "slip_stiffness_n": 8.0e4,
    "body_lag_s": 0.12,
    "drive_lag_s": 0.18,
    "hysteresis_frac": 0.008,  # of the brake pedal, duty of the published tables
    "drive_front_frac": 1.0,
    "brake_front_frac": 0.65,
    # The published tables (maps.py) adapted to another vehicle: table duty per own duty, factors on forces
    "throttle_scale": 1.0,
    "brake_scale": 1.0,
    "drive_gain": 1.0,
    "idle_gain": 1.0,
    "brake_gain": 1.0,
    "brake_servo": 0.0,
    "shift_gain": 1.0,
    "rolling_frac": 0.010,
    "drag_area_m2": 0.70,
}


def constants_of(params: Mapping[str, float], change: BodyChange) -> Chassis:
    """[plant.params] over DEFAULTS, with the body changes applied."""
    v = filled(DEFAULTS, params, "reference")
    car = laden(v["mass_kg"], v["wheelbase_m"], v["front_axle_m"], v["yaw_inertia_kgm2"], change)
    front_n, rear_n = static_loads_n(car.mass_kg, car.front_axle_m, v["wheelbase_m"])
    drag_kgpm = 0.5 * AIR_DENSITY_KGPM3 * more_drag_m2(v["drag_area_m2"], change)
    nominal_front_n, nominal_rear_n = static_loads_n(v["mass_kg"], v["front_axle_m"], v["wheelbase_m"])
    return Chassis(
        mass_kg=car.mass_kg,
        inverse_mass=1.0 / car.mass_kg,
        inverse_inertia=1.0 / car.yaw_inertia_kgm2,
        front_axle_m=car.front_axle_m,
        rear_axle_m=car.rear_axle_m,
        wheelbase_m=v["wheelbase_m"],
        half_track_m=0.5 * v["track_m"],
        height_m=v["height_m"],
        roll_front_frac=v["roll_front_frac"],
        front_stiffness=0.5 * v["front_stiffness_n_per_rad"] * change.front_stiffness_frac,
        rear_stiffness=0.5 * v["rear_stiffness_n_per_rad"] * change.rear_stiffness_frac,
        front_load_n=front_n,
        rear_load_n=rear_n,
        nominal_front_n=nominal_front_n,
        nominal_rear_n=nominal_rear_n,
        friction=v["friction"] * change.friction_frac,
        inverse_relaxation=1.0 / (v["relaxation_m"] + change.relaxation_m),
        hold_s=v["hold_s"],
        compliance=v["compliance_rad_per_n"],
        inverse_ratio=1.0 / v["steer_ratio"],
        wheel_radius_m=v["wheel_radius_m"],
        inverse_radius=1.0 / v["wheel_radius_m"],
        inverse_slip=1.0 / v["slip_stiffness_n"],
        body_lag_s=v["body_lag_s"],
        drive_lag_s=v["drive_lag_s"],
        drive_front_frac=v["drive_front_frac"],
        brake_front_frac=v["brake_front_frac"],
        hysteresis_frac=v["hysteresis_frac"],
        rest_frac=v["rest_pedal_frac"],
        throttle_scale=v["throttle_scale"],
        brake_scale=v["brake_scale"],
        shift_gain=v["shift_gain"],
        rolling_n=v["rolling_frac"] * car.mass_kg * G_MPS2 * rolling_share(change),
        drag_kgpm=drag_kgpm,
        grade_rad=change.grade_rad,
        power_w=change.power_w,
        brake_drag_n=change.brake_drag_n,
        brake_loss_per_j=1e-6 * change.brake_loss_per_mj,
        head_wind_mps=change.head_wind_mps,
        wind_n=drag_kgpm * change.head_wind_mps * abs(change.head_wind_mps),
        side_force_n=change.side_force_n,
        side_wind_mps2=change.side_force_n / car.mass_kg,
        bank_rad=change.bank_rad,
        maps=maps_of(
            v["rolling_frac"],
            v["drag_area_m2"],
            v["wheel_radius_m"],
            MapShape(*(v[name] for name in MapShape._fields)),
        ),
    )
