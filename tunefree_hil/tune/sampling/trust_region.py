"""Local search by quadratic models in a trust region, from the best given trial (COBYQA of SciPy; Ragonneau 2022,
doi:10.5281/zenodo.10655367), with TPE beside it.

The first trials of a search are often manual sets, which drive. Near them the score is smooth, and a quadratic model of
few trials leads down faster than any sampler that begins with random points, of which half do not drive. The points of
the first model do not depend on scores, so they are tried at the same time; later ones come one after the other, and
the other slots of a generation get points of TPE. Where a search has converged, it begins again at the best trial.

COBYQA is run against the finished trials: a point that it asks for and that was tried gets the score of that trial, and
the first point without a score is the suggestion. So a suggestion is a function of the arguments alone.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from functools import lru_cache
from queue import SimpleQueue
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.tune.sampling.cma import rank_value
from tunefree_hil.tune.sampling.points import ScoredPoint, from_unit, sampler_value_from_score, to_unit
from tunefree_hil.tune.space import Space

MAX_EVALUATIONS = 100_000  # of one search; it converges long before
Values = tuple[float, ...]  # of the parameters, in the order of the space
MAX_OPEN_SEARCHES = 8  # of this process; a closed one is run again against the trials where it is needed


class TrustRegionCriteria(NamedTuple):
    """Radii in parts of each parameter's range on its scale."""

    first_radius: float = 0.15  # as the start of CMA-ES (cma.py)
    last_radius: float = 0.002  # a hundredth of a decade in the boxes of today; a smaller step moves no score
    most_starts: int = 32  # after so many converged searches there is nothing left to find near the best trial


CRITERIA = TrustRegionCriteria()


class SearchClosed(Exception):
    """Ends the thread of a search that is no longer needed."""


class LocalSearch:
    """One run of COBYQA, which waits for the value of each point that it asks for.

    It runs in a thread of its own, because SciPy's function calls the objective and not the other way round.
    """

    def __init__(self, start: np.ndarray) -> None:
        self.answers: list[tuple[Values, float]] = []  # points with their values, as they were given to it
        self._points: SimpleQueue[np.ndarray | None] = SimpleQueue()
        self._values: SimpleQueue[float | None] = SimpleQueue()
        threading.Thread(target=self._run, args=(start,), daemon=True, name="trust region").start()
        self.point = self._points.get()

    def tell(self, values: Values, value: float) -> None:
        """Give the value of `point`; `point` is then the next one, None where the search has converged."""
        self.answers.append((values, value))
        self._values.put(value)
        self.point = self._points.get()

    def close(self) -> None:
        """End the thread."""
        self._values.put(None)

    def _run(self, start: np.ndarray) -> None:
        from scipy.optimize import minimize  # here, since it takes a second

        options = {
            "initial_tr_radius": CRITERIA.first_radius,
            "final_tr_radius": CRITERIA.last_radius,
            "maxfev": MAX_EVALUATIONS,
        }
        try:
            minimize(self._evaluate, start, method="COBYQA", bounds=[(0.0, 1.0)] * len(start), options=options)
        except SearchClosed:
            return
        finally:
            self._points.put(None)

    def _evaluate(self, unit: np.ndarray) -> float:
        self._points.put(np.clip(unit, 0.0, 1.0))
        value = self._values.get()
        if value is None:
            raise SearchClosed
        return value


class OpenSearches:
    """The searches of this process, so that a suggestion does not begin from the first trial each time."""

    def __init__(self) -> None:
        self._searches: dict[tuple[Any, ...], LocalSearch] = {}

    def advance(self, space: Space, start: Values, known: Mapping[Values, float]) -> LocalSearch:
        """The search from `start`, which has got all the known values that it asks for."""
        key = (space.axes, start)
        search = self._searches.pop(key, None)
        if search is not None and any(known.get(values) != value for values, value in search.answers):
            search.close()
            search = None
        search = search or LocalSearch(np.array(start))
        while search.point is not None and (values := values_at(space, search.point)) in known:
            search.tell(values, known[values])
        self._searches[key] = search
        while len(self._searches) > MAX_OPEN_SEARCHES:
            self._searches.pop(next(iter(self._searches))).close()
        return search


SEARCHES = OpenSearches()


def suggest_local_points(
    space: Space,
    history: Sequence[ScoredPoint],
    *,
    given: int,
    count: int,
    pending: Sequence[Mapping[str, float]] = (),
) -> list[dict[str, float]]:
    """Suggest at most `count` points of the local search that are neither tried nor in flight.

    Args:
        space: Search space.
        history: Finished trials in slot order.
        given: Number of first trials that no sampler chose, such as manual sets; the best of them is the start.
        count: Largest number of points.
        pending: Sets of parameters in flight.

    Returns:
        Fewer points than `count` where the next ones depend on scores that are not known; none before the given trials
        are finished.
    """
    busy = {tuple(parameters[name] for name in space.names) for parameters in pending}
    suggested: list[dict[str, float]] = []
    for unit in _find_next_units(space, history, max(1, given)):
        values = values_at(space, unit)
        if values not in busy and len(suggested) < count:
            busy.add(values)
            suggested.append(from_unit(space, unit))
    return suggested


def _find_next_units(space: Space, history: Sequence[ScoredPoint], given: int) -> Sequence[np.ndarray]:
    """The points that the local search needs next; several where they do not depend on each other."""
    if len(history) < given:
        return []
    order = {tuple(point.parameters[name] for name in space.names): k for k, point in reversed([*enumerate(history)])}
    known = {values: sampler_value_from_score(rank_value(history[k])) for values, k in order.items()}
    used, last_start = given, ()
    for _ in range(CRITERIA.most_starts):
        best = min(history[:used], key=rank_value)
        start = tuple(float(share) for share in to_unit(space, best.parameters))
        if start == last_start:  # a search from the best trial has found nothing better
            return []
        unknown = [unit for unit in first_model_units(start) if values_at(space, unit) not in known]
        if unknown:
            return unknown
        search = SEARCHES.advance(space, start, known)
        if search.point is not None:
            return [search.point]
        used = max(used, *(1 + order[values] for values, _ in search.answers))
        last_start = start
    return []


@lru_cache(maxsize=64)
def first_model_units(start: Values) -> tuple[np.ndarray, ...]:
    """The points of the first model from a start, which depend on no score: 2 n + 1 of n parameters."""
    search = LocalSearch(np.array(start))
    units: list[np.ndarray] = []
    while search.point is not None and len(units) < 2 * len(start) + 1:
        units.append(search.point)
        search.tell((), 0.0)
    search.close()
    return tuple(units)


def values_at(space: Space, unit: np.ndarray) -> Values:
    """The allowed values of the parameters at a place of the unit box."""
    return tuple(from_unit(space, unit).values())
