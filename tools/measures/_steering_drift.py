"""An effect for `mrac`: the steering actuator drifts within a drive, as one does that warms up or loses pressure.

Gain, lag and dead time go linearly from those of the actuator to the changed ones, and stay there. What drifts is what
MRAC sees: the reported angle.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Block, Effect, Port
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import buffer, kernel

PARAMETERS = {"gain_change": "1", "lag_s": "s", "delay_s": "s", "over_s": "s"}
NEUTRAL = {"gain_change": 0.0, "lag_s": 0.0, "delay_s": 0.0, "over_s": 15.0}


class DriftParams(NamedTuple):
    """What is added at the end of the drift; gain_change: share of the gain."""

    gain_change: float
    lag_s: float
    delay_s: float
    over_s: float  # not 0: checked by `make`


class DriftState(NamedTuple):
    """Ring of inputs with the newest one's place, the lag's output, and time since the start."""

    line: Any
    place: int
    output: float
    time_s: float


def make(params: dict[str, float], rest: float) -> Block:
    """Block on the steering-wheel angle, rad; without a change it is the identity."""
    wrong = [name for name in ("lag_s", "delay_s") if not params[name] >= 0.0] + (
        [] if params["over_s"] > 0.0 else ["over_s"]
    )
    if wrong:
        raise InputError(f"{wrong[0]} = {params[wrong[0]]}", code="bad_effect_parameter", key=wrong[0])
    return Block(init, step, DriftParams(**{name: params[name] for name in DriftParams._fields}))


def init(params: DriftParams, dt_s: float) -> DriftState:
    """At rest."""
    return DriftState(buffer(math.floor(params.delay_s / dt_s + 1e-9) + 2), 0, 0.0, 0.0)


@kernel
def step(params: DriftParams, state: DriftState, x: float, dt_s: float) -> tuple[DriftState, float]:
    """The input after the delay, the lag and the gain of now."""
    line, place, length = state.line, state.place, len(state.line)
    line[place] = x
    share = state.time_s / params.over_s
    if share > 1.0:
        share = 1.0
    ticks = share * params.delay_s / dt_s  # not 0: a tick
    whole = int(ticks)
    newer = place - whole
    if newer < 0:
        newer += length
    older = newer - 1
    if older < 0:
        older += length
    late = float(line[newer])
    if ticks > whole:
        late += (ticks - whole) * (float(line[older]) - late)
    lag_s = share * params.lag_s
    output = late
    if lag_s > 0.0:
        output = state.output + (1.0 - math.exp(-dt_s / lag_s)) * (late - state.output)
    y = output
    if params.gain_change != 0.0:
        y = (1.0 + share * params.gain_change) * output
    place += 1
    if place == length:
        place = 0
    return DriftState(line, place, output, state.time_s + dt_s), y


EFFECT = Effect(Port.STEER_A, NEUTRAL, PARAMETERS, make, "the reported steering follows its command ever less well")
