"""Limits of the constants in [plant.params], the same for all plants."""

from __future__ import annotations

import math
from collections.abc import Mapping

from tunefree_hil.base.errors import InputError

# Constants above 0, constants that may be 0, and shares of the front axle
POSITIVE = (
    "mass_kg", "wheelbase_m", "front_axle_m", "yaw_inertia_kgm2", "front_stiffness_n_per_rad",
    "rear_stiffness_n_per_rad", "friction", "steer_ratio", "wheel_radius_m", "track_m", "throttle_full_frac",
    "drive_force_n", "drive_knee_frac", "drive_power_w", "drive_corner", "creep_speed_mps",
    "steer_lag_s", "steer_motor_s", "steer_rate_radps", "throttle_press_s", "throttle_release_s", "brake_press_s",
    "brake_release_s", "relaxation_m", "slip_stiffness_n", "throttle_scale", "brake_scale", "drive_gain", "shift_gain",
)  # fmt: skip
NOT_BELOW_0 = (
    "rest_pedal_frac", "creep_force_n", "overrun_force_n", "rolling_frac", "drag_area_m2", "brake_force_n_per_frac",
    "steer_dead_time_s", "throttle_dead_time_s", "brake_dead_time_s", "height_m", "hold_s", "compliance_rad_per_n",
    "body_lag_s", "drive_lag_s", "hysteresis_frac", "idle_gain", "brake_gain", "brake_servo",
)  # fmt: skip
LEAST = {"brake_rise_per_frac": -0.5}  # below it more brake duty would brake less
SHARES = ("roll_front_frac", "drive_front_frac", "brake_front_frac")
FARTHER = {"wheelbase_m": "front_axle_m", "throttle_full_frac": "throttle_zero_frac"}  # each above this one


def require_constants(kind: str, defaults: Mapping[str, float], given: Mapping[str, float]) -> None:
    """Raises InputError with the key of a constant outside its limits.

    kind: of the plant; a plant of the user's own is not checked. defaults: the plant's; given: [plant.params].
    """
    if ":" in kind:
        return
    values = {**defaults, **given}
    for name, value in given.items():
        if not math.isfinite(value):  # files may contain inf (config/convert.py); inf times 0 is NaN
            raise _wrong(name, f"{value:g} is no number of a car", "give a finite number")
        if name in POSITIVE and value <= 0.0:
            raise _wrong(name, f"expected more than 0, got {value:g}", "give the car's own, or leave it out")
        if name in NOT_BELOW_0 and value < 0.0:
            raise _wrong(name, f"expected 0 or more, got {value:g}", "give the car's own, or leave it out")
        if name in SHARES and not 0.0 <= value <= 1.0:
            raise _wrong(name, f"expected a share from 0 to 1, got {value:g}", "give the front axle's share of it")
        if name in LEAST and value < LEAST[name]:
            raise _wrong(
                name, f"expected {LEAST[name]:g} or more, got {value:g}", "give the car's own, or leave it out"
            )
    for name, least in FARTHER.items():
        if name in values and least in values and values[name] <= values[least]:
            problem = f"{values[name]:g} is not more than {least}, which is {values[least]:g}"
            raise _wrong(name if name in given else least, problem, f"{name} must be more than {least}")


def _wrong(name: str, message: str, hint: str) -> InputError:
    return InputError(message, code="bad_plant_parameter", key=f"plant.params.{name}", hint=hint)
