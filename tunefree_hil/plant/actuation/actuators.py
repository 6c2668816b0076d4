"""By-wire actuators: dead time, lag of order 1 or 2, rate limit, dead band, gain, offset.

The command is constant between two ticks, so dead time (also a fraction of a tick) and lag are solved exactly; only
the rate limit is applied to the step as a whole.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block, buffer, kernel
from tunefree_hil.base.records import Actuation, Command


class ActuatorParams(NamedTuple):
    """One channel, in its own unit (duty, or rad at the steering wheel).

    output = lag(dead time(rest + offset + gain * band(command - rest))), its slope within +-rate_limit per s. The dead
    band takes `dead_band` off either side of rest, not rescaled. order 1 uses lag_s; order 2 natural_hz and damping.
    """

    dead_time_s: float = 0.0
    order: float = 1.0
    lag_s: float = 0.0
    natural_hz: float = 0.0
    damping: float = 1.0
    rate_limit: float = math.inf
    dead_band: float = 0.0
    gain: float = 1.0
    offset: float = 0.0
    rest: float = 0.0
    initial: float = 0.0  # the constant command before tick 0


class Lag(NamedTuple):
    """One step of dead time and lag: the weights of the new and the old command in the output."""

    output_new: float
    output_old: float
    output_slope: float
    slope_new: float
    slope_old: float
    slope_slope: float
    most: float  # largest change of the output in one step


class ActuatorState(NamedTuple):
    """Delay line (n whole ticks, and one more for the fraction), the output, and its slope (order 2)."""

    lag: Lag
    line: Any
    place: int
    output: float
    slope: float


@kernel
def shaped(params: ActuatorParams, command: float) -> float:
    """Dead band about rest, gain, offset."""
    over = command - params.rest
    if over > params.dead_band:
        over = over - params.dead_band
    elif over < -params.dead_band:
        over = over + params.dead_band
    else:
        over = 0.0
    return params.rest + params.offset + params.gain * over


def init_actuator(params: ActuatorParams, dt_s: float) -> ActuatorState:
    """The state at rest on `params.initial`. Raises InputError for parameters that are not valid."""
    _check(params)
    whole = math.floor(params.dead_time_s / dt_s + 1e-9)
    rest_s = max(params.dead_time_s - whole * dt_s, 0.0)
    first = float(shaped(params, params.initial))
    return ActuatorState(_lag(params, dt_s, rest_s), buffer(whole + 1, first), 0, first, 0.0)


@kernel
def step_actuator(params: ActuatorParams, state: ActuatorState, x: float, dt_s: float) -> tuple[ActuatorState, float]:
    """One tick: the command is `x` from now on; the output is that at the end of the tick."""
    lag, line, place, output = state.lag, state.line, state.place, state.output
    old = line[place] - output
    line[place] = shaped(params, x)
    place = place + 1
    if place == len(line):
        place = 0
    new = line[place] - output
    change = lag.output_new * new + lag.output_old * old + lag.output_slope * state.slope
    slope = lag.slope_new * new + lag.slope_old * old + lag.slope_slope * state.slope
    if change > lag.most:
        change, slope = lag.most, params.rate_limit
    elif change < -lag.most:
        change, slope = -lag.most, -params.rate_limit
    output = output + change
    return ActuatorState(lag, line, place, output, slope), output


def actuator(params: ActuatorParams) -> Block:
    """One channel as a Block on a float."""
    return Block(init_actuator, step_actuator, params)


def actuators(throttle: ActuatorParams, brake: ActuatorParams, steer: ActuatorParams) -> Block:
    """The three channels as a Block Command -> Actuation; the gear changes without delay."""

    def init(params: Any, dt_s: float) -> Any:
        return (init_actuator(params[0], dt_s), init_actuator(params[1], dt_s), init_actuator(params[2], dt_s))

    @kernel
    def step(params: Any, state: Any, x: Command, dt_s: float) -> tuple[Any, Actuation]:
        throttle_state, throttle_frac = step_actuator(params[0], state[0], x.throttle_frac, dt_s)
        brake_state, brake_frac = step_actuator(params[1], state[1], x.brake_frac, dt_s)
        steer_state, steer_rad = step_actuator(params[2], state[2], x.steer_rad, dt_s)
        return (throttle_state, brake_state, steer_state), Actuation(throttle_frac, brake_frac, steer_rad, x.gear)

    return Block(init, step, (throttle, brake, steer))


def _check(params: ActuatorParams) -> None:
    bad = [name for name in ("dead_time_s", "lag_s", "natural_hz", "dead_band") if not getattr(params, name) >= 0.0]
    if not params.rate_limit > 0.0:
        bad.append("rate_limit")
    if params.order not in (1, 2) or (params.order == 2 and not (params.natural_hz > 0.0 and params.damping > 0.0)):
        bad.append("order")
    if bad:
        raise InputError(
            f"no actuator has these {', '.join(bad)}: {params}",
            code="bad_actuator",
            key=f"actuators.{bad[0]}",
            hint="times and bands >= 0, rate_limit > 0, order 1 with lag_s or 2 with natural_hz > 0 and damping > 0",
        )


def _lag(params: ActuatorParams, dt_s: float, rest_s: float) -> Lag:
    """Weights for a held command that changes `rest_s` after the start of the step (the fraction of the dead time)."""
    most = params.rate_limit * dt_s
    if params.order == 2:
        whole = _free_motion(params, dt_s)
        part = _free_motion(params, dt_s - rest_s)
        return Lag(
            output_new=1.0 - part.a11,
            output_old=part.a11 - whole.a11,
            output_slope=whole.a12,
            slope_new=-part.a21,
            slope_old=part.a21 - whole.a21,
            slope_slope=whole.a22,
            most=most,
        )
    if params.lag_s == 0.0:
        share = rest_s / dt_s  # no lag: the mean over the tick, which is continuous in the dead time
        return Lag(1.0 - share, share, 0.0, 0.0, 0.0, 0.0, most)
    kept = math.exp(-dt_s / params.lag_s)
    part_kept = math.exp(-(dt_s - rest_s) / params.lag_s)
    return Lag(1.0 - part_kept, part_kept - kept, 0.0, 0.0, 0.0, 0.0, most)


class Transition(NamedTuple):
    """A 2 x 2 matrix exp(A t) by rows."""

    a11: float
    a12: float
    a21: float
    a22: float


def _free_motion(params: ActuatorParams, time_s: float) -> Transition:
    """exp(A t) of A = [[0, 1], [-w^2, -2 d w]], the homogeneous second-order lag."""
    natural = 2.0 * math.pi * params.natural_hz
    damped = params.damping * natural
    inner = natural * natural - damped * damped
    fade = math.exp(-damped * time_s)
    if abs(inner) < 1e-12 * natural * natural:
        cosine, sine = 1.0, time_s
    elif inner > 0.0:
        ring = math.sqrt(inner)
        cosine, sine = math.cos(ring * time_s), math.sin(ring * time_s) / ring
    else:
        ring = math.sqrt(-inner)
        cosine, sine = math.cosh(ring * time_s), math.sinh(ring * time_s) / ring
    return Transition(
        fade * (cosine + damped * sine),
        fade * sine,
        -fade * natural * natural * sine,
        fade * (cosine - damped * sine),
    )
