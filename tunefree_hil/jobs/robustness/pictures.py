"""The figures of a road sweep from its result."""

from __future__ import annotations

from pathlib import Path

from tunefree_hil.figures.robustness import (
    LOST,
    MISSED,
    PASSED,
    UNDRIVABLE,
    RoadPoint,
    ShareBar,
    draw_failure_map,
    draw_failure_shares,
)
from tunefree_hil.figures.style import save
from tunefree_hil.jobs.robustness.judgement import DriveState
from tunefree_hil.jobs.robustness.physical_limits import peak_demand
from tunefree_hil.jobs.robustness.plan import SweepPlan
from tunefree_hil.jobs.robustness.result import SweepResult, family_shares
from tunefree_hil.jobs.robustness.text import share_text
from tunefree_hil.tune.failure_share import FailureShare

MAP, SHARES = "failure_map.png", "failure_shares.png"
STATE_NAMES = {
    DriveState.PASSED: PASSED,
    DriveState.REQUIREMENT_MISSED: MISSED,
    DriveState.STABILITY_LOST: LOST,
}


def draw_sweep(plan: SweepPlan, result: SweepResult, folder: Path) -> list[str]:
    """Draw where the winner and the best manual set fail, and on which families. Returns the files."""
    title = f"The tuned gains fail on {share_text(result.winner.roads)}"
    labels = {plan.names[0]: plan.names[0]}
    if result.best_manual:
        labels[result.best_manual] = f"manual ({result.best_manual})"
    points = [_road_point(plan, result, road, labels) for road in range(len(plan.roads))]
    files = [str(save(draw_failure_map(points, title), folder / MAP))]
    shares = {label: family_shares(plan, result.sets[name].states) for name, label in labels.items()}
    families = {
        family: {label: _bar(by_family[family]) for label, by_family in shares.items()}
        for family in next(iter(shares.values()))
    }
    if families:
        sets = {labels.get(name, name): _bar(one.roads) for name, one in result.sets.items()}
        files.append(str(save(draw_failure_shares(families, sets, title), folder / SHARES)))
    return files


def _road_point(plan: SweepPlan, result: SweepResult, road: int, labels: dict[str, str]) -> RoadPoint:
    spec = plan.roads[road].spec
    states = {}
    for name, label in labels.items():
        reached = result.sets[name].states.get(road)
        states[label] = UNDRIVABLE if reached is None else STATE_NAMES[reached]
    return RoadPoint(*peak_demand(spec), states)


def _bar(share: FailureShare) -> ShareBar:
    return ShareBar(*share)
