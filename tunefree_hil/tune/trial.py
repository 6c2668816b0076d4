"""What a study speaks of: an evaluation, a trial, a baseline. Plain data, no Optuna."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from tunefree_hil.base.errors import BenchError, TunefreeError
from tunefree_hil.tune.store import Settings

CUT_OFF = "interrupted"  # the error of an attempt that was cut off


class Evaluation(NamedTuple):
    """What an evaluation says of one set of parameters. Lower is better; the score is finite and not negative.

    scenarios: by name, plain JSON data (score, metrics, replans, error names ...), kept as it is. error: not empty when
    the bench failed (a lost node); the score then does not count. Raising BenchError says the same.
    """

    score: float
    scenarios: dict[str, Any]
    error: str = ""


class Trial(NamedTuple):
    """One filled slot, or with `error` one attempt that failed (score NaN). `number` is Optuna's, and may run ahead."""

    slot: int
    number: int
    parameters: dict[str, float]
    score: float
    scenarios: dict[str, Any]
    error: str = ""


class Baseline(NamedTuple):
    """A set of parameters that was not searched for, scored beside the study and stored with it."""

    parameters: dict[str, float]
    score: float
    scenarios: dict[str, Any]


class Scored(Protocol):
    """What a report needs of a study, wherever that is kept."""

    settings: Settings

    def trials(self) -> list[Trial]: ...
    def best(self) -> Trial | None: ...
    def baselines(self) -> dict[str, Baseline]: ...


Evaluate = Callable[[dict[str, float]], Evaluation]
EvaluateAll = Callable[[Mapping[int, dict[str, float]]], Sequence[Evaluation]]  # by slot, answers in its order


def check(evaluation: Evaluation, of: str) -> None:
    """Raise BenchError where the bench failed, TunefreeError where the score is no score."""
    if evaluation.error:
        raise BenchError(evaluation.error, code="evaluation_failed")
    if not (math.isfinite(evaluation.score) and evaluation.score >= 0.0):
        raise TunefreeError(f"{of} was scored {evaluation.score}; a score is finite and not negative", code="bad_score")


def lowest(trials: Sequence[Trial]) -> Trial | None:
    """The trial of the lowest score, the earliest of equals; None of none."""
    return min(trials, key=lambda trial: (trial.score, trial.slot), default=None)
