"""The data of a study: evaluation, trial, baseline. Plain data, independent of Optuna."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from tunefree_hil.base.errors import BenchError, TunefreeError
from tunefree_hil.tune.store import StudySettings

INTERRUPTED = "interrupted"  # the error of an attempt that was cut off


class Evaluation(NamedTuple):
    """The score of one set of parameters: finite, not negative, lower is better.

    scenarios: Plain JSON data by scenario (score, metrics, replans ...), stored unchanged.
    error: Not empty where the bench failed (a lost node); the score is then invalid. Raising BenchError is equivalent.
    """

    score: float
    scenarios: dict[str, Any]
    error: str = ""


class Trial(NamedTuple):
    """A filled slot; with `error` and score NaN a failed attempt. `number` is Optuna's, which counts failures too.

    violation: Of the requirements of the study, 0 where they are met or the study has none.
    """

    slot: int
    number: int
    parameters: dict[str, float]
    score: float
    scenarios: dict[str, Any]
    error: str = ""
    violation: float = 0.0


class TrialOrder(NamedTuple):
    """What trials are compared by, the smaller the better."""

    violation: float
    score: float
    slot: int


class Baseline(NamedTuple):
    """Scored parameters for comparison, stored with the study; they do not come from the search.

    violation: As of a Trial.
    """

    parameters: dict[str, float]
    score: float
    scenarios: dict[str, Any]
    violation: float = 0.0


class ScoredStudy(Protocol):
    """What a report needs of a study, wherever it is stored."""

    settings: StudySettings

    def trials(self) -> list[Trial]: ...
    def best(self) -> Trial | None: ...
    def baselines(self) -> dict[str, Baseline]: ...


Evaluate = Callable[[dict[str, float]], Evaluation]
EvaluateAll = Callable[[Mapping[int, dict[str, float]]], Sequence[Evaluation]]  # by slot, results in the same order


def check_evaluation(evaluation: Evaluation, name: str) -> None:
    """Raise BenchError where the bench failed, TunefreeError where the score is not finite or negative."""
    if evaluation.error:
        raise BenchError(evaluation.error, code="evaluation_failed")
    if not (math.isfinite(evaluation.score) and evaluation.score >= 0.0):
        message = f"{name} was scored {evaluation.score}; a score is finite and not negative"
        raise TunefreeError(message, code="bad_score")


def find_best_trial(trials: Sequence[Trial]) -> Trial | None:
    """The best trial: requirements first, then score, then the earliest; None without trials."""
    return min(trials, key=trial_order, default=None)


def trial_order(trial: Trial) -> TrialOrder:
    """Sort key: trials that meet the requirements by score, then the others by their violation; the earliest first."""
    return TrialOrder(trial.violation, trial.score, trial.slot)


def failure_text(error: TunefreeError) -> str:
    """The text that a failed attempt is stored with."""
    return INTERRUPTED if error.code == INTERRUPTED else f"{error.code}: {error.message}"
