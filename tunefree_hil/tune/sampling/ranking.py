"""One number for score and violation, for samplers that know no constraint."""

from __future__ import annotations

from typing import NamedTuple, Protocol


class RankCriteria(NamedTuple):
    """How much a violation of the requirements counts beside the score."""

    # a violation of 20 % doubles a score; ranked behind all others, as TPE ranks them, points beyond a limit by 1 %
    # would hide the best ones, which lie along the limits
    violation_weight: float = 5.0
    most_violation: float = 20.0  # a failed drive is 100; all failures are equally bad


CRITERIA = RankCriteria()


class RankedPoint(Protocol):
    """Parameters with what ranks them; such as `ScoredPoint`."""

    @property
    def parameters(self) -> dict[str, float]: ...

    @property
    def score(self) -> float: ...

    @property
    def violation(self) -> float | None: ...


def rank_value(point: RankedPoint) -> float:
    """Orders points: the score, which grows with the violation of the requirements."""
    return point.score * (1.0 + CRITERIA.violation_weight * min(point.violation or 0.0, CRITERIA.most_violation))
