"""One page about a commission: what came out, what each stage came to and how long it took, limits, pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tunefree_hil.jobs.commission import gates
from tunefree_hil.jobs.commission.next_gap_command import disappointed, gap_command
from tunefree_hil.jobs.commission.plan import NAMES, Plan
from tunefree_hil.jobs.commission.record import Record
from tunefree_hil.jobs.report_text import markdown_table
from tunefree_hil.jobs.run_folder import write_text
from tunefree_hil.jobs.tune.robustness import held_rows

REPORT = "report.md"
TITLES = {
    "collect": "Collection",
    "calibrate": "Calibration",
    "learn": "Learned plant",
    "map": "Open-loop map",
    "tune": "Search on the learned plant",
    "verify": "On the vehicle, roads that no search saw",
}
HORIZONS = ("1", "3", "10", "30")  # s of free run


def write_report(plan: Plan, record: Record) -> Path:
    """Write report.md in the commission's folder, of what is done so far; pictures are linked where they lie."""
    path, done = plan.folder / REPORT, record.done
    lines = [f"# {plan.vehicle.name}: from logs to verified gains", "", _outcome(record), ""]
    lines += _lacks(plan, done)
    lines += _times(record) + _limits(plan, record)
    for name in done:
        lines += _section(plan.folder, name, done[name]["result"], record.warnings(name))
    lines += ["## Reproduce", "", "```", plan.command, "```", ""]
    write_text(path, "\n".join(lines))
    return path


def _outcome(record: Record) -> str:
    stopped, done = record.data.get("stopped"), record.done
    if stopped:
        return f"**Stopped after {stopped['stage']}: {stopped['reason']}.**"
    if "verify" not in done:
        return f"Not finished: {', '.join(name for name in NAMES if name not in done)} to come."
    result = done["verify"]["result"]
    return f"{_verdict(result)}: {result['sentence']}."


def _verdict(result: Mapping[str, Any]) -> str:
    """`holds` of verify: better than every manual set, and to the end of every road: no word of how good that is."""
    if not result.get("holds"):
        return "**The gains do not hold on the vehicle**"
    again = int(result.get("replans") or 0)
    if not again:
        return "The gains hold on the vehicle"
    times = "once" if again == 1 else f"{again} times"
    return f"**On the vehicle the gains are better than every manual set, but re-plan {times}**"


def _lacks(plan: Plan, done: Mapping[str, Any]) -> list[str]:
    """What to paste where the plant was not like the vehicle."""
    why = disappointed(done)
    command = gap_command(plan) if why else ""
    if not command:
        return []
    told = f"{why[0].upper()}{why[1:]}. This names what the learned plant lacks, and drives what tells it apart:"
    return [told, "", "```", command, "```", ""]


def _times(record: Record) -> list[str]:
    rows, whole_s = [], 0.0
    for name in NAMES:
        if record.begun(name):
            whole_s += record.seconds(name)
            how = "done" if record.result(name) is not None else "begun"
            rows.append((TITLES[name], f"{record.seconds(name) / 60.0:.1f}", str(record.sessions(name)), how))
    return markdown_table(
        ("stage", "wall time, min", "sessions", ""), [*rows, ("all", f"{whole_s / 60.0:.1f}", "", "")]
    )


def _limits(plan: Plan, record: Record) -> list[str]:
    rows = gates.rows(plan, record.shown)
    return markdown_table(("what", "limit", "reached"), rows) if rows else []


def _section(folder: Path, name: str, result: Mapping[str, Any], warnings: Sequence[str]) -> list[str]:
    lines = [f"## {TITLES[name]}", "", f"{result.get('sentence', '')}.", ""]
    if warnings:
        lines += [*(f"- {one}" for one in warnings), ""]
    if result.get("scores"):
        ranked = sorted(result["scores"].items(), key=lambda one: one[1])
        lines += markdown_table(("gains", "score"), [(key, f"{score:.3f}") for key, score in ranked])
    if result.get("best"):
        found = result["best"]["parameters"].items()
        lines += markdown_table(("gain", "found"), [(key, f"{value:.4g}") for key, value in found])
    if result.get("held"):
        lines += markdown_table(("gains", "score", "in a slower car", ""), held_rows(result["held"]))
    if result.get("free_run"):
        lines += _free_run(result["free_run"])
    pictures = [Path(one) for one in result.get("figures", []) if (folder / one).is_file()]
    return lines + [f"![{path.stem}]({path.as_posix()})\n" for path in pictures]


def _free_run(kinds: Mapping[str, Any]) -> list[str]:
    """Position errors by kind, ground and horizon: mean, and 95 % of the starts."""
    rows = []
    for kind, grounds in kinds.items():
        for ground in ("level", "hills"):
            row = grounds.get(ground)
            if row:
                cells = [_error(row.get(one)) for one in HORIZONS]
                rows.append((kind, ground, str(row["starts"]), *cells))
    return markdown_table(("plant", "ground", "starts", *(f"{one} s: m (95 %)" for one in HORIZONS)), rows)


def _error(found: Mapping[str, Any] | None) -> str:
    place = (found or {}).get("position_m") or {}
    return "" if place.get("mean") is None else f"{place['mean']:.2f} ({place['p95']:.2f})"
