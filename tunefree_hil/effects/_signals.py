"""What effects on one signal have in common: dead time and lag as Blocks on a float, exact identities when neutral."""

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


class DeadTimeState(NamedTuple):
    """Delay line of the whole ticks and one more, its place, and the share of the tick that is left over."""

    line: Any
    place: int
    share: float


@kernel
def step_dead_time(params: Any, state: DeadTimeState, x: float, dt_s: float) -> tuple[DeadTimeState, float]:
    """What went in `delay_s` ago; between two ticks a straight line."""
    line, place = state.line, state.place
    old = line[place]
    line[place] = x
    place = place + 1
    if place == len(line):
        place = 0
    new = line[place]
    return DeadTimeState(line, place, state.share), float(new + state.share * (old - new))


def dead_time(delay_s: float, rest: float) -> Block:
    """Pure delay of a float that has been at `rest` for ever; delay_s = 0 is the identity."""

    def init(params: tuple[float, float], dt_s: float) -> DeadTimeState:
        delay, first = params
        whole = math.floor(delay / dt_s + 1e-9)
        return DeadTimeState(buffer(whole + 1, first), 0, max(delay / dt_s - whole, 0.0))

    return Block(init, step_dead_time, (positive("delay_s", delay_s), rest))


class LagState(NamedTuple):
    """Output, and the share of the way to the input that one tick goes."""

    output: float
    share: float


@kernel
def step_lag(params: Any, state: LagState, x: float, dt_s: float) -> tuple[LagState, float]:
    """First-order lag of a held input, solved exactly."""
    output = x if state.share >= 1.0 else state.output + state.share * (x - state.output)
    return LagState(output, state.share), output


def lag(tau_s: float, rest: float) -> Block:
    """First-order lag of a float that has been at `rest` for ever; tau_s = 0 is the identity."""

    def init(params: tuple[float, float], dt_s: float) -> LagState:
        tau, first = params
        return LagState(first, 1.0 if tau == 0.0 else 1.0 - math.exp(-dt_s / tau))

    return Block(init, step_lag, (positive("tau_s", tau_s), rest))
