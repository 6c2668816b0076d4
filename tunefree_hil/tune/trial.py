"""The data of a study: evaluation, trial, baseline. Plain data, independent of Optuna."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from tunefree_hil.base.errors import BenchError, TunefreeError
from tunefree_hil.tune.store import StudySettings

INTERRUPTED = "interrupted"  # the error of an attempt that was cut off
OBJECTIVES = "objectives"  # key of stored data


class Evaluation(NamedTuple):
    """The score of one set of parameters: finite, not negative, lower is better.

    scenarios: Plain JSON data by scenario (score, metrics, replans ...), stored unchanged.
    error: Not empty where the bench failed (a lost node); the score is then invalid. Raising BenchError is equivalent.
    objectives: Of a study of several objectives, in the order of its settings; as a score each.
    """

    score: float
    scenarios: dict[str, Any]
    error: str = ""
    objectives: tuple[float, ...] = ()

    def as_data(self) -> dict[str, Any]:
        """Plain data, as it is stored: score, scenarios, and objectives where there are any."""
        return {
            "score": float(self.score),
            "scenarios": self.scenarios,
            **({OBJECTIVES: [float(value) for value in self.objectives]} if self.objectives else {}),
        }


def evaluation_from_data(data: Mapping[str, Any]) -> Evaluation:
    """The inverse of `Evaluation.as_data`."""
    return Evaluation(data["score"], data["scenarios"], objectives=tuple(data.get(OBJECTIVES, ())))


class Trial(NamedTuple):
    """A filled slot; with `error` and score NaN a failed attempt. `number` is Optuna's, which counts failures too.

    violation: Of the requirements of the study, 0 where they are met or the study has none.
    objectives: As of an Evaluation.
    trade: In a study of several objectives, how good they are together (pareto.py); lower is better.
    """

    slot: int
    number: int
    parameters: dict[str, float]
    score: float
    scenarios: dict[str, Any]
    error: str = ""
    violation: float = 0.0
    objectives: tuple[float, ...] = ()
    trade: float | None = None

    @property
    def merit(self) -> float:
        """What trials are ranked by, lower is better: the score, or the trade of several objectives."""
        return self.score if self.trade is None else self.trade


class TrialOrder(NamedTuple):
    """What trials are compared by, the smaller the better. merit: as of a Trial."""

    violation: float
    merit: float
    slot: int


class Baseline(NamedTuple):
    """Scored parameters for comparison, stored with the study; they do not come from the search.

    violation, objectives: As of a Trial.
    """

    parameters: dict[str, float]
    score: float
    scenarios: dict[str, Any]
    violation: float = 0.0
    objectives: tuple[float, ...] = ()


class ScoredStudy(Protocol):
    """What a report needs of a study, wherever it is stored."""

    settings: StudySettings

    def trials(self) -> list[Trial]: ...
    def best(self) -> Trial | None: ...
    def baselines(self) -> dict[str, Baseline]: ...


Evaluate = Callable[[dict[str, float]], Evaluation]
EvaluateAll = Callable[[Mapping[int, dict[str, float]]], Sequence[Evaluation]]  # by slot, results in the same order


def check_evaluation(evaluation: Evaluation, name: str) -> None:
    """Raise BenchError where the bench failed, TunefreeError for a negative or infinite score or objective."""
    if evaluation.error:
        raise BenchError(evaluation.error, code="evaluation_failed")
    for value in (evaluation.score, *evaluation.objectives):
        if not (math.isfinite(value) and value >= 0.0):
            message = f"{name} was scored {value}; a score is finite and not negative"
            raise TunefreeError(message, code="bad_score")


def find_best_trial(trials: Sequence[Trial]) -> Trial | None:
    """The best trial: requirements first, then score or trade, then the earliest; None without trials."""
    return min(trials, key=trial_order, default=None)


def trial_order(trial: Trial) -> TrialOrder:
    """Sort key: trials that meet the requirements by merit, then the others by their violation; the earliest first."""
    return TrialOrder(trial.violation, trial.merit, trial.slot)


def failure_text(error: TunefreeError) -> str:
    """The text that a failed attempt is stored with."""
    return INTERRUPTED if error.code == INTERRUPTED else f"{error.code}: {error.message}"
