"""Decompose a difference of scores (eq. 7) into terms by scenario and metric that add up to it.

The score of eq. 7 is the sum over scenarios j and metrics k of (m_j / M) (w_k / W_j) s_jk, plus (m_j / M) times the
penalty of the re-plans; W_j is the total weight of the available metrics. The score of a failed drive and the cap at
the failure score form a separate term, so that the terms always add up to the score.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.grade.score import FINISHED, counted_value

REPLANS, FAILURE = "re-plans", "failure or cap"


class ScoreDifference(NamedTuple):
    """Second score minus first: by scenario and term, by scenario, and in total."""

    terms: dict[str, dict[str, float]]
    scenarios: dict[str, float]
    total: float


def score_terms(drives: Mapping[str, Mapping[str, Any]], weights: WeightsSpec) -> dict[str, dict[str, float]]:
    """Terms of a score by scenario and name; their sum is the score. A failed drive has the failure term only.

    Args:
        drives: Grades as plain data (the fields of ScenarioGrade), by scenario.
    """
    planned = sum(int(drive["planned_samples"]) for drive in drives.values())
    return {
        name: _scenario_terms(drive, weights, int(drive["planned_samples"]) / planned) for name, drive in drives.items()
    }


def _scenario_terms(drive: Mapping[str, Any], weights: WeightsSpec, share: float) -> dict[str, float]:
    names = [name for name, weight in weights.metrics.items() if weight > 0.0]
    terms = dict.fromkeys([*names, REPLANS, FAILURE], 0.0)
    score = float(drive["score"])
    if drive["outcome"] == FINISHED:
        values = {name: drive["metrics"].get(name) for name in names}
        known = {name: counted_value(float(value), weights) for name, value in values.items() if value is not None}
        total = math.fsum(weights.metrics[name] for name in known)
        terms |= {name: share * weights.metrics[name] / total * value for name, value in known.items()}
        terms[REPLANS] = share * weights.replan_penalty * int(drive["replans"])
    terms[FAILURE] = _remainder(share * score, list(terms.values()))
    return terms


def _remainder(score: float, terms: list[float]) -> float:
    """Score minus the sum of the terms; 0 where it is only rounding."""
    rest = score - math.fsum(terms)
    return 0.0 if abs(rest) < 1e-12 * max(1.0, abs(score)) else rest


def score_difference(
    first: Mapping[str, Mapping[str, Any]], second: Mapping[str, Mapping[str, Any]], weights: WeightsSpec
) -> ScoreDifference:
    """Second minus first, term by term (negative: the second is better). Both must have the same scenarios."""
    before, after = score_terms(first, weights), score_terms(second, weights)
    terms = {name: {term: after[name][term] - before[name][term] for term in after[name]} for name in after}
    scenarios = {name: math.fsum(row.values()) for name, row in terms.items()}
    return ScoreDifference(terms, scenarios, math.fsum(value for row in terms.values() for value in row.values()))
