"""The page about a commission: outcome, results and wall time of each stage, limits, pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tunefree_hil.jobs.commission import gates
from tunefree_hil.jobs.commission.next_gap_command import find_shortfall, make_gap_command, times_text
from tunefree_hil.jobs.commission.plan import NAMES, CommissionPlan
from tunefree_hil.jobs.commission.record import CommissionRecord
from tunefree_hil.jobs.report_text import markdown_table
from tunefree_hil.jobs.run_folder import write_text
from tunefree_hil.jobs.tune.robustness import robustness_rows

REPORT = "report.md"
TITLES = {
    "collect": "Collection",
    "calibrate": "Calibration",
    "learn": "Learned plant",
    "map": "Open-loop map",
    "tune": "Search on the learned plant",
    "verify": "On the vehicle, in unseen scenarios",
}
HORIZONS = ("1", "3", "10", "30")  # s of free run


def write_report(plan: CommissionPlan, record: CommissionRecord) -> Path:
    """Write report.md in the folder of the commission, about the stages done so far; pictures are linked."""
    path, done = plan.folder / REPORT, record.done
    lines = [f"# {plan.vehicle.name}: from logs to verified gains", "", _outcome(record), ""]
    lines += _gap_section(plan, done)
    lines += _times(record) + _limits(plan, record)
    for name in done:
        lines += _section(plan.folder, name, done[name]["result"], record.warnings(name))
    lines += ["## Reproduce", "", "```", plan.command, "```", ""]
    write_text(path, "\n".join(lines))
    return path


def _outcome(record: CommissionRecord) -> str:
    stopped, done = record.data.get("stopped"), record.done
    if stopped:
        return f"**Stopped after {stopped['stage']}: {stopped['reason']}.**"
    if "verify" not in done:
        return f"Not finished: {', '.join(name for name in NAMES if name not in done)} to come."
    result = done["verify"]["result"]
    return f"{_verdict(result)}: {result['sentence']}."


def _verdict(result: Mapping[str, Any]) -> str:
    """The verdict of verify: whether the winner beats every manual vector and finishes every scenario."""
    if not result.get("holds"):
        return "**The gains fail the verification on the vehicle**"
    replans = int(result.get("replans") or 0)
    if not replans:
        return "The gains pass the verification on the vehicle"
    times = times_text(replans)
    return f"**On the vehicle the gains are better than every manual vector, but re-plan {times}**"


def _gap_section(plan: CommissionPlan, done: Mapping[str, Any]) -> list[str]:
    """The `gap` command where the vehicle differs from the learned plant."""
    shortfall = find_shortfall(done)
    command = make_gap_command(plan) if shortfall else ""
    if not shortfall or not command:
        return []
    text = f"{shortfall.text[0].upper()}{shortfall.text[1:]}. This command finds what the learned plant lacks:"
    return [text, "", "```", command, "```", ""]


def _times(record: CommissionRecord) -> list[str]:
    rows, total_s = [], 0.0
    for name in NAMES:
        if record.is_begun(name):
            total_s += record.seconds(name)
            state = "done" if record.result(name) is not None else "begun"
            rows.append((TITLES[name], f"{record.seconds(name) / 60.0:.1f}", str(record.sessions(name)), state))
    total = ("all", f"{total_s / 60.0:.1f}", "", "")
    return markdown_table(("stage", "wall time, min", "sessions", ""), [*rows, total])


def _limits(plan: CommissionPlan, record: CommissionRecord) -> list[str]:
    rows = gates.list_limits(plan, record.done_or_stopped)
    return markdown_table(("quantity", "limit", "reached"), rows) if rows else []


def _section(folder: Path, name: str, result: Mapping[str, Any], warnings: Sequence[str]) -> list[str]:
    lines = [f"## {TITLES[name]}", "", f"{result.get('sentence', '')}.", ""]
    if warnings:
        lines += [*(f"- {warning}" for warning in warnings), ""]
    if result.get("scores"):
        scores = sorted(result["scores"].items(), key=lambda item: item[1])
        lines += markdown_table(("gains", "score"), [(key, f"{score:.3f}") for key, score in scores])
    if result.get("best"):
        gains = result["best"]["parameters"].items()
        lines += markdown_table(("gain", "value"), [(key, f"{value:.4g}") for key, value in gains])
    if result.get("held"):
        lines += markdown_table(("gains", "score", "in a slower car", ""), robustness_rows(result["held"]))
    if result.get("free_run"):
        lines += _free_run(result["free_run"])
    pictures = [Path(figure) for figure in result.get("figures", []) if (folder / figure).is_file()]
    return lines + [f"![{path.stem}]({path.as_posix()})\n" for path in pictures]


def _free_run(kinds: Mapping[str, Any]) -> list[str]:
    """Position errors by kind, ground and horizon: mean, and 95th percentile of the starts."""
    rows = []
    for kind, grounds in kinds.items():
        for ground in ("level", "hills"):
            row = grounds.get(ground)
            if row:
                cells = [_error_text(row.get(horizon)) for horizon in HORIZONS]
                rows.append((kind, ground, str(row["starts"]), *cells))
    return markdown_table(("plant", "ground", "starts", *(f"{horizon} s: m (95 %)" for horizon in HORIZONS)), rows)


def _error_text(row: Mapping[str, Any] | None) -> str:
    position = (row or {}).get("position_m") or {}
    return "" if position.get("mean") is None else f"{position['mean']:.2f} ({position['p95']:.2f})"
