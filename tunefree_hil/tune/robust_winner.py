"""The rule that picks the winner: the best trial of those that also pass with slower actuators.

A search adapts the gains to its plant, up to the edge of stability of that plant. Whether they transfer to the vehicle
is checked with a slower car: the same plant with slower actuators (docs/reference/margins.md). These are pure functions
of scores; jobs/tune/robustness.py drives the cars.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

from tunefree_hil.grade.score import FINISHED
from tunefree_hil.tune.journal import slot_key
from tunefree_hil.tune.trial import Trial, find_best_trial, trial_order


class DriveTotals(NamedTuple):
    """Over all scenarios: score, and numbers of re-plans, of unfinished drives, and of drives that oscillate.

    trade: In a study of several objectives, as of a Trial. Stored under its field names, trade only where it is.
    """

    score: float
    replans: int
    failed: int
    oscillating: int = 0
    trade: float | None = None

    @property
    def merit(self) -> float:
        """What the slower car adds to the ranking, lower is better: the score, or the trade of several objectives."""
        return self.score if self.trade is None else self.trade

    @property
    def is_clean(self) -> bool:
        """Whether every drive was finished without a re-plan and without an oscillation beyond its limit."""
        return not self.replans and not self.failed and not self.oscillating


SlowerTotals = Mapping[str, DriveTotals]  # in the slower car, by `slot_key` of a trial


class RobustnessRank(IntEnum):
    """Result of the robustness check of a trial, the best first."""

    PASSED = 0
    FAILED = 1
    NOT_DRIVEN = 2


def drive_totals(score: float, scenarios: Mapping[str, Any]) -> DriveTotals:
    """Totals of a trial or a baseline in the nominal car, from grades as plain data.

    Oscillations are not counted there: the requirements of the search have judged them.
    """
    failed = sum(drive.get("outcome", FINISHED) != FINISHED for drive in scenarios.values())
    return DriveTotals(score, sum(int(drive.get("replans", 0) or 0) for drive in scenarios.values()), failed)


def mean_merit(trial: Trial, slower: SlowerTotals) -> float | None:
    """Mean of the merits (score, or trade) in the nominal and in the slower car; None where that was not driven."""
    totals = slower.get(slot_key(trial.slot))
    return None if totals is None else 0.5 * (trial.merit + totals.merit)


def is_robust(trial: Trial, slower: SlowerTotals) -> bool:
    """Whether a trial drives both cars without a re-plan, and the slower one without an oscillation."""
    totals = slower.get(slot_key(trial.slot))
    return totals is not None and totals.is_clean and drive_totals(trial.score, trial.scenarios).is_clean


def rank_trials(trials: Sequence[Trial], slower: SlowerTotals) -> list[Trial]:
    """Sort the trials, the winner first.

    Of trials that meet the requirements: robust trials by their mean merit, then the others by theirs, then trials that
    were not driven in the slower car by their merit; the earliest of equals first. Then the other trials by their
    violation.
    """
    return sorted(trials, key=lambda trial: (trial.violation, *_rank(trial, slower), trial.slot))


def _rank(trial: Trial, slower: SlowerTotals) -> tuple[RobustnessRank, float]:
    mean = mean_merit(trial, slower)
    if mean is None:
        return RobustnessRank.NOT_DRIVEN, trial.merit
    return RobustnessRank.PASSED if is_robust(trial, slower) else RobustnessRank.FAILED, mean


def find_open_trials(trials: Sequence[Trial], slower: SlowerTotals) -> list[Trial]:
    """Trials that may still win and must be driven in the slower car for that, the best merit first.

    A trial that re-plans or fails in the nominal car cannot win, nor one that violates the requirements by more than
    another. Nor can one whose merit is no better than the best mean of a robust trial, on the assumption that its merit
    in the slower car is not better than in the nominal one.
    """
    least = min((trial.violation for trial in trials), default=0.0)
    trials = [trial for trial in trials if trial.violation == least]
    means = [mean for trial in trials if is_robust(trial, slower) and (mean := mean_merit(trial, slower)) is not None]
    best = min(means, default=math.inf)
    not_driven = [trial for trial in trials if slot_key(trial.slot) not in slower]
    candidates = [
        trial for trial in not_driven if trial.merit < best and drive_totals(trial.score, trial.scenarios).is_clean
    ]
    return sorted(candidates, key=lambda trial: (trial.merit, trial.slot))


def find_rejected_trials(trials: Sequence[Trial], slower: SlowerTotals) -> list[Trial]:
    """Trials that are better in the nominal car than the winner, requirements first, then merit; the best first."""
    if not trials or find_best_trial(trials) is None:
        return []
    winner = rank_trials(trials, slower)[0]
    return sorted((trial for trial in trials if trial_order(trial) < trial_order(winner)), key=trial_order)
