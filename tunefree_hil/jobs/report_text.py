"""Texts and tables of results, from grades as plain data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from tunefree_hil.grade.score import FINISHED

PEAK_THRESHOLD_M = 0.5  # divisor of lateral_err_peak (grade/metrics.py)

GradesByScenario = Mapping[str, Mapping[str, Any]]  # scenario -> grade as plain data


def lateral_peak_m(drives: GradesByScenario) -> float | None:
    """Largest |lateral error| over all drives; None where not available."""
    peaks = [drive["metrics"].get("lateral_err_peak") for drive in drives.values()]
    known = [peak for peak in peaks if peak is not None]
    return PEAK_THRESHOLD_M * max(known) if known else None


def total_replans(drives: GradesByScenario) -> int:
    """Number of re-plans over all drives."""
    return sum(int(drive["replans"]) for drive in drives.values())


def failed_scenarios(drives: GradesByScenario) -> list[str]:
    """Scenarios that were not driven to their end."""
    return [name for name, drive in drives.items() if drive["outcome"] != FINISHED]


def comparison_text(
    manual_name: str, manual: GradesByScenario, tuned: GradesByScenario, scores: tuple[float, float]
) -> str:
    """Text such as 'score 0.21 -> 0.18 (-14 %) against mrac_on; lateral peak 0.21 -> 0.09 m; 6 of 7 scenarios better'.

    Re-plans and failures are given for both, as an improvement over a failing controller means little.
    """
    before, after = scores
    change = 100.0 * (after / before - 1.0) if before > 0.0 else 0.0
    parts = [f"score {before:.3f} -> {after:.3f} ({change:+.0f} %) against {manual_name}"]
    if total_replans(manual) or total_replans(tuned):
        parts.append(f"re-plans {total_replans(manual)} -> {total_replans(tuned)}")
    peaks = lateral_peak_m(manual), lateral_peak_m(tuned)
    if peaks[0] is not None and peaks[1] is not None:
        parts.append(f"lateral peak {peaks[0]:.2f} -> {peaks[1]:.2f} m")
    better = [name for name in tuned if tuned[name]["score"] < manual[name]["score"]]
    parts.append(f"{len(better)} of {len(tuned)} scenarios better" + _most_improved(manual, tuned, better))
    if failed_scenarios(tuned):
        parts.append(f"NOT driven to the end: {', '.join(failed_scenarios(tuned))}")
    if failed_scenarios(manual):
        also = f"{manual_name} neither" if failed_scenarios(tuned) else f"{manual_name} NOT driven to the end"
        parts.append(f"{also}: {', '.join(failed_scenarios(manual))}")
    return "; ".join(parts)


def _most_improved(manual: GradesByScenario, tuned: GradesByScenario, better: list[str]) -> str:
    if not better:
        return ""
    most = min(better, key=lambda name: tuned[name]["score"] / manual[name]["score"])
    return f", {most} most"


def candidate_table(rows: Mapping[str, GradesByScenario], scores: Mapping[str, float]) -> list[str]:
    """Table with one line a candidate, best first: score, lateral peak, re-plans, failures."""
    width = max(len(name) for name in rows)
    lines = [f"{'':{width}}  score  lateral peak  re-plans  failed"]
    for name in sorted(rows, key=lambda one: scores[one]):
        peak = lateral_peak_m(rows[name])
        lateral = f"{peak:10.2f} m" if peak is not None else "           -"
        failed = ", ".join(failed_scenarios(rows[name])) or "-"
        lines.append(f"{name:{width}}  {scores[name]:5.3f}  {lateral}  {total_replans(rows[name]):8d}  {failed}")
    return lines


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table and an empty line; nothing without rows."""
    lines = ["| " + " | ".join(row) + " |" for row in [head, *rows]]
    return [lines[0], "|" + "---|" * len(head), *lines[1:], ""] if lines[1:] else []
