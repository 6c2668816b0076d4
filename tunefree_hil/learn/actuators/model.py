"""The unknowns of one by-wire channel, and its simulation by the actuator kernel of the bench."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from tunefree_hil.base.kernel import kept, kernel
from tunefree_hil.learn.actuators.samples import ActuatorSamples
from tunefree_hil.learn.drives.smoothing import smooth_signal
from tunefree_hil.plant.actuation.actuators import (
    ActuatorParams,
    ActuatorState,
    Lag,
    init_actuator,
    shaped,
    step_actuator,
)

Array = np.ndarray


class ModelBounds(NamedTuple):
    """Search bounds of the unknowns; every value is an engineering choice."""

    dead_time_s: tuple[float, float] = (0.0, 1.0)
    lag_s: tuple[float, float] = (5e-4, 3.0)
    natural_hz: tuple[float, float] = (0.1, 40.0)
    damping: tuple[float, float] = (0.2, 5.0)
    gain: tuple[float, float] = (0.2, 3.0)
    asymmetry: tuple[float, float] = (-1.0, 1.0)
    max_offset_share: float = 0.5  # of the commands' span
    rate_limit_share: tuple[float, float] = (0.05, 50.0)  # of the output's peak rate
    max_dead_band_share: float = 0.3  # of the commands' span


class RateLimitCriteria(NamedTuple):
    """What counts as near a rate limit; every value is an engineering choice."""

    near_share: float = 0.6  # of the rate limit: from here on a real drive may already be limited
    reached_share: float = 0.999  # of the rate limit: it is reached
    peak_rate_reports: int = 3  # over which the output's peak rate is taken
    peak_rate_quantile: float = 0.999  # of those rates: the fastest 0.1 % are left out


BOUNDS = ModelBounds()
RATE_LIMIT = RateLimitCriteria()
# Step of a value per unit of its scaled unknown (learn/robust_least_squares.py); of a logarithmic one its value at 0.
DEAD_TIME_UNIT_S, GAIN_UNIT, SPAN_UNIT = 0.02, 0.1, 0.05
LOG_REFERENCES = {"lag_s": 0.05, "natural_hz": 3.0, "damping": 1.0}


class ActuatorStructure(NamedTuple):
    """Which unknowns a model of a channel has beside dead time, gain and offset.

    An asymmetric model of order 1 has a lag of lag_s * exp(asymmetry) upwards and lag_s * exp(-asymmetry) downwards.
    The actuator of the bench has one lag; but a fit with one lag puts the difference into the dead time.
    """

    order: int  # 0: no lag
    has_rate_limit: bool
    has_dead_band: bool = False
    is_asymmetric: bool = False

    def unknown_names(self) -> tuple[str, ...]:
        """The unknowns in the order of a vector of them."""
        lag: tuple[str, ...] = ((), ("lag_s",), ("natural_hz", "damping"))[self.order]
        optional = ("rate_limit",) * self.has_rate_limit + ("dead_band",) * self.has_dead_band
        return ("dead_time_s", *lag, "gain", "offset", *optional, *("asymmetry",) * self.is_asymmetric)


class ActuatorModel(NamedTuple):
    """Parameters of a channel, and the asymmetry of its lag (ActuatorStructure), 0 for none."""

    params: ActuatorParams
    asymmetry: float = 0.0

    def symmetric_model(self) -> ActuatorModel:
        """The nearest model of the bench's kind: its lag is the mean of both directions."""
        return ActuatorModel(self.params._replace(lag_s=self.params.lag_s * math.cosh(self.asymmetry)))


class ActuatorScale(NamedTuple):
    """The units of a channel's numbers."""

    rest: float  # command at rest
    span: float  # of the commands
    rate: float  # peak rate of the output, per s
    sigma: float  # standard deviation of a reported output, from its noise and its quantisation


def unknown_from_value(name: str, value: float, scale: ActuatorScale) -> float:
    """The scaled unknown of a value."""
    if name in LOG_REFERENCES:
        return math.log(value / LOG_REFERENCES[name])
    if name == "rate_limit":
        return math.log(value / scale.rate)
    if name == "asymmetry":
        return value
    if name == "dead_time_s":
        return value / DEAD_TIME_UNIT_S
    return (value - 1.0) / GAIN_UNIT if name == "gain" else value / (SPAN_UNIT * scale.span)


def value_from_unknown(name: str, unknown: float, scale: ActuatorScale) -> float:
    """The value of a scaled unknown."""
    if name in LOG_REFERENCES:
        return LOG_REFERENCES[name] * math.exp(unknown)
    if name == "rate_limit":
        return scale.rate * math.exp(unknown)
    if name == "asymmetry":
        return unknown
    if name == "dead_time_s":
        return unknown * DEAD_TIME_UNIT_S
    return 1.0 + unknown * GAIN_UNIT if name == "gain" else unknown * SPAN_UNIT * scale.span


def unknown_bounds(structure: ActuatorStructure, scale: ActuatorScale) -> tuple[Array, Array]:
    """(lowest, highest) unknowns, each of shape (n_unknowns,)."""
    low_rate_share, high_rate_share = BOUNDS.rate_limit_share
    limits = {
        "dead_time_s": BOUNDS.dead_time_s,
        "lag_s": BOUNDS.lag_s,
        "natural_hz": BOUNDS.natural_hz,
        "damping": BOUNDS.damping,
        "gain": BOUNDS.gain,
        "asymmetry": BOUNDS.asymmetry,
        "offset": (-BOUNDS.max_offset_share * scale.span, BOUNDS.max_offset_share * scale.span),
        "rate_limit": (low_rate_share * scale.rate, high_rate_share * scale.rate),
        "dead_band": (0.0, BOUNDS.max_dead_band_share * scale.span),
    }
    ends = [[unknown_from_value(name, end, scale) for end in limits[name]] for name in structure.unknown_names()]
    return np.array([low for low, _ in ends]), np.array([high for _, high in ends])


def unknowns_from_values(structure: ActuatorStructure, values: dict[str, float], scale: ActuatorScale) -> Array:
    """The unknowns of these values, shape (n_unknowns,); values that are not given are neutral."""
    neutral = {"gain": 1.0, "offset": 0.0, "dead_band": 0.0, "rate_limit": scale.rate, "damping": 1.0, "asymmetry": 0.0}
    merged = {**neutral, **values}
    return np.array([unknown_from_value(name, merged[name], scale) for name in structure.unknown_names()])


def model_from_unknowns(
    structure: ActuatorStructure, x: Array, scale: ActuatorScale, rate_limit: float = math.inf
) -> ActuatorModel:
    """The model at unknowns x of shape (n_unknowns,). rate_limit: of a structure without this unknown."""
    names = structure.unknown_names()
    values = {name: float(value_from_unknown(name, float(x_i), scale)) for name, x_i in zip(names, x, strict=True)}
    asymmetry = values.pop("asymmetry", 0.0)
    values = {"rate_limit": float(rate_limit), **values}
    order = 2.0 if structure.order == 2 else 1.0
    return ActuatorModel(ActuatorParams(order=order, rest=scale.rest, **values), asymmetry)


@kernel
def run_actuator(
    params: ActuatorParams, state: ActuatorState, down: Lag, commands: Any, outputs: Any, dt_s: float
) -> int:
    """Simulate a channel with one command a tick and write its outputs; returns their number.

    The lag is that of `state` upwards, and `down` downwards.
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


kept(run_actuator)


def simulate_commands(model: ActuatorModel, command: Array, dt_s: float) -> Array:
    """Outputs of the channel for commands, both of shape (n_rows,), starting at rest on the first command."""
    start = model.params._replace(initial=float(command[0]))
    up, down = (start._replace(lag_s=start.lag_s * math.exp(sign * model.asymmetry)) for sign in (1.0, -1.0))
    outputs = np.empty(len(command))
    run_actuator(start, init_actuator(up, dt_s), init_actuator(down, dt_s).lag, command, outputs, dt_s)
    return outputs


def simulate_output(model: ActuatorModel, samples: ActuatorSamples) -> Array:
    """Outputs for the commands of a segment, shape (n_rows,), filtered as its recorded output is."""
    outputs = simulate_commands(model, samples.command, samples.dt_s)
    return filter_rate(outputs, samples.filter_ticks, samples.dt_s) if samples.filter_ticks else outputs


def filter_rate(rate: Array, window: int, dt_s: float) -> Array:
    """A rate as estimate_rate (learn/drives/smoothing.py) recovers it from the rate's own integral."""
    if len(rate) < window:
        return smooth_signal(rate, window)
    return np.asarray(savgol_filter(np.cumsum(rate) * dt_s, window, 2, deriv=1, delta=dt_s))


def output_residuals(model: ActuatorModel, segments: Sequence[ActuatorSamples], sigma: float) -> Array:
    """Simulated minus reported output in the compared rows, in multiples of sigma; shape (n_compared,)."""
    if not segments:
        return np.zeros(0)
    residuals = [(simulate_output(model, segment) - segment.output)[segment.is_compared] for segment in segments]
    return np.concatenate(residuals) / sigma


def estimate_peak_rate(segments: Sequence[ActuatorSamples]) -> float:
    """The peak rate of the reported output per s, taken over several reports and without the fastest 0.1 %."""
    rates = [np.zeros(1)]
    reports = RATE_LIMIT.peak_rate_reports
    for segment in segments:
        ticks = np.flatnonzero(segment.is_compared)
        if len(ticks) > reports:
            moves = np.abs(segment.output[ticks[reports:]] - segment.output[ticks[:-reports]])
            rates.append(moves / (ticks[reports:] - ticks[:-reports]) / segment.dt_s)
    return float(np.quantile(np.concatenate(rates), RATE_LIMIT.peak_rate_quantile))


def rows_at_rate_limit(model: ActuatorModel, samples: ActuatorSamples, share: float) -> Array:
    """Rows in which the simulated output moves at `share` of its rate limit or faster, shape (n_rows,)."""
    moves = np.abs(np.diff(simulate_output(model, samples._replace(filter_ticks=0)), prepend=np.nan))
    return moves >= share * model.params.rate_limit * samples.dt_s


def time_at_rate_limit_s(model: ActuatorModel, segments: Sequence[ActuatorSamples]) -> float:
    """For how long the simulated output moves at its rate limit."""
    share = RATE_LIMIT.reached_share
    return float(sum(float(np.sum(rows_at_rate_limit(model, segment, share))) * segment.dt_s for segment in segments))


def exclude_rate_limited(
    model: ActuatorModel, segments: Sequence[ActuatorSamples], before_s: float, after_s: float
) -> list[ActuatorSamples]:
    """The segments, compared only in rows that are not near the rate limit within these times before and after.

    The time before a limit matters too: a motor that still accelerates may already be limited.
    """
    calm_segments = []
    for segment in segments:
        is_near = rows_at_rate_limit(model, segment, RATE_LIMIT.near_share)
        rows, far_away = np.arange(len(is_near)), 2 * len(is_near)
        last = np.maximum.accumulate(np.where(is_near, rows, -far_away))
        following = np.minimum.accumulate(np.where(is_near, rows, far_away)[::-1])[::-1]
        is_compared = segment.is_compared & (rows - last > round(after_s / segment.dt_s))
        is_compared &= following - rows > round(before_s / segment.dt_s)
        if is_compared.any():
            calm_segments.append(segment._replace(is_compared=is_compared))
    return calm_segments
