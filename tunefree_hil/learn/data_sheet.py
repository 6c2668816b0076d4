"""What a vehicle folder's data sheet says, as a start and as a stand-in for what logs cannot show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.schema import LatencySpec, NominalSpec, VehicleSpec
from tunefree_hil.plant.actuation.acceleration_interface import linear
from tunefree_hil.plant.data_sheet import DEFAULTS

RISE_IN_LAGS = 2.2  # 10 to 90 % of a first-order step response
SEEN_DOUBT, RATIO_DOUBT = 4.0, 1.5  # of what a plain law of the motion suggests
# Two front wheels on their own circles are no single track. Where both turn by the same angle, theirs together counts
# as a share less: t²/L² (1 + L/a) = 0.2 to 0.4 per rad², t half the track, a the front axle's distance; none where the
# linkage turns each as its circle asks (Ackermann). No ratio is the same from straight ahead to the lock, either.
BEND_DOUBT = 0.4
# A brake may pull this much more, or less, at full duty than in proportion
BRAKE_RISE_DOUBT = 0.5
# With no foot on a pedal engines hold back some 0.2 m/s², electric motors from nothing to 2
OVERRUN_DOUBT_MPS2 = 0.7
PEDALS = ("throttle", "brake")
SCALE_DOUBT = 0.3  # by how much the doubt's logarithm grows with that of the mass, beyond a factor of e


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


def rear_behind_m(nominal: NominalSpec) -> float:
    """How far behind the centre of mass the rear axle lies, as far as the folder says."""
    return (nominal.wheelbase_m or 0.0) - (nominal.front_axle_m or 0.0)


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


def asks_accel(vehicle: VehicleSpec) -> bool:
    """Whether a vehicle is asked for an acceleration and shows no pedals (plant/actuation/acceleration_interface.py)."""
    pedals = "throttle_frac" in vehicle.command or "throttle_frac" in vehicle.report
    return "accel_mps2" in vehicle.command and not pedals


def has_brake(vehicle: VehicleSpec) -> bool:
    """Whether a vehicle has a brake of its own, as far as its folder says."""
    return "brake_frac" in vehicle.command or "brake_frac" in vehicle.report


def fixed_params(vehicle: VehicleSpec, seen: Mapping[str, float] | None = None) -> dict[str, float]:
    """What is never fitted: masses, geometry, rest of the pedals; plausible numbers where the folder is silent.

    Of a car that is asked for an acceleration also all that moves it along; a car without a brake has none, nor has one
    creep whose motion shows none (seen: as for `constants`).
    """
    said = vehicle.nominal
    wheelbase_m = said.wheelbase_m or DEFAULTS["wheelbase_m"]
    rest = said.rest_pedal_frac
    mass_kg = said.mass_kg or DEFAULTS["mass_kg"] * (wheelbase_m / DEFAULTS["wheelbase_m"]) ** 2
    found = {
        "mass_kg": mass_kg,
        "wheelbase_m": wheelbase_m,
        "front_axle_m": said.front_axle_m or 0.5 * wheelbase_m,
        "wheel_radius_m": said.wheel_radius_m or DEFAULTS["wheel_radius_m"],
        "track_m": said.track_m or DEFAULTS["track_m"] * wheelbase_m / DEFAULTS["wheelbase_m"],
        "friction": DEFAULTS["friction"],
        "rest_pedal_frac": rest,
        "throttle_full_frac": max(vehicle.limits.throttle_frac, rest + 0.1),
    }
    if (seen or {}).get("creep_force_n") == 0.0:
        found |= {"creep_force_n": 0.0, "creep_speed_mps": 1.0, "overrun_force_n": 0.0}
    if asks_accel(vehicle):
        return found | linear(mass_kg, rest)
    return found if has_brake(vehicle) else found | {"brake_force_n_per_frac": 0.0, "brake_rise_per_frac": 0.0}


def constants(vehicle: VehicleSpec, seen: Mapping[str, float] | None = None) -> dict[str, Constant]:
    """The constants that a fit may change, by their names in [plant.params]: from [nominal], [limits], or plausible.

    seen: values that the motion suggests (learn/actuators/samples_from_motion.py), for those that the folder does not state.
    What is plausible is so for a road car: of a lighter one (or heavier) it is doubted the more, by SCALE_DOUBT.
    """
    said, limits, fixed = vehicle.nominal, vehicle.limits, fixed_params(vehicle, seen)
    mass_kg, wheelbase_m, front_m = fixed["mass_kg"], fixed["wheelbase_m"], fixed["front_axle_m"]
    rest, heavier = said.rest_pedal_frac, mass_kg / DEFAULTS["mass_kg"]
    low, high = limits.accel_mps2
    brake_span = max(limits.brake_frac - rest, 0.05)
    axle_n = 7.6 * mass_kg * G_MPS2 / wheelbase_m  # per rad at one axle, times the other axle's distance

    def stated(value: float | None, otherwise: float, doubt: float) -> Constant:
        return Constant(value or otherwise, doubt if value else doubt * 1.5, True, bool(value))

    scaled = 1.0 + SCALE_DOUBT * max(abs(math.log(heavier)) - 1.0, 0.0)

    def guess(value: float, doubt: float) -> Constant:
        return Constant(value, doubt**scaled, True, False)

    span = fixed["throttle_full_frac"] - rest
    found = {
        "drive_force_n": guess(1.6 * max(high, 0.5) * mass_kg, 3.0),
        "drive_knee_frac": guess(0.2, 4.0),
        "drive_power_w": guess(DEFAULTS["drive_power_w"] * heavier, 3.0),
        "throttle_zero_frac": Constant(rest + 0.03 * span, min(0.08 * scaled, 0.3) * span, False, False),
        "drive_corner": guess(DEFAULTS["drive_corner"], 4.0),
        "creep_force_n": guess(DEFAULTS["creep_force_n"] * heavier, 3.0),
        "creep_speed_mps": guess(DEFAULTS["creep_speed_mps"], 2.5),
        "overrun_force_n": Constant(0.0, OVERRUN_DOUBT_MPS2 * mass_kg, False, False),
        "brake_force_n_per_frac": guess(1.2 * max(-low, 1.0) * mass_kg / brake_span, 4.0),
        "brake_rise_per_frac": Constant(0.0, BRAKE_RISE_DOUBT, False, False),
        "rolling_frac": guess(DEFAULTS["rolling_frac"], 2.0),
        "drag_area_m2": guess(DEFAULTS["drag_area_m2"] * math.sqrt(heavier), 2.0),
        "front_stiffness_n_per_rad": stated(said.front_stiffness_n_per_rad, axle_n * (wheelbase_m - front_m), 1.8),
        "rear_stiffness_n_per_rad": stated(said.rear_stiffness_n_per_rad, axle_n * front_m, 1.8),
        "yaw_inertia_kgm2": stated(said.yaw_inertia_kgm2, mass_kg * front_m * (wheelbase_m - front_m), 1.5),
        "steer_ratio": stated(said.steer_ratio, DEFAULTS["steer_ratio"], 1.1),
        "linkage_bend": Constant(0.0, BEND_DOUBT, False, False),
    }
    for name, value in (seen or {}).items():
        if name == "throttle_zero_frac":
            found[name] = Constant(value, 0.15 * span, False, False)
        elif name in found and not found[name].stated:
            found[name] = Constant(value, RATIO_DOUBT if name == "steer_ratio" else SEEN_DOUBT, True, False)
    return {name: one for name, one in found.items() if name not in fixed}
