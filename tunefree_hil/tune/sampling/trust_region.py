"""Local search by quadratic models in a trust region, from the best given trial (COBYQA of SciPy; Ragonneau 2022,
doi:10.5281/zenodo.10655367), with TPE beside it.

The first trials of a search are often manual sets, which drive. Near them the score is smooth, and a quadratic model of
few trials leads down faster than any sampler that begins with random points, of which half do not drive. The points of
the first model do not depend on scores, so they are tried at the same time; later ones come one after the other, and
the other slots of a generation get points of TPE. Where a search has converged, some trials of TPE follow, and it
begins again at the best trial of all.

COBYQA is run against the finished trials: a point that it asks for and that was tried gets the score of that trial, and
the first point without a score is the suggestion. So a suggestion is a function of the arguments alone.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from queue import SimpleQueue
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.tune.sampling.points import ScoredPoint, from_unit, sampler_value_from_score, to_unit
from tunefree_hil.tune.sampling.ranking import rank_value
from tunefree_hil.tune.space import Axis, Space

MAX_EVALUATIONS = 100_000  # of one search; it converges long before
Values = tuple[float, ...]  # of the parameters, in the order of the space
SearchKey = tuple[tuple[Axis, ...], Values]  # axes and start of a search
MAX_REMEMBERED = 64  # searches of this process; another one is run again against the trials where it is needed


class TrustRegionCriteria(NamedTuple):
    """Radii in parts of each parameter's range on its scale."""

    first_radius: float = 0.15  # as the start of CMA-ES (cma.py)
    last_radius: float = 0.002  # a hundredth of a decade in the boxes of today; a smaller step moves no score
    trials_between: int = 20  # of TPE between two local searches, so that it may find a better region
    most_starts: int = 100  # no search comes to so many


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
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, args=(start,), daemon=True, name="trust region")
        self._thread.start()
        self.point = self._next_point()

    def tell(self, values: Values, value: float) -> None:
        """Give the value of `point`; `point` is then the next one, None where the search has converged."""
        self.answers.append((values, value))
        self._values.put(value)
        self.point = self._next_point()

    def close(self) -> None:
        """End the thread."""
        self._values.put(None)
        self._thread.join()

    def _next_point(self) -> np.ndarray | None:
        """Wait for the next point; an error of COBYQA is raised here."""
        point = self._points.get()
        if self._error is not None:
            raise self._error
        return point

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
        except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
            self._error = error
        finally:
            self._points.put(None)

    def _evaluate(self, unit: np.ndarray) -> float:
        self._points.put(np.clip(unit, 0.0, 1.0))
        value = self._values.get()
        if value is None:
            raise SearchClosed
        return value


class SearchState(NamedTuple):
    """A search that has got all known values that it asked for.

    point: The next one in the unit box; None where it has converged.
    answers: Points with their values.
    """

    point: np.ndarray | None
    answers: Sequence[tuple[Values, float]]


class LocalSearches:
    """The searches of this process, so that a suggestion does not begin from the first trial each time.

    SciPy runs one COBYQA at a time, others wait for it; so one search is open, and of others their answers are kept.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: tuple[SearchKey, LocalSearch] | None = None
        self._converged: dict[SearchKey, Sequence[tuple[Values, float]]] = {}
        self._first_models: dict[Values, tuple[np.ndarray, ...]] = {}

    def advance(self, space: Space, start: Values, known: Mapping[Values, float]) -> SearchState:
        """The search from `start`, with the values of `known` that it asks for."""
        key = (space.axes, start)
        with self._lock:
            answers = self._converged.get(key)
            if answers is not None and _agree(answers, known):
                return SearchState(None, answers)
            search = self._continue(key, known)
            while search.point is not None and (values := values_at(space, search.point)) in known:
                search.tell(values, known[values])
            if search.point is None:
                self._close()
                _remember(self._converged, key, tuple(search.answers))
            return SearchState(search.point, search.answers)

    def first_model_units(self, start: Values) -> tuple[np.ndarray, ...]:
        """The points of the first model from a start, which depend on no score: 2 n + 1 of n parameters."""
        with self._lock:
            if start not in self._first_models:
                self._close()
                _remember(self._first_models, start, _draw_first_model(start))
            return self._first_models[start]

    def forget(self) -> None:
        """Forget all searches, as in a new process."""
        with self._lock:
            self._close()
            self._converged.clear()
            self._first_models.clear()

    def _continue(self, key: SearchKey, known: Mapping[Values, float]) -> LocalSearch:
        """The open search where it is this one and has got these values, else a new one."""
        if self._open is None or self._open[0] != key or not _agree(self._open[1].answers, known):
            self._close()
            self._open = (key, LocalSearch(np.array(key[1])))
        return self._open[1]

    def _close(self) -> None:
        if self._open is not None:
            self._open[1].close()
            self._open = None


SEARCHES = LocalSearches()


def _agree(answers: Sequence[tuple[Values, float]], known: Mapping[Values, float]) -> bool:
    """Whether a search has got the scores of these trials."""
    return all(known.get(values) == value for values, value in answers)


def _remember(entries: dict[Any, Any], key: Any, value: Any) -> None:
    """Keep a value, and at most MAX_REMEMBERED of them."""
    entries[key] = value
    while len(entries) > MAX_REMEMBERED:
        entries.pop(next(iter(entries)))


def _draw_first_model(start: Values) -> tuple[np.ndarray, ...]:
    search = LocalSearch(np.array(start))
    units: list[np.ndarray] = []
    while search.point is not None and len(units) < 2 * len(start) + 1:
        units.append(search.point)
        search.tell((), 0.0)
    search.close()
    return tuple(units)


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
        if start != last_start:
            unknown = [unit for unit in SEARCHES.first_model_units(start) if values_at(space, unit) not in known]
            if unknown:
                return unknown
            search = SEARCHES.advance(space, start, known)
            if search.point is not None:
                return [search.point]
            used = max(used, *(1 + order[values] for values, _ in search.answers))
        last_start = start
        used += CRITERIA.trials_between
        if len(history) < used:
            return []
    return []


def values_at(space: Space, unit: np.ndarray) -> Values:
    """The allowed values of the parameters at a place of the unit box."""
    return tuple(from_unit(space, unit).values())
