"""Which trial wins: not the best grade, but the best of those that a slower car does not upset (docs/margins.md).

A search bends its gains to the plant that it is given, up to the edge where that plant just holds. What holds on the
vehicle is asked with a second car: the same plant with slower actuators. Pure functions of scores; who drives is
jobs/tune/robustness.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from tunefree_hil.grade.score import FINISHED
from tunefree_hil.tune.journal import slot_key
from tunefree_hil.tune.trial import Trial, lowest


class Came(NamedTuple):
    """What a set of parameters came to over all scenarios: score, re-plans, and drives that were not finished."""

    score: float
    replans: int
    failed: int

    @property
    def calm(self) -> bool:
        """Every drive was finished without a re-plan."""
        return not self.replans and not self.failed


Slower = Mapping[str, Came]  # in the slower car, by `slot_key` of a trial


def came_of(score: float, scenarios: Mapping[str, Any]) -> Came:
    """A trial's or a baseline's own drives, from grades as plain data."""
    failed = sum(drive.get("outcome", FINISHED) != FINISHED for drive in scenarios.values())
    return Came(score, sum(int(drive.get("replans", 0) or 0) for drive in scenarios.values()), failed)


def mean_of(trial: Trial, slower: Slower) -> float | None:
    """The mean grade of a trial, the car as it is and the slower one; None where the slower one was not driven."""
    came = slower.get(slot_key(trial.slot))
    return None if came is None else 0.5 * (trial.score + came.score)


def holds(trial: Trial, slower: Slower) -> bool:
    """Whether a trial drives both cars without a re-plan."""
    came = slower.get(slot_key(trial.slot))
    return came is not None and came.calm and came_of(trial.score, trial.scenarios).calm


def ranked(trials: Sequence[Trial], slower: Slower) -> list[Trial]:
    """The trials, the winner first: those that hold by their mean, then others by theirs, then by grade what was not
    driven. The earliest of equals first.
    """

    def place(trial: Trial) -> tuple[int, float, int]:
        mean = mean_of(trial, slower)
        if mean is None:
            return 2, trial.score, trial.slot
        return (0 if holds(trial, slower) else 1), mean, trial.slot

    return sorted(trials, key=place)


def ahead(trials: Sequence[Trial], slower: Slower) -> list[Trial]:
    """Trials that may still win and have to be driven in the slower car for that, the best grade first.

    A trial that is not calm in the car as it is cannot hold; one whose grade there is no better than the best mean of
    a trial that holds is taken not to win, as a slower car is driven no better.
    """
    means = [mean for one in trials if holds(one, slower) and (mean := mean_of(one, slower)) is not None]
    best = min(means, default=math.inf)
    not_driven = [one for one in trials if slot_key(one.slot) not in slower]
    open_ = [one for one in not_driven if one.score < best and came_of(one.score, one.scenarios).calm]
    return sorted(open_, key=lambda one: (one.score, one.slot))


def passed_over(trials: Sequence[Trial], slower: Slower) -> list[Trial]:
    """Trials that are better than the winner by grade alone, the best of them first."""
    if not trials or lowest(trials) is None:
        return []
    winner = ranked(trials, slower)[0]
    better = [one for one in trials if (one.score, one.slot) < (winner.score, winner.slot)]
    return sorted(better, key=lambda one: (one.score, one.slot))
