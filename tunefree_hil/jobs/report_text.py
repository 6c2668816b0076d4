"""Results as sentences and tables for people, from grades as plain data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from tunefree_hil.grade.score import FINISHED

PEAK_THRESHOLD_M = 0.5  # lateral_err_peak is a share of it (apollo_facts 6.1)

Drives = Mapping[str, Mapping[str, Any]]  # scenario -> grade as plain data


def lateral_peak_m(drives: Drives) -> float | None:
    """Largest |lateral error| of the metrics over all drives that have one."""
    peaks = [drive["metrics"].get("lateral_err_peak") for drive in drives.values()]
    known = [peak for peak in peaks if peak is not None]
    return PEAK_THRESHOLD_M * max(known) if known else None


def replans(drives: Drives) -> int:
    """Re-plans over all drives."""
    return sum(int(drive["replans"]) for drive in drives.values())


def early(outcome: str) -> str:
    """How a drive ended that did not come to its end; '' for one that did."""
    return "" if outcome == FINISHED else outcome


def failures(drives: Drives) -> list[str]:
    """Scenarios not driven to their end."""
    return [name for name, drive in drives.items() if drive["outcome"] != FINISHED]


def comparison(manual_name: str, manual: Drives, tuned: Drives, scores: tuple[float, float]) -> str:
    """'score 0.21 -> 0.18 (-14 %) against mrac_on; lateral peak 0.21 -> 0.09 m; 6 of 7 scenarios better'.

    Where either re-plans or does not come to the end it is said of both: to be better than what falls is little.
    """
    before, after = scores
    change = 100.0 * (after / before - 1.0) if before > 0.0 else 0.0
    parts = [f"score {before:.3f} -> {after:.3f} ({change:+.0f} %) against {manual_name}"]
    if replans(manual) or replans(tuned):
        parts.append(f"re-plans {replans(manual)} -> {replans(tuned)}")
    peaks = lateral_peak_m(manual), lateral_peak_m(tuned)
    if peaks[0] is not None and peaks[1] is not None:
        parts.append(f"lateral peak {peaks[0]:.2f} -> {peaks[1]:.2f} m")
    better = [name for name in tuned if tuned[name]["score"] < manual[name]["score"]]
    parts.append(f"{len(better)} of {len(tuned)} scenarios better" + _most(manual, tuned, better))
    if failures(tuned):
        parts.append(f"NOT driven to the end: {', '.join(failures(tuned))}")
    if failures(manual):
        also = f"{manual_name} neither" if failures(tuned) else f"{manual_name} NOT driven to the end"
        parts.append(f"{also}: {', '.join(failures(manual))}")
    return "; ".join(parts)


def _most(manual: Drives, tuned: Drives, better: list[str]) -> str:
    if not better:
        return ""
    most = min(better, key=lambda name: tuned[name]["score"] / manual[name]["score"])
    return f", {most} most"


def table(rows: Mapping[str, Drives], scores: Mapping[str, float]) -> list[str]:
    """One line a candidate, best first: score, lateral peak, re-plans, failures."""
    width = max(len(name) for name in rows)
    lines = [f"{'':{width}}  score  lateral peak  re-plans  failed"]
    for name in sorted(rows, key=lambda one: scores[one]):
        peak = lateral_peak_m(rows[name])
        lateral = f"{peak:10.2f} m" if peak is not None else "           -"
        failed = ", ".join(failures(rows[name])) or "-"
        lines.append(f"{name:{width}}  {scores[name]:5.3f}  {lateral}  {replans(rows[name]):8d}  {failed}")
    return lines


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table on a Markdown page, and an empty one; nothing where there are no rows."""
    lines = ["| " + " | ".join(row) + " |" for row in [head, *rows]]
    return [lines[0], "|" + "---|" * len(head), *lines[1:], ""] if lines[1:] else []
