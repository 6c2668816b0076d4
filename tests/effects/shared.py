"""Effects, values of theirs that show, and drives that the tests of effects share."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from tests.plant.drives import DT_S, PLANTS, REST, car, command, drive
from tunefree_hil.base.contracts import Effect, Port, make_effect, prior_of
from tunefree_hil.base.course import Start
from tunefree_hil.base.kernel import run
from tunefree_hil.base.records import Command, Disturbance, Ins, Motion, Report
from tunefree_hil.effects import catalogue
from tunefree_hil.plant.types import BodyOutput

EFFECTS: dict[str, Effect] = catalogue()
KINDS = sorted(PLANTS)
START = Start(speed_mps=9.0)
STRONG: dict[str, dict[str, float]] = {
    "steer_dead_time": {"delay_s": 0.08},
    "steer_lag": {"tau_s": 0.15},
    "steer_gain": {"gain_frac": 0.8},
    "steer_rate_limit": {"rate_radps": 3.0},
    "steer_dead_band": {"half_width_rad": 0.3},
    "steer_friction": {"level_rad": 0.3},
    "steer_saturation": {"limit_rad": 2.0},
    "steer_offset": {"offset_rad": 0.2},
    "steer_backlash": {"width_rad": 0.5},
    "throttle_dead_time": {"delay_s": 0.1},
    "throttle_lag": {"tau_s": 0.2},
    "throttle_rate_limit": {"rate_per_s": 0.3},
    "throttle_dead_band": {"half_width_frac": 0.05},
    "throttle_gain": {"gain_frac": 0.7},
    "powertrain_lag": {"tau_s": 0.4},
    "power_limit": {"power_w": 5e3},
    "brake_dead_time": {"delay_s": 0.1},
    "brake_lag": {"tau_s": 0.2},
    "brake_dead_band": {"half_width_frac": 0.03},
    "brake_gain": {"gain_frac": 0.7},
    "brake_pressure_lag": {"tau_s": 0.2},
    "brake_fade": {"loss_per_mj": 8.0},
    "brake_drag": {"force_n": 400.0},
    "payload": {"mass_kg": 400.0, "ahead_m": -1.0},
    "friction": {"friction_frac": 0.3},
    "grade": {"grade_rad": 0.05},
    "front_stiffness": {"gain_frac": 0.7},
    "rear_stiffness": {"gain_frac": 0.7},
    "tyre_relaxation": {"length_m": 1.5},
    "rolling_resistance": {"extra_frac": 3.0},
    "aero_drag": {"drag_area_m2": 2.0},
    "head_wind": {"wind_mps": 10.0},
    "side_wind": {"force_n": 800.0},
    "road_bank": {"bank_rad": 0.06},
    "speed_scale": {"scale_frac": 0.95},
    "yaw_rate_bias": {"bias_radps": 0.02},
    "yaw_rate_scale": {"scale_frac": 0.9},
    "yaw_rate_filter": {"tau_s": 0.2},
    "accel_bias": {"bias_mps2": 0.2},
    "steer_report_offset": {"offset_rad": 0.1},
    "report_latency": {"delay_s": 0.064},
    "ins_latency": {"delay_s": 0.064},
}
FORCES = ("power_limit", "brake_fade", "brake_drag")  # on a scalar port by place, changes of the plant's own forces
OFF_SCALAR = (Port.BODY, Port.REPORT, Port.INS)
SCALAR = [name for name, effect in EFFECTS.items() if effect.port not in OFF_SCALAR and name not in FORCES]
SIZES = {"steer_rad": 8.2, "mass_kg": 2080.0, "wheelbase_m": 2.8448}


def strong(name: str) -> dict[str, float]:
    """Values of an effect that show: those of STRONG, else what its priors call typical."""
    effect = EFFECTS[name]
    return STRONG.get(name) or {key: prior_of(effect, key, SIZES).typical for key in effect.neutral}


def weave(t: float) -> Command:
    """Throttle, then brake, steering about all the time."""
    return command(0.3 if t < 1.0 else REST, REST if t < 1.0 else 0.26, 4.0 * math.sin(3.0 * t))


def driven(
    kind: str,
    effects: Mapping[str, Mapping[str, float]],
    commands: Callable[[float], Command] = weave,
    duration_s: float = 1.6,
    *,
    start: Start = START,
    road: Disturbance = Disturbance(),  # noqa: B008 - a frozen record
    params: Mapping[str, float] | None = None,
    noise: Any = None,
) -> list[BodyOutput]:
    """A drive of a car with effects, by name."""
    chosen = tuple((EFFECTS[name], dict(values)) for name, values in effects.items())
    return drive(car(kind, params, chosen), commands, duration_s, start=start, road=road, noise=noise)


def constants(kind: str) -> Any:
    """The constants of a kind's car."""
    return car(kind).block.params.chassis.constants


def motions(outputs: list[BodyOutput]) -> list[Motion]:
    """The true motion of each tick."""
    return [out.motion for out in outputs]


def reports(outputs: list[BodyOutput]) -> list[Report]:
    """What the chassis reports say in each tick."""
    return [out.measurement.report for out in outputs]


def fixes(outputs: list[BodyOutput]) -> list[Ins]:
    """What the INS says in each tick."""
    return [out.measurement.ins for out in outputs]


def same(one: Any, other: Any) -> bool:
    """Equal records, a field that is absent (NaN) in both included."""
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
    return one == other or (one != one and other != other)


def through(name: str, params: dict[str, float], values: list[Any], rest: float = 0.0) -> list[Any]:
    """What an effect makes of values on its port, one a tick."""
    return run(make_effect(EFFECTS[name], params, rest=rest), values, DT_S)
