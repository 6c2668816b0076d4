"""The effects that the exam hides: the 42 of docs/reference/effects.md, and eight kinds that are in no catalogue.

Names, parameters, units, neutral values, places and links are those of docs/reference/effects.md; sizes are the
exam's own: `small` is about what a driver's logs can just show, `large` what nobody would overlook.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Kind(NamedTuple):
    """One effect. way: how its size changes the parameter from neutral.

    'add': neutral + size (signed where `signed`); 'factor': 1 + size or 1 / (1 + size); 'less': 1 / (1 + size);
    'limit': the parameter itself, from `small` (high) to `large` (low). subsystem: for pairs of effects.
    """

    parameter: str
    unit: str
    way: str
    small: float
    large: float
    signed: bool
    link: str
    subsystem: str
    second: str = ""  # a further parameter, drawn uniformly
    second_range: tuple[float, float] = (0.0, 0.0)


A, B = "command_to_report", "report_to_motion"
S, T, K, C, M = "steering", "throttle", "brake", "chassis", "sensing"

EFFECTS: dict[str, Kind] = {
    "steer_dead_time": Kind("delay_s", "s", "add", 0.012, 0.26, False, A, S),
    "steer_lag": Kind("tau_s", "s", "add", 0.014, 0.32, False, A, S),
    "steer_rate_limit": Kind("rate_radps", "rad/s", "limit", 4.5, 0.6, False, A, S),
    "steer_dead_band": Kind("half_width_rad", "rad", "add", 0.006, 0.13, False, A, S),
    "steer_friction": Kind("level_rad", "rad", "add", 0.006, 0.13, False, A, S),
    "steer_saturation": Kind("limit_rad", "rad", "limit", 3.2, 0.45, False, A, S),
    "steer_gain": Kind("gain_frac", "1", "factor", 0.015, 0.28, True, B, S),
    "steer_offset": Kind("offset_rad", "rad", "add", 0.007, 0.21, True, B, S),
    "steer_backlash": Kind("width_rad", "rad", "add", 0.015, 0.26, False, B, S),
    "throttle_dead_time": Kind("delay_s", "s", "add", 0.025, 0.42, False, A, T),
    "throttle_lag": Kind("tau_s", "s", "add", 0.035, 0.75, False, A, T),
    "throttle_rate_limit": Kind("rate_per_s", "1/s", "limit", 1.1, 0.09, False, A, T),
    "throttle_dead_band": Kind("half_width_frac", "1", "add", 0.005, 0.085, False, B, T),
    "throttle_gain": Kind("gain_frac", "1", "factor", 0.025, 0.45, True, B, T),
    "powertrain_lag": Kind("tau_s", "s", "add", 0.04, 0.85, False, B, T),
    "power_limit": Kind("power_w", "W", "limit", 42e3, 7.5e3, False, B, T),
    "brake_dead_time": Kind("delay_s", "s", "add", 0.025, 0.42, False, A, K),
    "brake_lag": Kind("tau_s", "s", "add", 0.035, 0.65, False, A, K),
    "brake_dead_band": Kind("half_width_frac", "1", "add", 0.003, 0.055, False, B, K),
    "brake_gain": Kind("gain_frac", "1", "factor", 0.025, 0.45, True, B, K),
    "brake_pressure_lag": Kind("tau_s", "s", "add", 0.035, 0.65, False, B, K),
    "brake_fade": Kind("loss_per_mj", "1/MJ", "add", 0.015, 0.32, False, B, K),
    "brake_drag": Kind("force_n", "N", "add", 35.0, 850.0, False, B, K),
    "payload": Kind("mass_kg", "kg", "add", 45.0, 720.0, False, B, C, "ahead_m", (-1.1, 0.7)),
    "front_stiffness": Kind("gain_frac", "1", "factor", 0.05, 0.45, True, B, C),
    "rear_stiffness": Kind("gain_frac", "1", "factor", 0.05, 0.45, True, B, C),
    "friction": Kind("friction_frac", "1", "less", 0.12, 1.3, False, B, C),
    "tyre_relaxation": Kind("length_m", "m", "add", 0.15, 2.2, False, B, C),
    "rolling_resistance": Kind("extra_frac", "1", "add", 0.15, 2.8, False, B, C),
    "aero_drag": Kind("drag_area_m2", "m2", "add", 0.25, 4.2, False, B, C),
    "grade": Kind("grade_rad", "rad", "add", 0.003, 0.062, True, B, C),
    "head_wind": Kind("wind_mps", "m/s", "add", 1.2, 13.0, True, B, C),
    "side_wind": Kind("force_n", "N", "add", 60.0, 1600.0, True, B, C),
    "road_bank": Kind("bank_rad", "rad", "add", 0.004, 0.075, True, B, C),
    "speed_scale": Kind("scale_frac", "1", "factor", 0.006, 0.12, True, "wheel_vs_ins", M),
    "yaw_rate_bias": Kind("bias_radps", "rad/s", "add", 0.0015, 0.045, True, "yaw_vs_ins", M),
    "yaw_rate_scale": Kind("scale_frac", "1", "factor", 0.012, 0.22, True, "yaw_vs_ins", M),
    "yaw_rate_filter": Kind("tau_s", "s", "add", 0.015, 0.55, False, "yaw_vs_ins", M),
    "accel_bias": Kind("bias_mps2", "m/s2", "add", 0.03, 0.55, True, "accel_vs_dvdt", M),
    "steer_report_offset": Kind("offset_rad", "rad", "add", 0.006, 0.16, True, A, M),
    "report_latency": Kind("delay_s", "s", "add", 0.012, 0.22, False, "clock", M),
    "ins_latency": Kind("delay_s", "s", "add", 0.012, 0.27, False, "clock", M),
}

OUTSIDE: dict[str, Kind] = {  # in no catalogue, and never to be added to it
    "body_roll": Kind("gain_rad_per_mps2", "rad/(m/s2)", "add", 0.006, 0.022, False, B, C, "natural_hz", (0.9, 1.8)),
    "driveline_shuffle": Kind("ripple_frac", "1", "add", 0.5, 2.0, False, B, T, "natural_hz", (1.8, 4.5)),
    "abs_cycling": Kind("depth_frac", "1", "add", 0.35, 0.8, False, B, K, "cycle_hz", (4.0, 9.0)),
    "frame_loss": Kind("burst_s", "s", "add", 0.15, 0.6, False, "command_echo", M, "bursts_per_s", (0.15, 0.5)),
    "command_delay": Kind("delay_s_per_rad", "s/rad", "add", 0.08, 0.4, False, A, S),
    "speed_ratio": Kind("slope_per_mps", "s/m", "add", 0.012, 0.04, True, B, S),
    "shift_hole": Kind("depth_frac", "1", "add", 0.6, 1.0, False, B, T, "hole_s", (0.3, 0.7)),
    "heat_derating": Kind("loss_per_mj", "1/MJ", "add", 0.15, 0.7, False, B, T, "free_mj", (0.1, 0.4)),
}

# No log of an ordinary drive can separate these (docs/reference/effects.md); this car's lateral_accel_mps2 is there,
# so the class
# of side wind and road bank is none here.
CLASSES: tuple[frozenset[str], ...] = (frozenset({"brake_drag", "rolling_resistance"}),)
ALSO_LINKS: dict[str, tuple[str, ...]] = {"grade": ("accel_vs_dvdt",), "road_bank": ("accel_vs_dvdt",)}


def same_class(name: str, other: str) -> bool:
    """Whether two names count as one."""
    return name == other or any({name, other} <= one for one in CLASSES)


def kind_of(name: str) -> Kind:
    """The effect of that name, inside or outside the catalogue; KeyError where there is none."""
    return EFFECTS[name] if name in EFFECTS else OUTSIDE[name]


def links_of(name: str) -> tuple[str, ...]:
    """The links of the chain that are right for an effect."""
    return (kind_of(name).link, *ALSO_LINKS.get(name, ()))


def neutral(name: str) -> float:
    """The main parameter's value that changes nothing."""
    return {"add": 0.0, "factor": 1.0, "less": 1.0, "limit": math.inf}[kind_of(name).way]


def value(name: str, size: float, sign: int = 1) -> float:
    """The main parameter at a size from 0 (just noticeable) to 1 (gross), geometrically between; sign -1 turns it."""
    kind = kind_of(name)
    step = kind.small * (kind.large / kind.small) ** size
    if kind.way == "limit":
        return step
    if kind.way == "less" or (kind.way == "factor" and sign < 0):
        return 1.0 / (1.0 + step)
    return 1.0 + step if kind.way == "factor" else sign * step


def size_of(name: str, amount: float) -> float:
    """The size of a main parameter's value: what `value` makes it of."""
    kind = kind_of(name)
    step = abs(amount)
    if kind.way in ("factor", "less"):
        step = amount - 1.0 if amount > 1.0 else 1.0 / amount - 1.0
    return math.log(step / kind.small) / math.log(kind.large / kind.small)


def departure(name: str, amount: float) -> float:
    """How far a main parameter's value is from neutral, as a size in its unit: what errors of it are counted in."""
    if kind_of(name).way == "limit":
        return amount
    return abs(amount - neutral(name))
