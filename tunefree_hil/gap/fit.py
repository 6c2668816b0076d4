"""Fits a candidate: the effects' own parameters and all that recalibration may move, together.

A candidate's parameters are looked for on a coarse grid first (what a delay does to an error is rugged), then by damped
Gauss-Newton steps. The slopes of what recalibration moves are taken once, at the null, and shared by all candidates, so
that a point of the grid is one simulation: what recalibration could still do there is a small linear problem. Only who
gains something there is worth slopes of its own. Noise is estimated on each candidate's own residual (noise.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.gap.noise import Colour
from tunefree_hil.gap.problem import (
    FLAT,
    Fitted,
    Free,
    Problem,
    Slopes,
    Sums,
    bounded,
    cost_of,
    ends_of,
    gathered,
    prior_of,
    squares,
)
from tunefree_hil.gap.work import Residuals

Array = np.ndarray

GRID = 12
FINER = 9  # points between the best one's neighbours: a delay is rugged on the scale of a tick
TURNS, NULL_TURNS = 6, 15  # Gauss-Newton steps at most; a null that is not at its best makes effects of nothing
SETTLING = 3  # of them, after which the noise is taken as it is
ENOUGH = 0.5  # in squares: a step that gains less is the last one
DAMPINGS = (0.0, 1e-2, 1e-1, 1.0, 10.0)  # of the normal equations, tried in turn
HOPELESS = 6.0  # of what the best point of the grid gains in squares: one step more is enough to be sure


def fit_null(problem: Problem) -> tuple[Fitted, Slopes]:
    """Recalibration alone; and the slopes there, which all candidates share."""
    keys = tuple(problem.nuisances)
    z = np.zeros(len(keys))
    residuals = problem.work.residuals(problem.values(keys, z, ()))
    at = Point(keys, (), z, residuals)
    at = _descended(problem, at, problem.colours(residuals), problem.judged(), NULL_TURNS)
    slopes = problem.slopes(keys, at.z, (), list(range(len(keys))), at.residuals)
    return _finished(problem, "", at, slopes), slopes


class Point(NamedTuple):
    """Where a search stands."""

    keys: tuple[str, ...]
    free: tuple[Free, ...]
    z: Array
    residuals: Residuals


def _finished(problem: Problem, name: str, at: Point, slopes: Slopes) -> Fitted:
    sums = problem.sums(at.residuals, slopes, problem.colours(at.residuals))
    values = problem.values(at.keys, at.z, at.free)
    return Fitted(name, at.keys, at.z, at.free, values, sums, at.residuals)


def _descended(problem: Problem, at: Point, colours: dict[str, Colour], blocks: Array, most: int) -> Point:
    """Gauss-Newton steps, slopes anew for each, until nothing is gained. The noise is what the first steps leave."""
    every = list(range(len(at.keys)))
    for turn in range(most):
        slopes = problem.slopes(at.keys, at.z, at.free, every, at.residuals)
        sums = problem.sums(at.residuals, slopes, colours)
        before = cost_of(sums, at.z, prior_of(at.keys, at.free), blocks)
        at, cost = _stepped(problem, at, sums, before, blocks)
        if before - cost < ENOUGH and turn >= SETTLING:
            break
        if turn < SETTLING:
            colours = problem.colours(at.residuals)
    return at


def _stepped(problem: Problem, at: Point, sums: dict[str, Sums], before: float, blocks: Array) -> tuple[Point, float]:
    """A step, ever more damped until it makes things better under the noise of `sums`; where none does, none."""
    prior = prior_of(at.keys, at.free)
    colours = {name: one.colour for name, one in sums.items()}
    low, high = ends_of(at.keys, at.free)
    curve, slope, _ = gathered(sums, len(at.keys), blocks)
    curve, slope = curve + np.diag(prior), slope + prior * at.z
    scale = np.maximum(np.diag(curve), FLAT)
    for damping in DAMPINGS:
        there = at.z + bounded(curve + damping * np.diag(scale), slope, at.z, low, high)
        try:
            found = problem.work.residuals(problem.values(at.keys, there, at.free))
        except InputError:  # a value that makes no such effect: not so far
            continue
        cost = squares(problem, found, colours, at.residuals, sums, blocks) + float(prior @ (there * there))
        if cost < before:
            return at._replace(z=there, residuals=found), cost
    return at, before


def fit_again(problem: Problem, model: Fitted) -> Fitted:
    """A model fitted on from where it stands (with its residuals), under the noise that it leaves itself."""
    at = Point(model.keys, model.free, model.z, model.residuals)
    at = _descended(problem, at, problem.colours(model.residuals), problem.judged(), NULL_TURNS)
    slopes = problem.slopes(at.keys, at.z, at.free, list(range(len(at.keys))), at.residuals)
    return _finished(problem, model.name, at, slopes)


def fit_candidate(
    problem: Problem, name: str, free: Sequence[Free], start: Fitted, shared: Slopes, starts: Sequence[Array] = ()
) -> Fitted:
    """A candidate fitted from the model `start` (the null, or effects already found) with `free` parameters more.

    starts: u of `free` to begin from; without, a grid is laid. Raises InputError where no value of it makes a car.
    """
    loose = {one.key for one in free}
    kept = [i for i, key in enumerate(start.keys) if key not in loose]
    keys = tuple(start.keys[i] for i in kept) + tuple(one.key for one in free)
    slopes, blocks = _without(shared, kept), problem.judged()
    base = np.array([start.z[i] for i in kept])
    at, gain = _best_start(problem, Point(keys, (*start.free, *free), base, {}), free, start, slopes, blocks, starts)
    colours = {one: start.sums[one].colour for one in start.sums}
    own = list(range(len(kept), len(keys)))
    if gain > HOPELESS:
        at = _descended(problem, at, colours, blocks, TURNS)
        slopes = problem.slopes(keys, at.z, at.free, list(range(len(keys))), at.residuals)
        return _finished(problem, name, at, slopes)
    slopes = _with(slopes, problem.slopes(keys, at.z, at.free, own, at.residuals))
    sums = problem.sums(at.residuals, slopes, colours)
    at, _ = _stepped(problem, at, sums, cost_of(sums, at.z, prior_of(keys, at.free), blocks), blocks)
    return _finished(problem, name, at, slopes)


def _without(slopes: Slopes, kept: Sequence[int]) -> Slopes:
    """The slopes of some columns, numbered anew."""
    place = {old: new for new, old in enumerate(kept)}
    found = {}
    for name, (columns, pieces) in slopes.by_target.items():
        felt = [c for c, column in enumerate(columns) if int(column) in place]
        numbers = np.array([place[int(columns[c])] for c in felt], dtype=np.int64)
        found[name] = (numbers, [piece[:, felt] for piece in pieces])
    return Slopes(found)


def _with(slopes: Slopes, more: Slopes) -> Slopes:
    """Both; a column of `more` takes the place of one in `slopes`."""
    found = {}
    for name, (columns, pieces) in slopes.by_target.items():
        new, added = more.by_target[name]
        keep = [c for c, column in enumerate(columns) if column not in new]
        joined = [np.concatenate([p[:, keep], a], axis=1) for p, a in zip(pieces, added, strict=True)]
        found[name] = (np.concatenate([columns[keep], new]), joined)
    return Slopes(found)


def _best_start(
    problem: Problem, at: Point, free: Sequence[Free], start: Fitted, slopes: Slopes, blocks: Array,
    starts: Sequence[Array],
) -> tuple[Point, float]:  # fmt: skip
    """The point of the grid at which the least is left after what recalibration can do there, with that done; and what
    it gains, in squares. at.z: of all but `free`.
    """
    colours = {name: one.colour for name, one in start.sums.items()}
    kept = {name: problem.sums_of(name, start.residuals[name], slopes.by_target[name], colours[name])
            for name in start.residuals}  # fmt: skip
    base, prior = at.z, prior_of(at.keys, at.free)[: len(at.z)]
    low, high = ends_of(at.keys, at.free)
    ends = low[: len(base)], high[: len(base)]

    def tried(u: Array) -> tuple[float, Array] | None:
        """(what is left, the point with recalibration done) at a point of the grid; None where it makes no car."""
        z = np.concatenate([base, u])
        try:
            residuals = problem.work.residuals(problem.values(at.keys, z, at.free))
        except InputError:
            return None
        sums = {
            name: kept[name]
            if all(np.array_equal(a, b) for a, b in zip(some, start.residuals[name], strict=True))
            else problem.sums_of(name, some, slopes.by_target[name], colours[name])
            for name, some in residuals.items()
        }
        left, step = _recalibrated(sums, base, prior, ends, blocks)
        return left, np.concatenate([base + step, u])

    points = [found for u in starts or grid_of(free) if (found := tried(u)) is not None]
    if not points:
        raise InputError("no value of it makes a car", code="no_such_effect", key=",".join(one.key for one in free))
    best = min(points, key=lambda one: one[0])
    if not starts and len(free) == 1:
        near = best[1][-1:] + np.linspace(-1.0, 1.0, FINER)[:, None] / (GRID - 1)
        points += [found for u in near if (found := tried(np.clip(u, low[-1], high[-1]))) is not None]
        best = min(points, key=lambda one: one[0])
    z = np.clip(best[1], low, high)
    residuals = problem.work.residuals(problem.values(at.keys, z, at.free))
    return at._replace(z=z, residuals=residuals), _recalibrated(kept, base, prior, ends, blocks)[0] - best[0]


def _recalibrated(
    sums: dict[str, Sums], z: Array, prior: Array, ends: tuple[Array, Array], blocks: Array
) -> tuple[float, Array]:
    """(cost, step) of the best that recalibration can do from z, by the normal equations."""
    curve, slope, square = gathered(sums, len(z), blocks)
    curve, slope = curve + np.diag(prior), slope + prior * z
    step = bounded(curve, slope, z, *ends)
    return square + float(prior @ (z * z)) + float(2.0 * slope @ step + step @ curve @ step), step


def grid_of(free: Sequence[Free]) -> list[Array]:
    """Points over the priors of one parameter; of two, a coarser grid of both."""
    if len(free) == 1:
        return [np.array([u]) for u in np.linspace(0.0, 1.0, GRID)]
    first = np.linspace(0.0, 1.0, max(GRID // 2, 3))
    return [
        np.array([u, *more]) for u in first for more in np.ndindex(*(3,) * (len(free) - 1)) for more in [_third(more)]
    ]


def _third(places: tuple[int, ...]) -> tuple[float, ...]:
    return tuple((0.1, 0.5, 0.9)[place] for place in places)
