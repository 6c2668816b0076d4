"""Data sheet of a vehicle folder: start values of fits, and values that logs do not identify."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.schema import LatencySpec, LimitsSpec, NominalSpec, VehicleSpec
from tunefree_hil.plant.actuation.acceleration_interface import linear
from tunefree_hil.plant.data_sheet import DEFAULTS

RISE_TIME_PER_LAG = 2.2  # ln 9: 10 to 90 % of a first-order step response
PEDALS = ("throttle", "brake")


class PriorCriteria(NamedTuple):
    """How far a physical constant may be from its prior value (docs/results/criteria.md)."""

    motion_factor: float = 4.0  # for values from a simple law of motion, which gives the order of magnitude only
    ratio_factor: float = 1.5  # the same for the steering ratio, which follows from geometry and is closer
    # steering linkage that departs from a single track; parallel wheels give t^2/L^2 (1 + L/a) = 0.2 to 0.4 (t: half
    # the track, a: distance of the front axle), Ackermann steering 0
    linkage_bend_per_rad2: float = 0.4
    brake_rise: float = 0.5  # share by which the brake force at full duty may differ from proportional
    overrun_mps2: float = 0.7  # deceleration with released pedals: about 0.2 for engines, 0 to 2 for electric motors
    # growth of the logarithm of a factor with that of the mass, beyond e times the default mass: the defaults are those
    # of a road car
    mass_exponent: float = 0.3
    unstated_factor: float = 1.5  # extra factor for values that the folder could state and does not


PRIORS = PriorCriteria()


class ChannelSheet(NamedTuple):
    """Data sheet of a by-wire channel. is_stated: [latency] has it; rate_limit inf: not stated."""

    rest: float
    dead_time_s: float
    lag_s: float
    rate_limit: float
    is_stated: bool


def read_channel_sheet(vehicle: VehicleSpec, channel: str) -> ChannelSheet:
    """[latency] and [limits] of a channel."""
    latency = vehicle.latency.get(channel, LatencySpec())
    rest = vehicle.nominal.rest_pedal_frac if channel in PEDALS else 0.0
    rate = vehicle.limits.steer_rate_radps if channel == "steer" else math.inf
    lag_s = latency.rise_time_s / RISE_TIME_PER_LAG
    return ChannelSheet(rest, latency.dead_time_s, lag_s, rate, channel in vehicle.latency)


def com_to_rear_axle_m(nominal: NominalSpec) -> float:
    """Distance from the centre of mass back to the rear axle; 0 where the folder does not state it."""
    return (nominal.wheelbase_m or 0.0) - (nominal.front_axle_m or 0.0)


class ConstantPrior(NamedTuple):
    """A physical constant before a fit.

    Attributes:
        value: Prior value.
        uncertainty: About two standard deviations: a factor if `is_factor`, else in the unit of the constant.
        is_factor: Whether the uncertainty is a factor.
        is_stated: Whether the data sheet states the value.
    """

    value: float
    uncertainty: float
    is_factor: bool
    is_stated: bool

    def interval(self) -> tuple[float, float]:
        """The value widened by its uncertainty."""
        if self.is_factor:
            return self.value / self.uncertainty, self.value * self.uncertainty
        return self.value - self.uncertainty, self.value + self.uncertainty


def is_accel_commanded(vehicle: VehicleSpec) -> bool:
    """Whether a vehicle has commanded acceleration and no pedal signals (plant/actuation/acceleration_interface.py)."""
    pedals = "throttle_frac" in vehicle.command or "throttle_frac" in vehicle.report
    return "accel_mps2" in vehicle.command and not pedals


def has_brake(vehicle: VehicleSpec) -> bool:
    """Whether a vehicle folder has a brake command or report."""
    return "brake_frac" in vehicle.command or "brake_frac" in vehicle.report


def make_fixed_params(vehicle: VehicleSpec, motion_values: Mapping[str, float] | None = None) -> dict[str, float]:
    """[plant.params] that are never fitted: masses, geometry, pedal rest; defaults where the folder has none.

    Drive and brake of a vehicle with commanded acceleration are fixed too, as are the brake of a vehicle without one
    and the creep of a vehicle whose motion shows none.

    Args:
        vehicle: Vehicle folder.
        motion_values: As for `make_constant_priors`.
    """
    nominal = vehicle.nominal
    wheelbase_m = nominal.wheelbase_m or DEFAULTS["wheelbase_m"]
    rest = nominal.rest_pedal_frac
    mass_kg = nominal.mass_kg or DEFAULTS["mass_kg"] * (wheelbase_m / DEFAULTS["wheelbase_m"]) ** 2
    params = {
        "mass_kg": mass_kg,
        "wheelbase_m": wheelbase_m,
        "front_axle_m": nominal.front_axle_m or 0.5 * wheelbase_m,
        "wheel_radius_m": nominal.wheel_radius_m or DEFAULTS["wheel_radius_m"],
        "track_m": nominal.track_m or DEFAULTS["track_m"] * wheelbase_m / DEFAULTS["wheelbase_m"],
        "friction": DEFAULTS["friction"],
        "rest_pedal_frac": rest,
        "throttle_full_frac": max(vehicle.limits.throttle_frac, rest + 0.1),
    }
    if (motion_values or {}).get("creep_force_n") == 0.0:
        params |= {"creep_force_n": 0.0, "creep_speed_mps": 1.0, "overrun_force_n": 0.0}
    if is_accel_commanded(vehicle):
        return params | linear(mass_kg, rest)
    return params if has_brake(vehicle) else params | {"brake_force_n_per_frac": 0.0, "brake_rise_per_frac": 0.0}


def make_constant_priors(
    vehicle: VehicleSpec, motion_values: Mapping[str, float] | None = None
) -> dict[str, ConstantPrior]:
    """Priors of the constants that a fit may change, by their names in [plant.params].

    Defaults are those of a road car; their uncertainty grows for a much lighter or heavier vehicle.

    Args:
        vehicle: Vehicle folder: [nominal] and [limits].
        motion_values: Values from the motion (learn/actuators/samples_from_motion.py), used where the folder does
            not state one.
    """
    fixed = make_fixed_params(vehicle, motion_values)
    span = fixed["throttle_full_frac"] - vehicle.nominal.rest_pedal_frac
    priors = {
        **_longitudinal_priors(vehicle.limits, fixed, span),
        **_lateral_priors(vehicle.nominal, fixed),
    }
    for name, value in (motion_values or {}).items():
        if name == "throttle_zero_frac":
            priors[name] = ConstantPrior(value, 0.15 * span, False, False)
        elif name in priors and not priors[name].is_stated:
            factor = PRIORS.ratio_factor if name == "steer_ratio" else PRIORS.motion_factor
            priors[name] = ConstantPrior(value, factor, True, False)
    return {name: prior for name, prior in priors.items() if name not in fixed}


def _longitudinal_priors(limits: LimitsSpec, fixed: Mapping[str, float], span: float) -> dict[str, ConstantPrior]:
    """Drive, brake and resistance. span: throttle duty from rest to full."""
    mass_kg, rest = fixed["mass_kg"], fixed["rest_pedal_frac"]
    low, high = limits.accel_mps2
    brake_span = max(limits.brake_frac - rest, 0.05)
    heavier = mass_kg / DEFAULTS["mass_kg"]
    scaled = 1.0 + PRIORS.mass_exponent * max(abs(math.log(heavier)) - 1.0, 0.0)

    def guess(value: float, factor: float) -> ConstantPrior:
        return ConstantPrior(value, factor**scaled, True, False)

    return {
        "drive_force_n": guess(1.6 * max(high, 0.5) * mass_kg, 3.0),
        "drive_knee_frac": guess(0.2, 4.0),
        "drive_power_w": guess(DEFAULTS["drive_power_w"] * heavier, 3.0),
        "throttle_zero_frac": ConstantPrior(rest + 0.03 * span, min(0.08 * scaled, 0.3) * span, False, False),
        "drive_corner": guess(DEFAULTS["drive_corner"], 4.0),
        "creep_force_n": guess(DEFAULTS["creep_force_n"] * heavier, 3.0),
        "creep_speed_mps": guess(DEFAULTS["creep_speed_mps"], 2.5),
        "overrun_force_n": ConstantPrior(0.0, PRIORS.overrun_mps2 * mass_kg, False, False),
        "brake_force_n_per_frac": guess(1.2 * max(-low, 1.0) * mass_kg / brake_span, 4.0),
        "brake_rise_per_frac": ConstantPrior(0.0, PRIORS.brake_rise, False, False),
        "rolling_frac": guess(DEFAULTS["rolling_frac"], 2.0),
        "drag_area_m2": guess(DEFAULTS["drag_area_m2"] * math.sqrt(heavier), 2.0),
    }


def _lateral_priors(nominal: NominalSpec, fixed: Mapping[str, float]) -> dict[str, ConstantPrior]:
    """Tyres, yaw inertia and steering."""
    mass_kg, wheelbase_m, front_m = fixed["mass_kg"], fixed["wheelbase_m"], fixed["front_axle_m"]
    axle_n = 7.6 * mass_kg * G_MPS2 / wheelbase_m  # per rad at one axle, times the other axle's distance

    def stated(value: float | None, otherwise: float, factor: float) -> ConstantPrior:
        return ConstantPrior(
            value or otherwise, factor if value else factor * PRIORS.unstated_factor, True, bool(value)
        )

    return {
        "front_stiffness_n_per_rad": stated(nominal.front_stiffness_n_per_rad, axle_n * (wheelbase_m - front_m), 1.8),
        "rear_stiffness_n_per_rad": stated(nominal.rear_stiffness_n_per_rad, axle_n * front_m, 1.8),
        "yaw_inertia_kgm2": stated(nominal.yaw_inertia_kgm2, mass_kg * front_m * (wheelbase_m - front_m), 1.5),
        "steer_ratio": stated(nominal.steer_ratio, DEFAULTS["steer_ratio"], 1.1),
        "linkage_bend": ConstantPrior(0.0, PRIORS.linkage_bend_per_rad2, False, False),
    }
