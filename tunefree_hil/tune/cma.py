"""CMA-ES after a first phase of TPE: a fine search around the best point (Hansen 2016, arXiv:1604.00772).

TPE finds the region within some tens of trials, but it treats each parameter alone and stays coarse. CMA-ES learns from
ranks how the parameters depend on each other, and its suggestions take no time. The strategy is rebuilt from the
finished trials at each call, so a suggestion is a function of the arguments alone: a killed search goes on as if it had
not been killed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from cmaes import CMA

from tunefree_hil.tune.space import Axis, Space


class CmaCriteria(NamedTuple):
    """Where CMA-ES begins, and how it ranks. A spread is in parts of each parameter's range on its scale."""

    start_trials: int = 64  # trials of the other sampler: the manual sets and TPE, eight generations of a batch
    start_spread: float = 0.15  # standard deviation: two of it reach a third of the range to each side
    # populations are multiples of it, close to the default of CMA-ES: 4 + 3 ln(parameters). Where a batch of trials
    # reaches beyond a population, its last points come from the strategy before the update
    population_step: int = 4
    # a violation of 20 % doubles a score; ranked behind all others, as TPE ranks them, points beyond a limit by 1 %
    # would hide from the strategy the best ones, which lie along the limits
    violation_weight: float = 5.0
    most_violation: float = 20.0  # a failed drive is 100; all failures are equally bad


CRITERIA = CmaCriteria()


class RankedPoint(Protocol):
    """Parameters with what ranks them; `ScoredPoint` of sampling.py."""

    @property
    def parameters(self) -> dict[str, float]: ...

    @property
    def score(self) -> float: ...

    @property
    def violation(self) -> float | None: ...


def suggest_cma_points(
    space: Space, history: Sequence[RankedPoint], *, seed: int, count: int
) -> list[dict[str, float]]:
    """Suggest parameters, to be tried at the same time.

    Args:
        space: Search space.
        history: Finished trials in slot order, `start_trials` or more; the first of them give the start.
        seed: Seed of the study.
        count: Number of points.

    Returns:
        binary32 values inside the space, by name, in its order.
    """
    start, later = history[: CRITERIA.start_trials], history[CRITERIA.start_trials :]
    size = population_size(len(space.axes))
    strategy = _start_strategy(space, min(start, key=rank_value), seed)
    whole = len(later) // size
    for k in range(whole):
        for _ in range(size):
            strategy.ask()  # one draw for each known point, so that every call uses chance in the same way
        told = later[k * size : (k + 1) * size]
        strategy.tell([(to_unit(space, point.parameters), rank_value(point)) for point in told])
        if strategy.should_stop():  # it has converged: once more, from the best point
            best = min([*start, *later[: (k + 1) * size]], key=rank_value)
            strategy = _start_strategy(space, best, seed + k + 1)
    drawn = [strategy.ask() for _ in range(len(later) - whole * size + count)]
    return [from_unit(space, unit) for unit in drawn[-count:]]


def population_size(parameters: int) -> int:
    """The default population of CMA-ES, rounded up to a multiple of `population_step`."""
    default = 4 + math.floor(3.0 * math.log(parameters))
    return CRITERIA.population_step * math.ceil(default / CRITERIA.population_step)


def rank_value(point: RankedPoint) -> float:
    """Orders points: the score, which grows with the violation of the requirements."""
    return point.score * (1.0 + CRITERIA.violation_weight * min(point.violation or 0.0, CRITERIA.most_violation))


def to_unit(space: Space, parameters: dict[str, float]) -> np.ndarray:
    """The place of each parameter in its range, 0 to 1 on its scale, shape (axes,)."""
    return np.array([_share(axis, parameters[axis.name]) for axis in space.axes])


def from_unit(space: Space, unit: np.ndarray) -> dict[str, float]:
    """The inverse of `to_unit`; values are clipped into the space and rounded to binary32."""
    return {axis.name: _value(axis, float(share)) for axis, share in zip(space.axes, unit, strict=True)}


def _start_strategy(space: Space, best: RankedPoint, seed: int) -> CMA:
    bounds = np.tile([0.0, 1.0], (len(space.axes), 1))
    return CMA(
        to_unit(space, best.parameters),
        CRITERIA.start_spread,
        bounds=bounds,
        seed=seed,
        population_size=population_size(len(space.axes)),
    )


def _share(axis: Axis, value: float) -> float:
    if axis.grid:
        return (axis.grid.index(axis.clip(value)) + 0.5) / len(axis.grid)
    if axis.high <= axis.low:
        return 0.5
    if axis.log:
        return math.log(value / axis.low) / math.log(axis.high / axis.low)
    return (value - axis.low) / (axis.high - axis.low)


def _value(axis: Axis, share: float) -> float:
    if axis.grid:
        return axis.grid[min(int(share * len(axis.grid)), len(axis.grid) - 1)]
    if axis.log:
        return axis.clip(axis.low * (axis.high / axis.low) ** share)
    return axis.clip(axis.low + share * (axis.high - axis.low))
