"""The search for the shape and the numbers of one by-wire channel (learn/actuators/identify.py)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.learn.actuators.model import (
    Scale,
    Shape,
    Way,
    bounds,
    calm,
    misses,
    params_at,
    rate_seen,
    seconds_at_limit,
    vector,
)
from tunefree_hil.learn.actuators.samples import Pair, Pairs
from tunefree_hil.learn.data_sheet import ChannelSheet
from tunefree_hil.learn.drives.smoothing import noise_of, quantum_of
from tunefree_hil.learn.robust_least_squares import Least, solve

Array = np.ndarray

DEAD_TIMES_S = (0.0, 0.02, 0.04, 0.07, 0.1, 0.14, 0.18, 0.25, 0.35, 0.5)
LAGS_S = (0.01, 0.03, 0.06, 0.12, 0.25, 0.5)
STARTS = 2  # of the grid's best that are followed
BETTER = 0.995  # what a richer shape must bring the error down to
LEAST_LIMIT_S = 0.2  # at its rate limit
LEAST_CALM_ROWS = 500  # far from it
ONSET_LAGS, CALM_LAGS = 2.0, 6.0  # for how many lags a limit shows before it is reached, and after
BLOCK_S = 2.0
ROBUST = 4.0


class Found(NamedTuple):
    """A shape fitted: its error on held-out parts (or, without any, on its own) in sigmas."""

    shape: Shape
    least: Least
    way: Way
    error: float


class Case(NamedTuple):
    """What a search works on. blocks: of every row compared; rate_limit: of shapes that have none of their own."""

    training: Sequence[Pair]
    held_out: Sequence[Pair]
    scale: Scale
    blocks: Array
    rate_limit: float = math.inf


def case_of(training: Pairs, held_out: Pairs, sheet: ChannelSheet) -> Case:
    """The pairs, and what their numbers are measured in."""
    command = np.concatenate([pair.command for pair in training.some])
    output = [pair.output[pair.counts] for pair in training.some]
    quantum = quantum_of(np.concatenate(output))
    noise = float(np.sqrt(np.mean([noise_of(one, quantum) ** 2 for one in output])))
    span = float(np.ptp(command))
    sigma = math.sqrt(noise * noise + quantum * quantum / 12.0 + (1e-5 * span) ** 2)
    rate = max(rate_seen(training.some), 0.05 * span)
    return Case(training.some, held_out.some, Scale(sheet.rest, span, rate, sigma), _blocks(training.some))


def _blocks(some: Sequence[Pair]) -> Array:
    """The block of every row compared: BLOCK_S of a stretch each."""
    blocks, first = [], 0
    for pair in some:
        mine = first + np.arange(len(pair.command)) // round(BLOCK_S / pair.dt_s)
        first = int(mine[-1]) + 1
        blocks.append(mine[pair.counts])
    return np.concatenate(blocks)


def calmed(case: Case, limited: Found) -> Case | None:
    """The same case without what happened near the rate limit, which is then known; None where too little is left.

    What limits a real drive's rate differs from the bench's actuator while it sets in and ends; dead time and lag are
    those of small commands.
    """
    params = limited.way.params
    lag_s = params.lag_s if params.order == 1.0 else params.damping / (math.pi * max(params.natural_hz, 0.1))
    times = ONSET_LAGS * lag_s, params.dead_time_s + CALM_LAGS * lag_s
    training, held_out = calm(limited.way, case.training, *times), calm(limited.way, case.held_out, *times)
    if sum(int(pair.counts.sum()) for pair in training) < LEAST_CALM_ROWS or (case.held_out and not held_out):
        return None
    return Case(training, held_out, case.scale, _blocks(training), params.rate_limit)


def starts_of(case: Case) -> list[tuple[float, float]]:
    """The best (dead time, lag) of a grid, with gain and offset neutral and the fastest rate seen as the limit."""
    shape = Shape(1, True)
    errors = []
    for lag_s in LAGS_S:
        for dead_s in DEAD_TIMES_S:
            x = vector(shape, {"dead_time_s": dead_s, "lag_s": lag_s}, case.scale)
            rows = misses(params_at(shape, x, case.scale), case.training, case.scale.sigma)
            errors.append((float(np.mean(np.minimum(np.abs(rows), 1e6))), dead_s, lag_s))
    return [(dead_s, lag_s) for _, dead_s, lag_s in sorted(errors)[:STARTS]]


def disturbed(case: Case, start: tuple[float, float]) -> Case:
    """The same case with what is left at a start taken as the doubt of a row: a car's motion also has other causes.

    The sensor's noise is far below them; against it every row would be an outlier, and the steps that tell most too.
    """
    shape = Shape(1, True)
    x = vector(shape, {"dead_time_s": start[0], "lag_s": start[1]}, case.scale)
    rows = misses(params_at(shape, x, case.scale), case.training, case.scale.sigma)
    times = max(float(np.sqrt(np.mean(rows * rows))), 1.0)
    return case._replace(scale=case.scale._replace(sigma=times * case.scale.sigma))


def best_of(case: Case, shape: Shape, starts: Sequence[tuple[float, float]]) -> Found:
    """The best fit of a shape over all starts."""
    fits = [fitted(case, shape, values) for values in _start_values(shape, starts)]
    return min(fits, key=lambda one: one.least.rms)


def _start_values(shape: Shape, starts: Sequence[tuple[float, float]]) -> list[dict[str, float]]:
    """Start values; of order 2 critically damped with the same delay, and with less dead time and a longer lag."""
    if shape.order < 2:
        return [{"dead_time_s": dead_s, "lag_s": lag_s} for dead_s, lag_s in starts]
    found = []
    for dead_s, lag_s in starts[:1]:
        for less in (0.0, 0.5):
            shorter = max(dead_s - less * lag_s, 0.0)
            delay_s = dead_s - shorter + lag_s
            found.append({"dead_time_s": shorter, "natural_hz": 1.0 / (math.pi * delay_s)})  # 2 lags of delay / 2 each
    return found


def fitted(case: Case, shape: Shape, values: dict[str, float]) -> Found:
    """A shape fitted from these values on."""
    scale = case.scale
    low, high = bounds(shape, scale)

    def residuals(x: Array) -> Array:
        return misses(params_at(shape, x, scale, case.rate_limit), case.training, scale.sigma)

    least = solve(residuals, vector(shape, values, scale), low, high, case.blocks, robust=ROBUST)
    way = params_at(shape, least.x, scale, case.rate_limit)
    return Found(shape, least, way, error_of(case, way))


def error_of(case: Case, way: Way) -> float:
    """Root mean square in sigmas on held-out parts, or on the training parts where nothing is held out."""
    rows = misses(way, case.held_out or case.training, case.scale.sigma)
    return float(np.sqrt(np.mean(rows * rows)))


def choose(case: Case, candidates: Sequence[Found]) -> Found:
    """The plainest shape that no richer one beats on held-out parts; a lag that the ticks cannot show is left out."""
    usable = [
        one for one in candidates if not one.shape.limited or seconds_at_limit(one.way, case.training) >= LEAST_LIMIT_S
    ]
    best = usable[0]
    for one in usable[1:]:
        if one.error < BETTER * best.error:
            best = one
    dt_s = case.training[0].dt_s
    params = best.way.params
    if best.shape.order == 1 and params.lag_s < dt_s:
        dead_s = params.dead_time_s
        shape = best.shape._replace(order=0, uneven=False)
        sharp = [fitted(case, shape, {"dead_time_s": one}) for one in (dead_s, max(dead_s - dt_s, 0.0))]
        least = min(sharp, key=lambda one: one.least.rms)
        return least if least.error <= best.error / BETTER else best
    return best


def explained(case: Case, way: Way) -> float:
    """Share of the output's variance that the simulated channel explains."""
    rows = misses(way, case.training, case.scale.sigma) * case.scale.sigma
    output = np.concatenate([pair.output[pair.counts] for pair in case.training])
    return 1.0 - float(np.mean(rows * rows)) / max(float(np.var(output)), 1e-12)
