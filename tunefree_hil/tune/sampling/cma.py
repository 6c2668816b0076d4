"""CMA-ES (Hansen 2016, arXiv:1604.00772), from the first trial or after a first phase of TPE.

TPE finds the region within some tens of trials, but it treats each parameter alone and stays coarse. CMA-ES learns from
ranks how the parameters depend on each other, and its suggestions take no time. The strategy is rebuilt from the
finished trials at each call, so a suggestion is a function of the arguments alone: a killed search goes on as if it had
not been killed. Steps and choices are cells of the range, and a draw gets the value of its cell.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from cmaes import CMA

from tunefree_hil.tune.sampling.points import from_unit, to_unit
from tunefree_hil.tune.sampling.ranking import RankedPoint, rank_value
from tunefree_hil.tune.space import Space


class CmaCriteria(NamedTuple):
    """Where CMA-ES begins. A spread is in parts of each parameter's range on its scale."""

    start_trials: int = 64  # trials of the other sampler: the manual sets and TPE, eight generations of a batch
    start_spread: float = 0.15  # standard deviation: two of it reach a third of the range to each side
    # standard deviation of a search from its first trial: a third of the range, within which Hansen (2016, C.1)
    # expects the best point
    first_spread: float = 0.3
    # populations are multiples of it, close to the default of CMA-ES: 4 + 3 ln(parameters). Where a batch of trials
    # reaches beyond a population, its last points come from the strategy before the update
    population_step: int = 4


CRITERIA = CmaCriteria()


class CmaStart(NamedTuple):
    """The centre of the first population, in the unit box, and its standard deviation."""

    centre: np.ndarray
    spread: float


def suggest_cma_points(
    space: Space, history: Sequence[RankedPoint], *, seed: int, count: int, skip: int = 0
) -> list[dict[str, float]]:
    """Suggest parameters after a first phase of another sampler, to be tried at the same time.

    Args:
        space: Search space.
        history: Finished trials in slot order, `start_trials` or more; the first of them give the start.
        seed: Seed of the study.
        count: Number of points.
        skip: Points of the strategy that are in flight.

    Returns:
        binary32 values inside the space, by name, in its order.
    """
    first = history[: CRITERIA.start_trials]
    start = CmaStart(to_unit(space, min(first, key=rank_value).parameters), CRITERIA.start_spread)
    drawn = _draw_units(space, history, start, seed, count=skip + count, known=len(first))
    return [from_unit(space, unit) for unit in drawn[skip:]]


def suggest_cma_points_from_start(
    space: Space,
    history: Sequence[RankedPoint],
    *,
    seed: int,
    count: int,
    pending: Sequence[Mapping[str, float]] = (),
) -> list[dict[str, float]]:
    """Suggest parameters of a search that is CMA-ES from its first trial.

    The first trial, such as the manual set, is the start, finished or in flight. Where there is none, the middle of the
    box is tried first.

    Args:
        space: Search space.
        history: Finished trials in slot order.
        seed: Seed of the study.
        count: Number of points.
        pending: Sets of parameters in flight.
    """
    known = [*(point.parameters for point in history), *pending]
    if not known:
        middle = from_unit(space, np.full(len(space.axes), 0.5))
        if count == 1:
            return [middle]
        return [middle, *suggest_cma_points_from_start(space, (), seed=seed, count=count - 1, pending=[middle])]
    start = CmaStart(to_unit(space, known[0]), CRITERIA.first_spread)
    skip = len(pending) - (0 if history else 1)  # the others in flight are points of the strategy
    drawn = _draw_units(space, history, start, seed, count=skip + count, known=min(1, len(history)))
    return [from_unit(space, unit) for unit in drawn[skip:]]


def _draw_units(
    space: Space, history: Sequence[RankedPoint], start: CmaStart, seed: int, *, count: int, known: int
) -> list[np.ndarray]:
    """The next points of the strategy, which has learned from the trials after the first `known` ones."""
    later, size = history[known:], population_size(len(space.axes))
    strategy = _make_strategy(start, seed)
    whole = len(later) // size
    for k in range(whole):
        for _ in range(size):
            strategy.ask()  # one draw for each known point, so that every call uses chance in the same way
        population = later[k * size : (k + 1) * size]
        strategy.tell([(to_unit(space, point.parameters), rank_value(point)) for point in population])
        if strategy.should_stop():  # it has converged: once more, from the best point
            best = min(history[: known + (k + 1) * size], key=rank_value)
            strategy = _make_strategy(start._replace(centre=to_unit(space, best.parameters)), seed + k + 1)
    drawn = [strategy.ask() for _ in range(len(later) - whole * size + count)]
    return drawn[-count:]


def population_size(parameters: int) -> int:
    """The default population of CMA-ES, rounded up to a multiple of `population_step`."""
    default = 4 + math.floor(3.0 * math.log(parameters))
    return CRITERIA.population_step * math.ceil(default / CRITERIA.population_step)


def _make_strategy(start: CmaStart, seed: int) -> CMA:
    dimensions = len(start.centre)
    return CMA(
        start.centre,
        start.spread,
        bounds=np.tile([0.0, 1.0], (dimensions, 1)),
        seed=seed % 2**32,  # what NumPy's generator takes
        population_size=population_size(dimensions),
    )
