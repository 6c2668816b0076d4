"""The unknowns of one by-wire channel, and its simulation by the very kernel that drives the bench (design D5)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.kernel import kept, kernel
from tunefree_hil.learn.actuators.samples import Pair
from tunefree_hil.learn.drives.smoothing import smooth
from tunefree_hil.plant.actuation.actuators import (
    ActuatorParams,
    ActuatorState,
    Lag,
    init_actuator,
    shaped,
    step_actuator,
)

Array = np.ndarray

MOST_DEAD_S, LEAST_LAG_S, MOST_LAG_S = 1.0, 5e-4, 3.0
NEAR_LIMIT = 0.6  # of the rate limit: from here on a real drive may be limited already
DEAD_UNIT_S, GAIN_UNIT, SPAN_UNIT = 0.02, 0.1, 0.05  # one unit of a scaled unknown (learn/robust_least_squares.py)


class Shape(NamedTuple):
    """Which unknowns there are: dead time, gain and offset always. order 0 has no lag at all.

    uneven: order 1 whose lag upwards is e^u times, downwards e^-u times lag_s. The bench's actuator cannot do that; but
    a fit that must not see it lays the difference into the dead time.
    """

    order: int
    limited: bool
    banded: bool = False
    uneven: bool = False

    def names(self) -> tuple[str, ...]:
        """The unknowns in the order in which they stand in a vector."""
        lag: tuple[str, ...] = ((), ("lag_s",), ("natural_hz", "damping"))[self.order]
        more = ("rate_limit",) * self.limited + ("dead_band",) * self.banded + ("uneven",) * self.uneven
        return ("dead_time_s", *lag, "gain", "offset", *more)


class Way(NamedTuple):
    """A channel's params, and how much its lag depends on the direction (Shape.uneven), 0 for not at all."""

    params: ActuatorParams
    uneven: float = 0.0

    def even(self) -> Way:
        """The actuator of the bench that comes nearest: its lag is the mean of both ways."""
        return Way(self.params._replace(lag_s=self.params.lag_s * math.cosh(self.uneven)))


class Scale(NamedTuple):
    """What a channel's numbers are measured in: rest, span of its commands, a rate of its output, and doubt.

    sigma: standard deviation of the report, from its noise and its rounding.
    """

    rest: float
    span: float
    rate: float
    sigma: float


# value = to_value(scaled), per unknown; logarithms where only ratios count
_LOGS = {"lag_s": 0.05, "natural_hz": 3.0, "damping": 1.0}
_LIMITS = {
    "dead_time_s": (0.0, MOST_DEAD_S),
    "lag_s": (LEAST_LAG_S, MOST_LAG_S),
    "natural_hz": (0.1, 40.0),
    "damping": (0.2, 5.0),
    "gain": (0.2, 3.0),
    "uneven": (-1.0, 1.0),
}


def scaled(name: str, value: float, scale: Scale) -> float:
    """The unknown that stands for a value."""
    if name in _LOGS:
        return math.log(value / _LOGS[name])
    if name == "rate_limit":
        return math.log(value / scale.rate)
    if name == "uneven":
        return value
    if name == "dead_time_s":
        return value / DEAD_UNIT_S
    return (value - 1.0) / GAIN_UNIT if name == "gain" else value / (SPAN_UNIT * scale.span)


def value_at(name: str, unknown: float, scale: Scale) -> float:
    """The value that an unknown stands for."""
    if name in _LOGS:
        return _LOGS[name] * math.exp(unknown)
    if name == "rate_limit":
        return scale.rate * math.exp(unknown)
    if name == "uneven":
        return unknown
    if name == "dead_time_s":
        return unknown * DEAD_UNIT_S
    return 1.0 + unknown * GAIN_UNIT if name == "gain" else unknown * SPAN_UNIT * scale.span


def bounds(shape: Shape, scale: Scale) -> tuple[Array, Array]:
    """(lowest, highest) unknowns."""
    limits = {
        **_LIMITS,
        "offset": (-0.5 * scale.span, 0.5 * scale.span),
        "rate_limit": (0.05 * scale.rate, 50.0 * scale.rate),
        "dead_band": (0.0, 0.3 * scale.span),
    }
    ends = [[scaled(name, end, scale) for end in limits[name]] for name in shape.names()]
    return np.array([low for low, _ in ends]), np.array([high for _, high in ends])


def vector(shape: Shape, values: dict[str, float], scale: Scale) -> Array:
    """Unknowns at the values given, others neutral."""
    neutral = {"gain": 1.0, "offset": 0.0, "dead_band": 0.0, "rate_limit": scale.rate, "damping": 1.0, "uneven": 0.0}
    return np.array([scaled(name, {**neutral, **values}[name], scale) for name in shape.names()])


def params_at(shape: Shape, x: Array, scale: Scale, rate_limit: float = math.inf) -> Way:
    """The channel at unknowns; rate_limit: of a shape that has none of its own."""
    values = {name: float(value_at(name, float(one), scale)) for name, one in zip(shape.names(), x, strict=True)}
    uneven = values.pop("uneven", 0.0)
    values = {"rate_limit": float(rate_limit), **values}
    return Way(ActuatorParams(order=2.0 if shape.order == 2 else 1.0, rest=scale.rest, **values), uneven)


@kernel
def respond(params: ActuatorParams, state: ActuatorState, down: Lag, commands: Any, outputs: Any, dt_s: float) -> int:
    """Drive a channel with `commands`, one a tick, and write what it puts out; how many there were.

    The lag is the state's own upwards, `down` downwards.
    """
    up = state.lag
    for i in range(len(commands)):
        command = float(commands[i])
        coming = state.place + 1
        if coming == len(state.line):
            coming = 0
        target = shaped(params, command) if len(state.line) == 1 else state.line[coming]
        lag = up if target > state.output else down
        state = ActuatorState(lag, state.line, state.place, state.output, state.slope)
        state, output = step_actuator(params, state, command, dt_s)
        outputs[i] = output
    return len(commands)


kept(respond)


def answered(way: Way, command: Array, dt_s: float) -> Array:
    """Outputs [n] of the channel for commands [n], from rest on the first."""
    start = way.params._replace(initial=float(command[0]))
    up, down = (start._replace(lag_s=start.lag_s * math.exp(sign * way.uneven)) for sign in (1.0, -1.0))
    outputs = np.empty(len(command))
    respond(start, init_actuator(up, dt_s), init_actuator(down, dt_s).lag, command, outputs, dt_s)
    return outputs


def simulated(way: Way, pair: Pair) -> Array:
    """Outputs [n] of the channel for a pair's commands, from rest on the first; filtered as the pair's output is."""
    outputs = answered(way, pair.command, pair.dt_s)
    return smooth_rate(outputs, pair.window, pair.dt_s) if pair.window else outputs


def smooth_rate(rate: Array, window: int, dt_s: float) -> Array:
    """A rate as it looks when it is taken from its own integral by learn/drives/smoothing.py's filter."""
    from scipy.signal import savgol_filter

    if len(rate) < window:
        return smooth(rate, window)
    return np.asarray(savgol_filter(np.cumsum(rate) * dt_s, window, 2, deriv=1, delta=dt_s))


def misses(way: Way, some: Sequence[Pair], sigma: float) -> Array:
    """Simulated minus reported output wherever it counts, in sigmas."""
    if not some:
        return np.zeros(0)
    return np.concatenate([(simulated(way, pair) - pair.output)[pair.counts] for pair in some]) / sigma


def rate_seen(some: Sequence[Pair]) -> float:
    """The fastest change of the reported output that is not noise, per s: over three reports, all but a thousandth."""
    rates = [np.zeros(1)]
    for pair in some:
        ticks = np.flatnonzero(pair.counts)
        if len(ticks) > 3:
            rates.append(
                np.abs(pair.output[ticks[3:]] - pair.output[ticks[:-3]]) / (ticks[3:] - ticks[:-3]) / pair.dt_s
            )
    return float(np.quantile(np.concatenate(rates), 0.999))


def at_limit(way: Way, pair: Pair, share: float) -> Array:
    """Ticks [n] in which the simulated output moves at `share` of its rate limit, or faster."""
    moves = np.abs(np.diff(simulated(way, pair._replace(window=0)), prepend=np.nan))
    return moves >= share * way.params.rate_limit * pair.dt_s


def seconds_at_limit(way: Way, some: Sequence[Pair]) -> float:
    """For how long the simulated output moves as fast as it may."""
    return float(sum(float(np.sum(at_limit(way, pair, 0.999))) * pair.dt_s for pair in some))


def calm(way: Way, some: Sequence[Pair], before_s: float, after_s: float) -> list[Pair]:
    """The same stretches, only compared where no rate limit was near, is, or will be within these times.

    What sets in before: a drive whose motor is still getting up to speed may have been told no more than its limit.
    """
    found = []
    for pair in some:
        busy = at_limit(way, pair, NEAR_LIMIT)
        rows, far = np.arange(len(busy)), 2 * len(busy)
        last = np.maximum.accumulate(np.where(busy, rows, -far))
        following = np.minimum.accumulate(np.where(busy, rows, far)[::-1])[::-1]
        counts = pair.counts & (rows - last > round(after_s / pair.dt_s))
        counts &= following - rows > round(before_s / pair.dt_s)
        if counts.any():
            found.append(pair._replace(counts=counts))
    return found
