"""What a drive of a road sweep comes to: passed, a requirement missed, or stability lost."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from tunefree_hil.config.tuning.require_schema import REQUIREMENTS
from tunefree_hil.grade.requirements.judgement import FINISHED_OUTCOME, RequirementResult, oscillates
from tunefree_hil.grade.requirements.limits import RequirementLimits, oscillation_limits
from tunefree_hil.jobs.robustness.driving.chunk import DriveRow

REPLAN, OSCILLATION, REQUIREMENT = "replan", "oscillation", "requirement"  # causes beside the outcomes of a drive


class DriveState(IntEnum):
    """What a drive, or the worst drive of a road, came to; larger is worse."""

    PASSED = 0
    REQUIREMENT_MISSED = 1  # driven to its end, calm, without a re-plan, but beyond another limit
    STABILITY_LOST = 2  # not driven to its end, a re-plan, or an oscillation beyond its limit


class DriveJudgement(NamedTuple):
    """A judged drive.

    Attributes:
        cause: The first that applies: outcome of a drive that was not finished, a re-plan, an oscillation, a
            requirement; '' where it passed.
        binding: The requirement with the largest value over its limit; None where none has a value.
    """

    state: DriveState
    cause: str
    binding: RequirementResult | None

    @property
    def ratio(self) -> float:
        """Value over limit of the binding requirement; infinite where the drive was not finished."""
        if self.cause not in ("", REPLAN, OSCILLATION, REQUIREMENT):
            return math.inf
        return 0.0 if self.binding is None else _closeness(self.binding)


def judge_row(row: DriveRow, limits: RequirementLimits, road: str = "") -> DriveJudgement:
    """Judge a drive by the requirements of its bench. road: its name, for the binding requirement."""
    values = dict(zip(REQUIREMENTS, row.values, strict=True))
    results = [
        RequirementResult(name, value, limit, road)
        for name, limit in limits.items()
        if (value := values.get(name)) is not None
    ]
    binding = max(results, key=_closeness, default=None)
    if row.outcome != FINISHED_OUTCOME:
        return DriveJudgement(DriveState.STABILITY_LOST, row.outcome, binding)
    if row.replans > limits.get("replans", math.inf):
        return DriveJudgement(DriveState.STABILITY_LOST, REPLAN, binding)
    if oscillates(values, limits):
        return DriveJudgement(DriveState.STABILITY_LOST, OSCILLATION, _worst_swing(results))
    if binding is not None and not binding.is_met:
        return DriveJudgement(DriveState.REQUIREMENT_MISSED, REQUIREMENT, binding)
    return DriveJudgement(DriveState.PASSED, "", binding)


def _closeness(result: RequirementResult) -> float:
    """Value over limit; of a count that must be 0 and is, 0: it is not nearly violated."""
    return 0.0 if result.is_met and result.limit == 0.0 else result.ratio


def _worst_swing(results: list[RequirementResult]) -> RequirementResult:
    swings = oscillation_limits()
    return max((result for result in results if result.name in swings), key=lambda result: result.ratio)
