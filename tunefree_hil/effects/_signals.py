"""Blocks on a float for effects on one signal; they are exact identities when neutral."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block, buffer, kernel


def positive(name: str, value: float, *, zero: bool = True) -> float:
    """`value`, or InputError when it is negative, infinite or no number (or 0, unless `zero`)."""
    if math.isfinite(value) and (value > 0.0 or (zero and value == 0.0)):
        return value
    least = "0 or more" if zero else "more than 0"
    raise InputError(
        f"{name} = {value}", code="bad_effect_parameter", key=name, hint=f"{name} must be finite and {least}"
    )


def finite(name: str, value: float, most: float = math.inf) -> float:
    """`value`, or InputError when it is infinite, no number, or `most` or more to either side."""
    if math.isfinite(value) and abs(value) < most:
        return value
    within = f" and within +-{most:.6g}" if math.isfinite(most) else ""
    raise InputError(f"{name} = {value}", code="bad_effect_parameter", key=name, hint=f"{name} must be finite{within}")


class DeadTimeState(NamedTuple):
    """Delay line of the whole ticks and one more, its index, and the remaining share of a tick."""

    line: Any
    place: int
    share: float


@kernel
def step_dead_time(params: Any, state: DeadTimeState, x: float, dt_s: float) -> tuple[DeadTimeState, float]:
    """The input `delay_s` ago, linear between two ticks."""
    line, place = state.line, state.place
    old = line[place]
    line[place] = x
    place = place + 1
    if place == len(line):
        place = 0
    new = line[place]
    return DeadTimeState(line, place, state.share), float(new + state.share * (old - new))


def dead_time(delay_s: float, rest: float) -> Block:
    """Pure delay of a float that was at `rest` before tick 0; delay_s = 0 is the identity."""

    def init(params: tuple[float, float], dt_s: float) -> DeadTimeState:
        delay, first = params
        whole = math.floor(delay / dt_s + 1e-9)
        return DeadTimeState(buffer(whole + 1, first), 0, max(delay / dt_s - whole, 0.0))

    return Block(init, step_dead_time, (positive("delay_s", delay_s), rest))


class LagState(NamedTuple):
    """Output, and the share of the difference to the input covered in one tick."""

    output: float
    share: float


@kernel
def step_lag(params: Any, state: LagState, x: float, dt_s: float) -> tuple[LagState, float]:
    """First-order lag of a held input, solved exactly."""
    output = x if state.share >= 1.0 else state.output + state.share * (x - state.output)
    return LagState(output, state.share), output


def lag(tau_s: float, rest: float) -> Block:
    """First-order lag of a float that was at `rest` before tick 0; tau_s = 0 is the identity."""

    def init(params: tuple[float, float], dt_s: float) -> LagState:
        tau, first = params
        return LagState(first, 1.0 if tau == 0.0 else 1.0 - math.exp(-dt_s / tau))

    return Block(init, step_lag, (positive("tau_s", tau_s), rest))


class SoftState(NamedTuple):
    """Output, the newest input, and the weights of the previous input and of the newest change."""

    output: float
    before: float
    share: float
    fresh: float


@kernel
def step_soft(params: Any, state: SoftState, x: float, dt_s: float) -> tuple[SoftState, float]:
    """First-order lag of an input that is linear between ticks, solved exactly."""
    if state.fresh >= 1.0:
        output = x
    else:
        change = x - state.before
        output = state.output + state.share * (state.before - state.output) + state.fresh * change
    return SoftState(output, x, state.share, state.fresh), output


def soft(tau_s: float, rest: float) -> Block:
    """First-order lag of a continuous quantity of the car; tau_s = 0 is the identity.

    `lag` is for commands, which are constant over a tick; here it would be half a tick too early.
    """

    def init(params: tuple[float, float], dt_s: float) -> SoftState:
        tau, first = params
        share = 1.0 if tau == 0.0 else -math.expm1(-dt_s / tau)
        fresh = 1.0 if tau == 0.0 else 1.0 - tau / dt_s * share
        return SoftState(first, first, share, fresh)

    return Block(init, step_soft, (positive("tau_s", tau_s), rest))


@kernel
def step_rate_limit(params: float, state: float, x: float, dt_s: float) -> tuple[float, float]:
    """Follows the input no faster than `params` a second."""
    most = params * dt_s
    if x > state + most:
        y = state + most
    elif x < state - most:
        y = state - most
    else:
        y = x
    return y, y


def rate_limit(name: str, rate: float, rest: float) -> Block:
    """Rate limit of a float that was at `rest` before tick 0; an infinite rate is the identity."""
    if not rate > 0.0:
        raise InputError(f"{name} = {rate}", code="bad_effect_parameter", key=name, hint=f"{name} must be more than 0")
    return Block(lambda params, dt_s: rest, step_rate_limit, float(rate))


@kernel
def step_play(params: float, state: float, x: float, dt_s: float) -> tuple[float, float]:
    """Constant until the input is more than `params` away, then follows at that distance."""
    if x > state + params:
        y = x - params
    elif x < state - params:
        y = x + params
    elif params == 0.0:
        y = x
    else:
        y = state
    return y, y


def play(name: str, half_width: float, rest: float) -> Block:
    """Backlash of a float, centred at `rest`; half_width = 0 is the identity."""
    return Block(lambda params, dt_s: rest, step_play, positive(name, half_width))


class SignalShape(NamedTuple):
    """A curve through rest: `half_width` of the input is lost on each side, the rest is multiplied by `gain`."""

    rest: float
    half_width: float
    gain: float
    limit: float


@kernel
def step_shape(params: SignalShape, state: float, x: float, dt_s: float) -> tuple[float, float]:
    """The curve, without state. Neutral parts are left out to avoid rounding."""
    y = x
    over = y - params.rest
    if params.half_width > 0.0:
        if over > params.half_width:
            y = y - params.half_width
        elif over < -params.half_width:
            y = y + params.half_width
        else:
            y = params.rest
    if params.gain != 1.0:
        y = params.rest + params.gain * (y - params.rest)
    if y > params.rest + params.limit:
        y = params.rest + params.limit
    elif y < params.rest - params.limit:
        y = params.rest - params.limit
    return state, y


def shape(rest: float, *, half_width: float = 0.0, gain: float = 1.0, limit: float = math.inf) -> Block:
    """A curve about `rest` as a Block on a float; the caller checks the numbers."""
    return Block(lambda params, dt_s: 0.0, step_shape, SignalShape(rest, half_width, gain, limit))


@kernel
def step_offset(params: float, state: float, x: float, dt_s: float) -> tuple[float, float]:
    """The input and a constant."""
    return state, x + params


def offset(name: str, value: float) -> Block:
    """A constant added to a float."""
    return Block(lambda params, dt_s: 0.0, step_offset, finite(name, value))


@kernel
def step_gain(params: float, state: float, x: float, dt_s: float) -> tuple[float, float]:
    """The input times a constant."""
    return state, params * x


def gain(name: str, value: float) -> Block:
    """A factor on a float."""
    return Block(lambda params, dt_s: 0.0, step_gain, positive(name, value, zero=False))
