"""Text of a verdict: which requirement binds, by how much, where, and what oscillates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.grade.oscillation.report import OscillationFinding, finding_from_data, oscillation_text
from tunefree_hil.grade.requirements.judgement import not_judged_text, result_text, violation_text
from tunefree_hil.grade.requirements.verdict import DecidedGains, GainsVerdict
from tunefree_hil.jobs.report_text import GradesByScenario


class RoadOscillation(NamedTuple):
    """The worst oscillation beyond its limit over some roads."""

    road: str
    finding: OscillationFinding


def find_worst_oscillation(drives: GradesByScenario) -> RoadOscillation | None:
    """The worst oscillation of a set of gains, from grades as plain data; None where nothing oscillates."""
    swings = [
        RoadOscillation(road, finding_from_data(drive["oscillation"]))
        for road, drive in drives.items()
        if drive.get("oscillation")
    ]
    return max(swings, key=lambda one: one.finding.ratio, default=None)


def road_oscillation_text(drives: GradesByScenario) -> str:
    """'OSCILLATES on u_turn: steering wheel swings 58 deg at 1.7 Hz ...'; '' where nothing oscillates."""
    worst = find_worst_oscillation(drives)
    return "" if worst is None else f"OSCILLATES on {worst.road}: {oscillation_text(worst.finding)}"


def verdict_reason(decided: DecidedGains) -> str:
    """Why the verdict is what it is, without its word."""
    roads = not_judged_text(decided.tuned.judgement)
    if decided.verdict is GainsVerdict.REJECTED:
        parts = [violation_text(decided.tuned.judgement), manual_text(decided)]
    elif decided.verdict is GainsVerdict.NO_GAIN:
        ratio = decided.tuned.score / decided.best_manual.score if decided.best_manual.score > 0.0 else 1.0
        parts = [f"{decided.manual} meets the requirements and is as good (score ratio {ratio:.2f})"]
    else:
        met = len(decided.tuned.judgement.results)
        parts = [f"all {met} judged requirements are met" if met else "no requirement could be judged"]
        parts += [] if decided.best_manual.judgement.is_met else [manual_text(decided)]
    return "; ".join(part for part in [*parts, roads] if part)


def manual_text(decided: DecidedGains) -> str:
    """Which manual set meets the requirements, or by how much the best one does not."""
    best = decided.best_manual.judgement
    if best.is_met:
        return f"the manual set {decided.manual} meets the requirements"
    return f"no manual set meets the requirements, the nearest is {decided.manual}: {_binding_text(decided)}"


def _binding_text(decided: DecidedGains) -> str:
    judgement = decided.best_manual.judgement
    if judgement.failed or judgement.binding is None:
        return violation_text(judgement)
    return f"{violation_text(judgement)}, by {100.0 * judgement.violation:.0f} %"


def infeasible_text(decided: DecidedGains, trials: int) -> str:
    """What binds where neither a trial nor a manual set meets the requirements; '' where one does.

    Args:
        decided: Its tuned gains are those of the smallest violation.
        trials: Number of trials.
    """
    if decided.tuned.judgement.is_met or decided.best_manual.judgement.is_met:
        return ""
    binding = decided.tuned.judgement.binding
    limit = violation_text(decided.tuned.judgement) if binding is None else result_text(binding)
    share = "" if binding is None else f", by {100.0 * (binding.ratio - 1.0):.0f} % on {binding.road}"
    return f"none of {trials} trials and no manual set meets the requirements; of the best trial {limit} binds{share}"


def requirement_table(judged: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Lines: limit, and for each candidate its worst value; the road of the first candidate. '!' marks a violation.

    Args:
        judged: `RequirementJudgement.as_data` by candidate, the winner first.
    """
    first = next(iter(judged))
    names = [name for name in judged[first]["requirements"]]
    if not names:
        return []
    width = max(len(name) for name in names)
    columns = {label: max(len(label), 8) for label in judged}
    head = "  ".join(f"{label:>{size}}" for label, size in columns.items())
    lines = [f"Requirements, worst values ('!': violated)\n{'':{width}}  {'limit':>7}  {head}  road of {first}"]
    for name in names:
        values = {label: data["requirements"].get(name) for label, data in judged.items()}
        cells = "  ".join(f"{_cell(values[label]):>{size}}" for label, size in columns.items())
        row = judged[first]["requirements"][name]
        lines.append(f"{name:{width}}  {row['limit']:7.3g}  {cells}  {row['road']}")
    return [line for text in lines for line in text.split("\n")]


def _cell(row: Mapping[str, Any] | None) -> str:
    if row is None:
        return "-"
    return f"{row['value']:.3g}{'' if row['met'] else '!'}"
