"""The verdict on tuned gains: requirements first, then a gain over the best manual set that meets them too."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any, NamedTuple

from tunefree_hil.grade.requirements.judgement import GradesAsData, RequirementJudgement, judge_drives
from tunefree_hil.grade.requirements.limits import RequirementLimits


class GainsVerdict(Enum):
    """What tuned gains are worth; the value is the first word of a sentence, and stored."""

    ACCEPTED = "ACCEPTED"
    NO_GAIN = "NO GAIN"  # a manual set that meets the requirements is as good
    REJECTED = "REJECTED"  # a requirement is violated, or a drive failed


class GainsVerdictCriteria(NamedTuple):
    """When tuned gains are worth their search."""

    gain_margin: float = 0.02  # share of the score; less is within what other roads change (issue 44: one or two seeds)


CRITERIA = GainsVerdictCriteria()


class JudgedGains(NamedTuple):
    """A set of gains over some roads: its score, and the requirements."""

    score: float
    judgement: RequirementJudgement


class DecidedGains(NamedTuple):
    """A verdict with what it was decided from.

    manual: The best manual set: one that meets the requirements before one that does not, then the score.
    manuals: All manual sets by name.
    """

    verdict: GainsVerdict
    tuned: JudgedGains
    manual: str
    manuals: Mapping[str, JudgedGains]

    @property
    def best_manual(self) -> JudgedGains:
        """The set that `manual` names."""
        return self.manuals[self.manual]

    def as_data(self) -> dict[str, Any]:
        """Plain data: the verdict, and what was judged by name of the manual set."""
        return {
            "verdict": self.verdict.value,
            "requirements": self.tuned.judgement.as_data(),
            "manual_requirements": {name: gains.judgement.as_data() for name, gains in self.manuals.items()},
        }


def judge_gains(score: float, drives: GradesAsData, limits: RequirementLimits) -> JudgedGains:
    """A set of gains from the grades of its drives as plain data."""
    return JudgedGains(score, judge_drives(drives, limits))


def decide_verdict(tuned: JudgedGains, manuals: Mapping[str, JudgedGains]) -> DecidedGains:
    """Decide on tuned gains.

    Args:
        tuned: The winner of a search.
        manuals: Manual sets over the same roads, by name; at least one.
    """
    manual = min(manuals, key=lambda name: (manuals[name].judgement.violation, manuals[name].score))
    best = manuals[manual]
    if not tuned.judgement.is_met:
        verdict = GainsVerdict.REJECTED
    elif best.judgement.is_met and tuned.score > (1.0 - CRITERIA.gain_margin) * best.score:
        verdict = GainsVerdict.NO_GAIN
    else:
        verdict = GainsVerdict.ACCEPTED
    return DecidedGains(verdict, tuned, manual, manuals)
