"""Several objectives: the Pareto front of a study, and the rule that picks one trial of it.

The rule is the Nash bargaining solution (Nash 1950, Econometrica 18, 155-162, doi:10.2307/1907266), which is in use to
pick one controller of a front (Sanchez, Visioli and Vilanova 2017, doi:10.1016/j.jfranklin.2017.03.012). The point from
which both objectives must gain is the best manual set: of the trials that are better in every objective, the one with
the largest product of the gains wins. It follows from the trial and the manual set alone, so that a further trial at an
end of the front, which moves a knee, changes nothing, and a front of one point has an answer. The unit of an objective
cancels out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from tunefree_hil.tune.compare import find_best_baseline
from tunefree_hil.tune.trial import Baseline, Trial

Objectives = tuple[float, ...]  # of one candidate, lower is better


class TradeCriteria(NamedTuple):
    """How the trade of several objectives is weighed."""

    smallest_objective: float = 1e-6  # score; an objective of 0 (no error at all) of the manual set has no shares
    # share of the other objectives that counts where an objective is worse than that of the manual set: enough to
    # order trials which are equal in their worst one, too little to outweigh it
    tie_share: float = 1e-6


CRITERIA = TradeCriteria()


class Front(NamedTuple):
    """The Pareto-optimal trials of a study, the best first objective in front.

    trials: Of the least violation of the requirements; each is better than any other trial in an objective.
    reference: Objectives of the best manual set.
    """

    trials: list[Trial]
    manual: str
    reference: Objectives

    def extreme(self, objective: int) -> Trial:
        """The trial of the front that is best in one objective."""
        return min(self.trials, key=lambda trial: (trial.objectives[objective], trial.objectives, trial.slot))


def dominates(first: Objectives, second: Objectives) -> bool:
    """Whether `first` is no worse in any objective and better in one."""
    return first != second and all(a <= b for a, b in zip(first, second, strict=True))


def find_front(points: Sequence[Objectives]) -> list[int]:
    """The indices of the points that no other point dominates, by the first objective; of equal points all."""
    front: list[int] = []
    for index in sorted(range(len(points)), key=lambda i: (points[i], i)):  # dominating points come first
        if not any(dominates(points[other], points[index]) for other in front):
            front.append(index)
    return front


def find_study_front(trials: Sequence[Trial], baselines: Mapping[str, Baseline]) -> Front:
    """The front of a study with several objectives and at least one baseline.

    Only trials of the least violation are on it: as in the ranking, requirements come first.
    """
    least = min((trial.violation for trial in trials), default=0.0)
    eligible = [trial for trial in trials if trial.violation == least]
    front = [eligible[index] for index in find_front([trial.objectives for trial in eligible])]
    return Front(front, find_best_baseline(baselines).name, find_reference(baselines))


def find_reference(baselines: Mapping[str, Baseline]) -> Objectives:
    """The objectives of the best baseline. Raises InputError without baselines."""
    return baselines[find_best_baseline(baselines).name].objectives


def measure_trade(objectives: Objectives, reference: Objectives) -> float:
    """How good several objectives are together; lower is better.

    Below 1: every objective is better than that of the reference, and 1 - trade is the geometric mean of the gains as
    shares of it. Above 1: the worst ratio to the reference. It grows with each objective, so that the best trial is on
    the front.
    """
    smallest = CRITERIA.smallest_objective
    ratios = [value / max(against, smallest) for value, against in zip(objectives, reference, strict=True)]
    if max(ratios) < 1.0:
        return 1.0 - math.prod(1.0 - ratio for ratio in ratios) ** (1.0 / len(ratios))
    return max(ratios) + CRITERIA.tie_share * sum(ratios)


def with_trades(trials: Sequence[Trial], baselines: Mapping[str, Baseline]) -> list[Trial]:
    """The trials with their trades; unchanged before a baseline is scored. Failed attempts have no objectives."""
    if not baselines:
        return list(trials)
    reference = find_reference(baselines)
    return [
        trial._replace(trade=measure_trade(trial.objectives, reference)) if trial.objectives else trial
        for trial in trials
    ]
