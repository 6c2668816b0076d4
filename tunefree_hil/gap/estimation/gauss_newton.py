"""Fits a model: an effect's own parameters and all that recalibration may move, together, by damped Gauss-Newton steps.

A step costs simulations for slopes. What recalibration moves is nearly linear, so its slopes are taken once, at the
model that a candidate is added to, and shared by all candidates; those of the candidate's own parameters are taken anew
at each step. A model that others are to be weighed beside is fitted on with all slopes anew (`fit_on`). Noise is
estimated on each candidate's own residual (noise.py).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.gap.estimation.evidence import log_evidence, stretched
from tunefree_hil.gap.estimation.grid import NO_TWIN, TWINS, Scan, Start
from tunefree_hil.gap.estimation.least_squares import (
    FLAT,
    Fitted,
    Free,
    Problem,
    Slopes,
    Sums,
    cost_of,
    drawn_in,
    ends_of,
    gathered,
    squares,
    walled,
)
from tunefree_hil.gap.estimation.noise import Colour
from tunefree_hil.gap.estimation.residuals import Residuals

Array = np.ndarray

TURNS, ON_TURNS = 8, 40  # steps at most, of a candidate and of a model fitted on
SETTLING = 3  # of them, after which the noise is taken as it is until nothing more is gained
ENOUGH = 0.5  # in squares: a step that gains less is the last one
DAMPINGS = (0.0, 1e-2, 1e-1, 1.0, 10.0)  # of the normal equations, tried in turn


class Point(NamedTuple):
    """Where a search stands."""

    keys: tuple[str, ...]
    free: tuple[Free, ...]
    z: Array
    residuals: Residuals


def fit_null(problem: Problem) -> tuple[Fitted, Slopes]:
    """Recalibration alone, fitted on until nothing is gained: a null that is not at its best makes effects of nothing.

    With it the slopes there, which all candidates share.
    """
    keys = tuple(problem.nuisances)
    z = np.zeros(len(keys))
    return _fitted_on(problem, "", Point(keys, (), z, problem.work.residuals(problem.values(keys, z, ()))))


def fit_on(problem: Problem, model: Fitted) -> Fitted:
    """A model fitted on from where it stands (with its residuals), under the noise that it leaves itself."""
    at = Point(model.keys, model.free, model.z, model.residuals)
    return _fitted_on(problem, model.name, at)[0]


def fit_without(problem: Problem, model: Fitted, name: str) -> Fitted:
    """A model without one of its effects, the rest fitted on from where they stand; what was the effect's own and is
    recalibrated in the null is recalibrated again.
    """
    free = tuple(one for one in model.free if one.key.partition(".")[0] != name)
    loose, held = {one.key for one in free}, {one.key for one in model.free}
    place = {key: float(z) for key, z in zip(model.keys, model.z, strict=True) if key not in held or key in loose}
    apart = loose | {TWINS.get(key, NO_TWIN)[0] for key in loose}
    keys = (*(key for key in problem.nuisances if key not in apart), *(one.key for one in free))
    z = np.array([place.get(key, 0.0) for key in keys])
    residuals = problem.work.residuals(problem.values(keys, z, free))
    return _fitted_on(problem, model.name if free else "", Point(keys, free, z, residuals))[0]


def fit_candidate(scan: Scan, name: str, free: Sequence[Free], begin: Start, hopeless: float) -> Fitted:
    """A candidate fitted from a point of its grid beside the scan's model, or from two, the better one taken. Who gains
    less than `hopeless` there gets one step: enough to be sure that nobody is left out for the grid's sake. Raises
    InputError where no way leads on from any of them.
    """
    problem, closer = scan.problem, begin.closer
    turns = TURNS if begin.worth > hopeless else 1
    if begin.gain > hopeless:
        begin = scan.finer(free, begin)
    own = list(range(len(begin.keys) - len(free), len(begin.keys)))
    loose = (*scan.start.free, *free)
    lost = list[InputError]()

    def ended(one: Start, colours: dict[str, Colour] | None) -> Iterator[tuple[Point, Slopes]]:
        """Where a search from there ends; nowhere where no way leads on. colours: None for those at its begin."""
        try:
            residuals = problem.work.residuals(problem.values(one.keys, one.z, loose))
            at = Point(one.keys, loose, one.z, residuals)
            yield _descended(problem, at, scan.slopes(free), own, colours or problem.colours(residuals), turns)
        except InputError as error:  # over the edge of what makes a car: the other start may stay within it
            lost.append(error)

    found = [end for one in (begin, begin.plain) if one is not None for end in ended(one, scan.colours)]
    some = [min(found, key=lambda end: _cost(scan, end[0], scan.colours))] if found else []
    some += [] if closer is None else ended(scan.nearer(free, closer), None)
    if not some:
        raise lost[0]
    return _likelier([_finished(problem, name, *end) for end in some], problem.judged())


def _cost(scan: Scan, at: Point, colours: dict[str, Colour]) -> float:
    """What a point leaves under the noise that the scan takes for everybody's."""
    problem, start = scan.problem, scan.start
    left = squares(problem, at.residuals, colours, start.residuals, start.sums, problem.judged())
    return left + float(at.z @ problem.prior(at.keys, at.free) @ at.z)


def _likelier(found: Sequence[Fitted], blocks: Array) -> Fitted:
    """The best of some ends of one search, all by the noise of the loudest."""
    if len(found) == 1:
        return found[0]
    by = {name: max(one.sums[name].colour.stretch for one in found) for name in found[0].sums}
    return max(found, key=lambda one: log_evidence(stretched(one, by), blocks))


def _fitted_on(problem: Problem, name: str, at: Point) -> tuple[Fitted, Slopes]:
    """Steps with all slopes kept while they help, then anew, until fresh ones do not help either, nor under the noise
    that is left there: what was loud on the way hides how much more there is to gain.
    """
    every, at = list(range(len(at.keys))), _drawn_in(problem, at)
    slopes = problem.slopes(at.keys, at.z, at.free, every, at.residuals)
    colours, blocks, fresh, heard = problem.colours(at.residuals), problem.judged(), True, False
    for turn in range(ON_TURNS):
        there, gain = _stepped(problem, at, problem.sums(at.residuals, slopes, colours), blocks)
        if gain >= ENOUGH:
            at, fresh, heard = there, False, False
        elif not fresh:
            slopes, fresh = problem.slopes(at.keys, at.z, at.free, every, at.residuals), True
        elif heard and turn >= SETTLING:
            break
        else:
            heard = True
        if turn < SETTLING or heard:
            colours = problem.colours(at.residuals)
    if not fresh:
        slopes = problem.slopes(at.keys, at.z, at.free, every, at.residuals)
    return _finished(problem, name, at, slopes), slopes


def _descended(
    problem: Problem, at: Point, shared: Slopes, own: Sequence[int], colours: dict[str, Colour], most: int
) -> tuple[Point, Slopes]:
    """Steps with the slopes of `own` keys anew for each, until nothing is gained. The noise is what the first leave."""
    blocks, at = problem.judged(), _drawn_in(problem, at)
    slopes = _with(shared, problem.slopes(at.keys, at.z, at.free, own, at.residuals))
    for turn in range(most):
        at, gain = _stepped(problem, at, problem.sums(at.residuals, slopes, colours), blocks)
        if gain < ENOUGH and (turn >= SETTLING or most == 1):
            break
        if turn < SETTLING and most > 1:
            colours = problem.colours(at.residuals)
        slopes = _with(shared, problem.slopes(at.keys, at.z, at.free, own, at.residuals))
    return at, slopes


def _finished(problem: Problem, name: str, at: Point, slopes: Slopes) -> Fitted:
    sums = problem.sums(at.residuals, slopes, problem.colours(at.residuals))
    values = problem.values(at.keys, at.z, at.free)
    prior = problem.prior(at.keys, at.free)
    return Fitted(name, at.keys, at.z, at.free, values, prior, sums, at.residuals)


def _drawn_in(problem: Problem, at: Point) -> Point:
    """A point within its walls. What is recalibrated again beside numbers that have moved may be beyond them; from
    there each step back costs, and none would be taken.
    """
    z = drawn_in(at.z, problem.walls(at.keys, at.free))
    if z is at.z:
        return at
    return at._replace(z=z, residuals=problem.work.residuals(problem.values(at.keys, z, at.free)))


def _stepped(problem: Problem, at: Point, sums: dict[str, Sums], blocks: Array) -> tuple[Point, float]:
    """(point, gain) of a step, ever more damped until it helps under the noise of `sums`; where none does, none."""
    prior = problem.prior(at.keys, at.free)
    before = cost_of(sums, at.z, prior, blocks)
    colours = {name: one.colour for name, one in sums.items()}
    ends = (*ends_of(at.keys, at.free), problem.walls(at.keys, at.free))
    curve, slope, _ = gathered(sums, len(at.keys), blocks)
    curve, slope = curve + prior, slope + prior @ at.z
    scale = np.maximum(np.diag(curve), FLAT)
    for damping in DAMPINGS:
        there = at.z + walled(curve + damping * np.diag(scale), slope, at.z, *ends)
        try:
            found = problem.work.residuals(problem.values(at.keys, there, at.free))
        except InputError:  # a value that makes no such effect: not so far
            continue
        cost = squares(problem, found, colours, at.residuals, sums, blocks) + float(there @ prior @ there)
        if cost < before:
            return at._replace(z=there, residuals=found), before - cost
    return at, 0.0


def _with(slopes: Slopes, more: Slopes) -> Slopes:
    """Both; a column of `more` takes the place of one in `slopes`."""
    found = {}
    for name, (columns, pieces) in slopes.by_target.items():
        new, added = more.by_target[name]
        keep = [c for c, column in enumerate(columns) if column not in new]
        joined = [np.concatenate([p[:, keep], a], axis=1) for p, a in zip(pieces, added, strict=True)]
        found[name] = (np.concatenate([columns[keep], new]), joined)
    return Slopes(found)
