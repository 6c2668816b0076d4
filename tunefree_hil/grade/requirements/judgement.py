"""Whether the drives of a set of gains keep the requirements, by how much not, and where."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.grade.requirements.limits import CRITERIA, RequirementLimits, oscillation_limits

GradesAsData = Mapping[str, Mapping[str, Any]]  # by road; each a ScenarioGrade.as_data
FINISHED_OUTCOME = "finished"


class RequirementResult(NamedTuple):
    """The worst value of a requirement, and the road on which it was reached."""

    name: str
    value: float
    limit: float
    road: str

    @property
    def ratio(self) -> float:
        """value / limit; kept up to 1. Of a limit of 0, which is of a count: 1 + value."""
        return self.value / self.limit if self.limit > 0.0 else 1.0 + self.value

    @property
    def is_met(self) -> bool:
        """Whether the limit is kept on every road."""
        return self.ratio <= 1.0


class RequirementJudgement(NamedTuple):
    """The requirements over several drives.

    results: One for each requirement that a drive has a value of.
    not_judged: Number of drives without a value, by name of the requirement.
    failed: Roads that were not driven to their end.
    """

    results: tuple[RequirementResult, ...] = ()
    not_judged: Mapping[str, int] = {}
    failed: tuple[str, ...] = ()

    @property
    def binding(self) -> RequirementResult | None:
        """The requirement that is violated most; None where all are met."""
        violated = [result for result in self.results if not result.is_met]
        return max(violated, key=lambda result: result.ratio, default=None)

    @property
    def violation(self) -> float:
        """The largest value / limit - 1 beyond 0; that of a failed drive is fixed."""
        if self.failed:
            return CRITERIA.failed_violation
        return 0.0 if self.binding is None else min(self.binding.ratio - 1.0, CRITERIA.failed_violation)

    @property
    def is_met(self) -> bool:
        """Whether all drives were finished within all limits that could be judged."""
        return self.violation == 0.0

    def as_data(self) -> dict[str, Any]:
        """Plain data for JSON."""
        requirements = {
            result.name: {"value": result.value, "limit": result.limit, "road": result.road, "met": result.is_met}
            for result in self.results
        }
        return {
            "met": self.is_met,
            "violation": self.violation,
            "requirements": requirements,
            "not_judged": dict(self.not_judged),
            "failed": list(self.failed),
        }


def oscillates(requirements: Mapping[str, float | None], limits: RequirementLimits) -> bool:
    """Whether a drive with these values swings, or takes turns between the pedals, beyond one of the limits."""
    values = ((requirements.get(name), limits.get(name, math.inf)) for name in oscillation_limits())
    return any(value is not None and value > limit for value, limit in values)


def judge_drives(drives: GradesAsData, limits: RequirementLimits) -> RequirementJudgement:
    """The worst value of every requirement over the drives of one set of gains.

    Args:
        drives: Drives without the key "requirements", of an earlier version, have no value.
        limits: Limits that count.
    """
    results, not_judged = list[RequirementResult](), dict[str, int]()
    for name, limit in limits.items():
        values = {road: (drive.get("requirements") or {}).get(name) for road, drive in drives.items()}
        known = [RequirementResult(name, value, limit, road) for road, value in values.items() if value is not None]
        if known:
            results.append(max(known, key=lambda result: result.value))
        if len(known) < len(values):
            not_judged[name] = len(values) - len(known)
    failed = [road for road, drive in drives.items() if drive.get("outcome", FINISHED_OUTCOME) != FINISHED_OUTCOME]
    return RequirementJudgement(tuple(results), not_judged, tuple(failed))


def measure_violation(drives: GradesAsData, limits: RequirementLimits) -> float:
    """The violation by a set of gains, as a search counts it: 0 without limits, where the score alone decides."""
    return judge_drives(drives, limits).violation if limits else 0.0


def violation_text(judgement: RequirementJudgement) -> str:
    """'steer_oscillation_rad 1.02 > 0.05 on lane_change_29mps', with how many more; '' where all are met."""
    parts = [f"not driven to the end: {', '.join(judgement.failed)}"] if judgement.failed else []
    worst = judgement.binding
    if worst is not None:
        more = sum(not result.is_met for result in judgement.results) - 1
        also = f" (and {more} more requirement{'s' if more > 1 else ''})" if more else ""
        parts.append(f"{result_text(worst)} on {worst.road}{also}")
    return "; ".join(parts)


def result_text(result: RequirementResult) -> str:
    """'steer_oscillation_rad 1.02 > 0.05'."""
    return f"{result.name} {result.value:.3g} {'<=' if result.is_met else '>'} {result.limit:.3g}"


def not_judged_text(judgement: RequirementJudgement) -> str:
    """'replans not judged (3 drives without it)'; '' where all were."""
    if not judgement.not_judged:
        return ""
    judged = {result.name for result in judgement.results}
    never = [name for name in judgement.not_judged if name not in judged]
    partly = [f"{name} on {count}" for name, count in judgement.not_judged.items() if name in judged]
    parts = [f"not judged, as their columns are missing or the drives too short: {', '.join(never)}"] if never else []
    parts += [f"not judged on some roads: {', '.join(partly)}"] if partly else []
    return "; ".join(parts)
