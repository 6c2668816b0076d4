"""Where a difference of scores comes from: eq. 7 taken apart into terms that add up to it.

The score of eq. 7 is a sum over scenarios j and metrics k of (m_j / M) (w_k / W_j) s_jk, plus (m_j / M) times the
re-plans' penalty; W_j is the weight of the metrics that could be had. What a failed drive scores, and what the cap at
the failure score takes away, is a term of its own, so that the terms add up to the score whatever happened.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.grade.score import FINISHED

REPLANS, FAILURE = "re-plans", "failure or cap"


class Difference(NamedTuple):
    """terms: by scenario, then by term, other - first; a row adds up to scenarios[name], all of them to total."""

    terms: dict[str, dict[str, float]]
    scenarios: dict[str, float]
    total: float


def terms_of(drives: Mapping[str, Mapping[str, Any]], weights: WeightsSpec) -> dict[str, dict[str, float]]:
    """A score's terms by scenario. drives: grades as plain data (ScenarioGrade's fields), by scenario.

    All of them add up to eq. 7's score. A drive that was not driven to its end has the failure term only.
    """
    planned = sum(int(drive["planned_samples"]) for drive in drives.values())
    return {name: _terms(drive, weights, int(drive["planned_samples"]) / planned) for name, drive in drives.items()}


def _terms(drive: Mapping[str, Any], weights: WeightsSpec, share: float) -> dict[str, float]:
    names = [name for name, weight in weights.metrics.items() if weight > 0.0]
    terms = dict.fromkeys([*names, REPLANS, FAILURE], 0.0)
    score = float(drive["score"])
    if drive["outcome"] == FINISHED:
        had = {name: float(drive["metrics"][name]) for name in names if drive["metrics"].get(name) is not None}
        total = math.fsum(weights.metrics[name] for name in had)
        terms |= {name: share * weights.metrics[name] / total * value for name, value in had.items()}
        terms[REPLANS] = share * weights.replan_penalty * int(drive["replans"])
    terms[FAILURE] = _rest(share * score, list(terms.values()))
    return terms


def _rest(score: float, terms: list[float]) -> float:
    """What the terms lack of the score; rounding is none of it."""
    rest = score - math.fsum(terms)
    return 0.0 if abs(rest) < 1e-12 * max(1.0, abs(score)) else rest


def difference(
    first: Mapping[str, Mapping[str, Any]], other: Mapping[str, Mapping[str, Any]], weights: WeightsSpec
) -> Difference:
    """other - first, term by term (negative: the other is better). Both must have the same scenarios."""
    before, after = terms_of(first, weights), terms_of(other, weights)
    terms = {name: {term: after[name][term] - before[name][term] for term in after[name]} for name in after}
    scenarios = {name: math.fsum(row.values()) for name, row in terms.items()}
    return Difference(terms, scenarios, math.fsum(value for row in terms.values() for value in row.values()))
