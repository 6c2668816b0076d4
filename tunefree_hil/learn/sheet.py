"""What a vehicle folder's data sheet says, as a start and as a stand-in for what logs cannot show."""

from __future__ import annotations

import math
from typing import NamedTuple

from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.schema import LatencySpec, VehicleSpec
from tunefree_hil.plant.data_sheet import DEFAULTS

RISE_IN_LAGS = 2.2  # 10 to 90 % of a first-order step response
PEDALS = ("throttle", "brake")


class ChannelSheet(NamedTuple):
    """A channel by its data sheet. stated: whether [latency] speaks of it; rate_limit inf: nothing is said."""

    rest: float
    dead_time_s: float
    lag_s: float
    rate_limit: float
    stated: bool


def channel_sheet(vehicle: VehicleSpec, channel: str) -> ChannelSheet:
    """[latency] and [limits] of a channel."""
    said = vehicle.latency.get(channel, LatencySpec())
    rest = vehicle.nominal.rest_pedal_frac if channel in PEDALS else 0.0
    rate = vehicle.limits.steer_rate_radps if channel == "steer" else math.inf
    return ChannelSheet(rest, said.dead_time_s, said.rise_time_s / RISE_IN_LAGS, rate, channel in vehicle.latency)


class Constant(NamedTuple):
    """A physical constant before the fit: value, and by which factor (or amount) the truth may differ (about 2 sigma).

    logarithmic: the doubt is a factor; else it is in the constant's own unit. stated: by the data sheet.
    """

    value: float
    doubt: float
    logarithmic: bool
    stated: bool

    def ends(self) -> tuple[float, float]:
        """The constant widened by its doubt."""
        if self.logarithmic:
            return self.value / self.doubt, self.value * self.doubt
        return self.value - self.doubt, self.value + self.doubt


def fixed_params(vehicle: VehicleSpec) -> dict[str, float]:
    """What is never fitted: masses, geometry, rest of the pedals; plausible numbers where the folder is silent."""
    said = vehicle.nominal
    wheelbase_m = said.wheelbase_m or DEFAULTS["wheelbase_m"]
    rest = said.rest_pedal_frac
    return {
        "mass_kg": said.mass_kg or DEFAULTS["mass_kg"] * (wheelbase_m / DEFAULTS["wheelbase_m"]) ** 2,
        "wheelbase_m": wheelbase_m,
        "front_axle_m": said.front_axle_m or 0.5 * wheelbase_m,
        "wheel_radius_m": said.wheel_radius_m or DEFAULTS["wheel_radius_m"],
        "track_m": DEFAULTS["track_m"],
        "friction": DEFAULTS["friction"],
        "rest_pedal_frac": rest,
        "throttle_full_frac": max(vehicle.limits.throttle_frac, rest + 0.1),
    }


def constants(vehicle: VehicleSpec) -> dict[str, Constant]:
    """The constants that a fit may change, by their names in [plant.params]: from [nominal], [limits], or plausible."""
    said, limits, fixed = vehicle.nominal, vehicle.limits, fixed_params(vehicle)
    mass_kg, wheelbase_m, front_m = fixed["mass_kg"], fixed["wheelbase_m"], fixed["front_axle_m"]
    rest, heavier = said.rest_pedal_frac, mass_kg / DEFAULTS["mass_kg"]
    low, high = limits.accel_mps2
    brake_span = max(limits.brake_frac - rest, 0.05)
    axle_n = 7.6 * mass_kg * G_MPS2 / wheelbase_m  # per rad at one axle, times the other axle's distance

    def stated(value: float | None, otherwise: float, doubt: float) -> Constant:
        return Constant(value or otherwise, doubt if value else doubt * 1.5, True, bool(value))

    def guess(value: float, doubt: float) -> Constant:
        return Constant(value, doubt, True, False)

    span = fixed["throttle_full_frac"] - rest
    return {
        "drive_force_n": guess(1.6 * max(high, 0.5) * mass_kg, 3.0),
        "drive_knee_frac": guess(0.2, 4.0),
        "drive_power_w": guess(DEFAULTS["drive_power_w"] * heavier, 3.0),
        "throttle_zero_frac": Constant(rest + 0.03 * span, 0.08 * span, False, False),
        "creep_force_n": guess(DEFAULTS["creep_force_n"] * heavier, 3.0),
        "creep_speed_mps": guess(DEFAULTS["creep_speed_mps"], 2.5),
        "brake_force_n_per_frac": guess(1.2 * max(-low, 1.0) * mass_kg / brake_span, 4.0),
        "rolling_frac": guess(DEFAULTS["rolling_frac"], 2.0),
        "drag_area_m2": guess(DEFAULTS["drag_area_m2"] * math.sqrt(heavier), 2.0),
        "front_stiffness_n_per_rad": stated(said.front_stiffness_n_per_rad, axle_n * (wheelbase_m - front_m), 1.8),
        "rear_stiffness_n_per_rad": stated(said.rear_stiffness_n_per_rad, axle_n * front_m, 1.8),
        "yaw_inertia_kgm2": stated(said.yaw_inertia_kgm2, mass_kg * front_m * (wheelbase_m - front_m), 1.5),
        "steer_ratio": stated(said.steer_ratio, DEFAULTS["steer_ratio"], 1.1),
    }
