"""Objectives of a search: the part of the score that judges tracking, and the part that judges comfort and effort.

An objective is the score (score.py) over the weighted metrics of some aspects alone, with the weights of the same file.
Re-plans and failures count in each of them, so a failed drive is bad in all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.grade.score import FINISHED, ScenarioGrade, counted_value
from tunefree_hil.grade.table import COMFORT, EFFORT, PERFORMANCE, SAFETY, TABLE

OBJECTIVES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"tracking": (PERFORMANCE, SAFETY), "comfort": (COMFORT, EFFORT)}
)  # aspects of the metric table by objective


def choose_objectives(names: Sequence[str], weights: WeightsSpec, file: str) -> tuple[str, ...]:
    """The objectives of a search in their own order; empty for a search by the score alone.

    Args:
        names: All of OBJECTIVES, or none.
        weights: They must weigh metrics of each objective.
        file: The bench file, for the error.

    Raises:
        InputError: One objective of two, an unknown name, or weights without metrics of an objective.
    """
    if not names:
        return ()
    if sorted(names) != sorted(OBJECTIVES):
        message = f"objectives are {', '.join(OBJECTIVES)} together, not {', '.join(names)}"
        hint = "give both; a search by one objective has no trade, and the score weighs both"
        raise InputError(message, code="bad_objectives", file=file, key="tune.objectives", hint=hint)
    for objective in OBJECTIVES:
        metrics_of_objective(objective, weights)
    return tuple(OBJECTIVES)


def metrics_of_objective(objective: str, weights: WeightsSpec) -> dict[str, float]:
    """The weights of the metrics of an objective. Raises InputError where the file weighs none of them."""
    aspects = OBJECTIVES[objective]
    chosen = {
        name: weight for name, weight in weights.metrics.items() if weight > 0.0 and TABLE[name].aspect in aspects
    }
    if not chosen:
        raise InputError(
            f"weights {weights.name!r} have no metric of {' or '.join(aspects)}, so they cannot judge {objective}",
            code="no_objective",
            file=weights.path,
            key="metrics",
            hint='use weights = "default", or search by the score alone',
        )
    return chosen


def measure_objectives(
    drives: Mapping[str, Mapping[str, Any]], weights: WeightsSpec, objectives: Sequence[str]
) -> tuple[float, ...]:
    """The objectives over several drives, combined as scores are (paper, eq. 7).

    Args:
        drives: Grades as plain data (the fields of ScenarioGrade), by scenario.
        weights: The weights file that the drives were graded with.
        objectives: Names of OBJECTIVES.

    Raises:
        InputError: No drive has a metric of an objective.
    """
    return tuple(_combine(drives, weights, objective) for objective in objectives)


def _combine(drives: Mapping[str, Mapping[str, Any]], weights: WeightsSpec, objective: str) -> float:
    """One objective: the mean by planned samples over the drives that have a value."""
    total, samples = 0.0, 0
    for drive in drives.values():
        value = measure_objective(drive, weights, objective)
        planned = int(drive["planned_samples"])  # 0: the worst of the other cars of an ensemble
        if value is not None and planned:
            total += planned * value
            samples += planned
    if not samples:
        raise _missing_metrics(weights, objective)
    return total / samples


def grades_by_objective(grades: Sequence[ScenarioGrade], weights: WeightsSpec, objective: str) -> list[ScenarioGrade]:
    """The grades with an objective as their score, to be combined like scores; those without a value are left out.

    Raises:
        InputError: No grade has a metric of the objective.
    """
    values = [measure_objective(grade._asdict(), weights, objective) for grade in grades]
    judged = [grade._replace(score=v) for grade, v in zip(grades, values, strict=True) if v is not None]
    if not judged:
        raise _missing_metrics(weights, objective)
    return judged


def measure_objective(drive: Mapping[str, Any], weights: WeightsSpec, objective: str) -> float | None:
    """An objective of one drive; None where none of its metrics was available, as in one of less than 3 s.

    Raises:
        InputError: None of its metrics is weighed.
    """
    chosen = metrics_of_objective(objective, weights)
    if drive["outcome"] != FINISHED:
        return weights.failure_score
    values = {name: value for name in chosen if (value := drive["metrics"].get(name)) is not None}
    if not values:
        return None
    share = math.fsum(chosen[name] for name in values)
    mean = math.fsum(chosen[name] * counted_value(float(value), weights) for name, value in values.items()) / share
    return min(mean + weights.replan_penalty * int(drive["replans"]), weights.failure_score)


def _missing_metrics(weights: WeightsSpec, objective: str) -> InputError:
    return InputError(
        f"no drive has a metric of {objective}",
        code="nothing_to_grade",
        file=weights.path,
        hint="drive scenarios of more than 3 s, with INS frames, or search by the score alone",
    )
