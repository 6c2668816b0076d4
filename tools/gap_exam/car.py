"""Cars that nobody has met: drawn from a seed, with what their data sheets say of them, a few percent off."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

G_MPS2 = 9.81
AIR_KGPM3 = 1.2
FULL_MISMATCH = 0.05  # at which the awkward parts below have the size of a real car's


class Car(NamedTuple):
    """One car. Stiffness per wheel; pedals as duty above rest, forces in N; times in s; lengths in m."""

    mass_kg: float
    wheelbase_m: float
    front_m: float  # centre of mass to front axle
    inertia_kgm2: float
    half_track_m: float
    wheel_radius_m: float
    front_stiffness: float
    rear_stiffness: float
    friction: float
    tyre_form: float  # q of sin(q atan(z / q))
    drag_area_m2: float
    rolling_frac: float
    steer_ratio: float
    drive_n: float  # at full throttle, standing
    drive_bend: float  # c of (1 + c) t / (t + c)
    drive_w: float
    throttle_zero: float  # duty above rest at which the engine begins to answer
    throttle_full: float
    creep_n: float
    creep_mps: float
    brake_n: float  # per duty
    rest_frac: float
    transport_s: float  # command frame to by-wire unit
    steer_dead_s: float
    steer_hz: float
    steer_damping: float
    steer_rate_radps: float
    throttle_dead_s: float
    throttle_lag_s: float
    brake_dead_s: float
    brake_lag_s: float
    ins_latency_s: float
    # What a single-track car with smooth pedals cannot be fitted to; of no effect without background mismatch
    height_m: float
    load_slope: float  # of a tyre's stiffness, against the square of its change of load
    brush_frac: float  # share of a brush tyre's curve
    slip_per_n: float  # of a wheel, by its longitudinal force
    power_bend: float  # power by throttle share to this; 1 without mismatch
    power_edge: float  # how sharp force gives way to power; 2 without mismatch
    gear_ripple: float
    gear_mps: float  # upper end of first gear
    brake_rise: float  # progressive brake, per duty


class Limits(NamedTuple):
    """What a driver of this car keeps to, and its folder says."""

    steer_rad: float
    steer_rate_radps: float
    throttle_frac: float  # duty
    brake_frac: float
    accel_mps2: tuple[float, float]
    lateral_mps2: float
    speed_mps: float


class Noise(NamedTuple):
    """Standard deviations of white noise on what is reported, and constant biases of the sensors."""

    pedal_frac: float
    steer_rad: float
    speed_mps: float
    wheel_radps: float
    accel_mps2: float
    yaw_radps: float
    ins_m: float
    ins_heading_rad: float
    ins_speed_mps: float
    ins_accel_mps2: float
    ins_yaw_radps: float


class Vehicle(NamedTuple):
    """A car with its limits, its noise, and what the data sheet says ([nominal], [latency]; a few percent off)."""

    car: Car
    limits: Limits
    noise: Noise
    sheet: dict[str, float]
    mismatch: float


def draw_vehicle(seed: int, mismatch: float = 0.0) -> Vehicle:
    """The car of a seed. mismatch: 0, 0.02, 0.05: by about that share forces depart from what a simple car's would be
    at 4 m/s2 to the side (tyre form, load transfer), and along it (gears, progressive brake)."""
    mismatch = float(mismatch)
    rng = np.random.default_rng([seed, 1])
    mass = rng.uniform(1150.0, 2350.0)
    wheelbase = rng.uniform(2.45, 3.05)
    front = wheelbase * rng.uniform(0.42, 0.52)
    rear = wheelbase - front
    weight = mass * G_MPS2
    # Understeer of 0.3 to 3 mrad per m/s2, as road cars have
    rear_per_rad = rng.uniform(9.0, 14.0) * weight * front / wheelbase
    bend = rng.uniform(0.3e-3, 3.0e-3) * G_MPS2
    front_per_rad = weight * rear / wheelbase / (bend + weight * front / wheelbase / rear_per_rad)
    rest = round(rng.uniform(0.10, 0.20), 2)
    share = mismatch / FULL_MISMATCH
    car = Car(
        mass_kg=mass,
        wheelbase_m=wheelbase,
        front_m=front,
        inertia_kgm2=mass * front * rear * rng.uniform(0.88, 1.06),
        half_track_m=0.5 * rng.uniform(1.48, 1.66),
        wheel_radius_m=rng.uniform(0.29, 0.36),
        front_stiffness=0.5 * front_per_rad,
        rear_stiffness=0.5 * rear_per_rad,
        friction=rng.uniform(0.86, 0.98),
        tyre_form=rng.uniform(1.35, 1.6),
        drag_area_m2=rng.uniform(0.58, 0.95),
        rolling_frac=rng.uniform(0.008, 0.015),
        steer_ratio=rng.uniform(13.0, 18.0),
        drive_n=mass * rng.uniform(2.9, 4.4),
        drive_bend=rng.uniform(0.25, 0.8),
        drive_w=mass * rng.uniform(38.0, 70.0),
        throttle_zero=rng.uniform(0.0, 0.02),
        throttle_full=0.62,
        creep_n=mass * rng.uniform(0.25, 0.6),
        creep_mps=rng.uniform(1.8, 3.2),
        brake_n=mass * rng.uniform(17.0, 32.0),
        rest_frac=rest,
        transport_s=rng.uniform(0.003, 0.007),
        steer_dead_s=rng.uniform(0.02, 0.11),
        steer_hz=rng.uniform(2.2, 6.0),
        steer_damping=rng.uniform(0.7, 1.05),
        steer_rate_radps=rng.uniform(6.5, 10.0),
        throttle_dead_s=rng.uniform(0.015, 0.06),
        throttle_lag_s=rng.uniform(0.03, 0.14),
        brake_dead_s=rng.uniform(0.01, 0.05),
        brake_lag_s=rng.uniform(0.03, 0.11),
        ins_latency_s=rng.uniform(0.002, 0.008),
        height_m=math.sqrt(share) * rng.uniform(0.48, 0.66),  # what it takes off goes with its square
        load_slope=float(share > 0.0) * rng.uniform(0.10, 0.22),
        brush_frac=share * rng.uniform(0.22, 0.34),
        slip_per_n=share * rng.uniform(0.8e-6, 2.0e-6),
        power_bend=1.0 - share * rng.uniform(0.05, 0.15),
        power_edge=2.0 + share * rng.uniform(0.2, 0.6),
        gear_ripple=mismatch,
        gear_mps=rng.uniform(3.5, 5.5),
        brake_rise=mismatch * rng.uniform(2.0, 4.0),
    )
    return Vehicle(car, _limits(car, rng), _noise(rng), _sheet(car, rng), mismatch)


def _limits(car: Car, rng: np.random.Generator) -> Limits:
    return Limits(
        steer_rad=round(rng.uniform(7.6, 8.8), 2),
        steer_rate_radps=round(car.steer_rate_radps * rng.uniform(0.97, 1.0), 2),
        throttle_frac=round(car.rest_frac + rng.uniform(0.5, 0.62), 2),
        brake_frac=round(car.rest_frac + 5.5 * car.mass_kg / car.brake_n, 2),
        accel_mps2=(-5.0, 2.5),
        lateral_mps2=4.0,
        speed_mps=25.0,
    )


def _noise(rng: np.random.Generator) -> Noise:
    usual = Noise(0.0003, 0.0012, 0.012, 0.03, 0.045, 0.0014, 0.008, 0.0006, 0.011, 0.035, 0.0006)
    return Noise(*(value * rng.uniform(0.6, 1.6) for value in usual))


def _sheet(car: Car, rng: np.random.Generator) -> dict[str, float]:
    """What the data sheet says; every number rounded as a data sheet's is."""

    def about(value: float, doubt: float, digits: int) -> float:
        off = value * (1.0 + doubt * float(np.clip(rng.standard_normal(), -2.0, 2.0)))
        return float(f"{off:.{digits}g}")

    stiffer = 1.0 + 0.08 * float(np.clip(rng.standard_normal(), -2.0, 2.0))  # the sheet's tyres are others
    rise = 2.2 / (2.0 * math.pi * car.steer_hz) * 2.0 * car.steer_damping
    return {
        "mass_kg": about(car.mass_kg, 0.015, 4),
        "wheelbase_m": round(car.wheelbase_m, 3),
        "front_axle_m": about(car.front_m, 0.015, 3),
        "yaw_inertia_kgm2": about(car.inertia_kgm2, 0.06, 3),
        "steer_ratio": about(car.steer_ratio, 0.015, 3),
        "wheel_radius_m": about(car.wheel_radius_m, 0.004, 3),
        "track_m": about(2.0 * car.half_track_m, 0.004, 4),
        "front_stiffness_n_per_rad": about(2.0 * car.front_stiffness * stiffer, 0.03, 3),
        "rear_stiffness_n_per_rad": about(2.0 * car.rear_stiffness * stiffer, 0.03, 3),
        "rest_pedal_frac": car.rest_frac,
        "steer_dead_s": about(car.steer_dead_s, 0.1, 2),
        "steer_rise_s": about(rise, 0.1, 2),
        "throttle_dead_s": about(car.throttle_dead_s, 0.1, 2),
        "throttle_rise_s": about(2.2 * car.throttle_lag_s, 0.1, 2),
        "brake_dead_s": about(car.brake_dead_s, 0.1, 2),
        "brake_rise_s": about(2.2 * car.brake_lag_s, 0.1, 2),
        "ins_latency_s": round(car.ins_latency_s, 3),
    }
