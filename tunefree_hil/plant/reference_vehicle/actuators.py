"""The reference vehicle's own actuators: servo steering, and pedals that press more slowly than they release.

Unlike in `plant/actuation/actuators.py` the steering is a position servo whose motor accelerates with a lag, and the
lag of the pedals depends on the direction. A model of dead time, one lag and a rate limit fits well, not exactly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.base.kernel import Block, buffer, kernel
from tunefree_hil.base.records import Actuation, Command

DEFAULTS: dict[str, float] = {
    "steer_dead_time_s": 0.10,
    "steer_lag_s": 0.07,
    "steer_motor_s": 0.015,
    "steer_rate_radps": 8.55,
    "throttle_dead_time_s": 0.03,
    "throttle_press_s": 0.06,
    "throttle_release_s": 0.04,
    "brake_dead_time_s": 0.02,
    "brake_press_s": 0.06,
    "brake_release_s": 0.04,
    "rest_pedal_frac": 0.15,
}
DEAD_TIMES = ("steer_dead_time_s", "throttle_dead_time_s", "brake_dead_time_s")
LAGS = (
    "steer_lag_s",
    "steer_motor_s",
    "throttle_press_s",
    "throttle_release_s",
    "brake_press_s",
    "brake_release_s",
)


class OwnParams(NamedTuple):
    """Times of the three channels; pedals as (dead time, press, release)."""

    throttle_s: tuple[float, float, float]
    brake_s: tuple[float, float, float]
    steer_dead_s: float
    steer_lag_s: float  # not 0
    steer_motor_s: float
    steer_rate_radps: float
    rest_frac: float


class Pedal(NamedTuple):
    """Delay line, its index, output; shares of the difference covered in one step."""

    line: Any
    place: int
    output: float
    press: float
    release: float


class Wheel(NamedTuple):
    """Steering: delay line, its index, angle, rate of the motor; share of the rate difference covered in one step."""

    line: Any
    place: int
    angle_rad: float
    rate_radps: float
    motor: float


class OwnState(NamedTuple):
    """All three."""

    throttle: Pedal
    brake: Pedal
    wheel: Wheel


@kernel
def late(line: Any, place: int, value: float) -> float:
    """Write `value` and return the oldest value; the caller advances the index."""
    oldest = float(line[place])
    line[place] = value
    return oldest


@kernel
def step_pedal(state: Pedal, command: float) -> Pedal:
    """One step of a pedal."""
    target = late(state.line, state.place, command)
    place = state.place + 1 if state.place + 1 < len(state.line) else 0
    share = state.press if target > state.output else state.release
    return Pedal(state.line, place, state.output + share * (target - state.output), state.press, state.release)


@kernel
def step_wheel(params: OwnParams, state: Wheel, command: float, dt_s: float) -> Wheel:
    """One step of the servo: the demanded rate is proportional to the angle error and limited."""
    target = late(state.line, state.place, command)
    place = state.place + 1 if state.place + 1 < len(state.line) else 0
    wish = (target - state.angle_rad) / params.steer_lag_s
    if wish > params.steer_rate_radps:
        wish = params.steer_rate_radps
    elif wish < -params.steer_rate_radps:
        wish = -params.steer_rate_radps
    rate = state.rate_radps + state.motor * (wish - state.rate_radps)
    return Wheel(state.line, place, state.angle_rad + rate * dt_s, rate, state.motor)


@kernel
def step_own(params: OwnParams, state: OwnState, x: Command, dt_s: float) -> tuple[OwnState, Actuation]:
    """One step of all three."""
    throttle = step_pedal(state.throttle, x.throttle_frac)
    brake = step_pedal(state.brake, x.brake_frac)
    wheel = step_wheel(params, state.wheel, x.steer_rad, dt_s)
    return OwnState(throttle, brake, wheel), Actuation(throttle.output, brake.output, wheel.angle_rad, x.gear)


def init_own(params: OwnParams, dt_s: float) -> OwnState:
    """At rest. The command at the beginning of a step reaches the output `dead time` later, in whole steps."""
    throttle, brake = (_pedal(times, params.rest_frac, dt_s) for times in (params.throttle_s, params.brake_s))
    line = buffer(_steps(params.steer_dead_s, dt_s))
    return OwnState(throttle, brake, Wheel(line, 0, 0.0, 0.0, 1.0 - math.exp(-dt_s / params.steer_motor_s)))


def _steps(dead_s: float, dt_s: float) -> int:
    return max(round(dead_s / dt_s), 1)


def _pedal(times: tuple[float, float, float], rest: float, dt_s: float) -> Pedal:
    dead_s, press_s, release_s = times
    shares = (1.0 - math.exp(-dt_s / press_s), 1.0 - math.exp(-dt_s / release_s))
    return Pedal(buffer(_steps(dead_s, dt_s), rest), 0, rest, *shares)


def own_actuators(values: Mapping[str, float]) -> Block:
    """Block Command -> Actuation from the values of DEFAULTS' keys (other keys are ignored)."""
    v = {**DEFAULTS, **{key: value for key, value in values.items() if key in DEFAULTS}}
    throttle, brake = (
        (v[f"{pedal}_dead_time_s"], v[f"{pedal}_press_s"], v[f"{pedal}_release_s"]) for pedal in ("throttle", "brake")
    )
    params = OwnParams(
        throttle,
        brake,
        v["steer_dead_time_s"],
        v["steer_lag_s"],
        v["steer_motor_s"],
        v["steer_rate_radps"],
        v["rest_pedal_frac"],
    )
    return Block(init_own, step_own, params)
