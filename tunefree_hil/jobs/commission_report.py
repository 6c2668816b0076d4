"""One page about a commission: what each stage came to, how long it took, pictures."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tunefree_hil.jobs.commission_plan import Plan
from tunefree_hil.jobs.run_folder import write_text

REPORT = "report.md"
TITLES = {
    "collect": "Collection",
    "calibrate": "Calibration",
    "learn": "Learned plant",
    "map": "Open-loop map",
    "tune": "Search on the learned plant",
    "verify": "On the vehicle, roads that no search saw",
}


def write_report(plan: Plan, record: Mapping[str, Any]) -> Path:
    """Write report.md in the commission's folder; pictures are linked where the stages left them."""
    done = record["stages"]
    path = plan.folder / REPORT
    lines = [f"# {plan.vehicle.name}: from logs to verified gains", ""]
    lines += [f"{done['verify']['result']['sentence']}.", ""]
    lines += _times(done)
    for name, title in TITLES.items():
        lines += _section(plan.folder, title, done[name])
    lines += ["## Reproduce", "", "```", f"tunefree-hil commission {plan.words}", "```", ""]
    write_text(path, "\n".join(lines))
    return path


def _times(done: Mapping[str, Any]) -> list[str]:
    whole = sum(one["seconds"] for one in done.values())
    rows = [f"| {TITLES[name]} | {one['seconds'] / 60.0:.1f} |" for name, one in done.items()]
    return ["| stage | wall time, min |", "|---|---|", *rows, f"| all | {whole / 60.0:.1f} |", ""]


def _section(folder: Path, title: str, stage: Mapping[str, Any]) -> list[str]:
    result = stage["result"]
    lines = [f"## {title}", "", f"{result.get('sentence', '')}.", ""]
    if result.get("scores"):
        lines += ["| gains | score |", "|---|---|"]
        ranked = sorted(result["scores"].items(), key=lambda one: one[1])
        lines += [f"| {name} | {score:.3f} |" for name, score in ranked] + [""]
    return lines + [f"![{path.stem}]({_from(folder, path)})\n" for path in _pictures(result.get("figures", []))]


def _pictures(figures: Any) -> Iterable[Path]:
    found = figures.values() if isinstance(figures, Mapping) else figures
    for one in found:
        if isinstance(one, str) and Path(one).suffix == ".png" and Path(one).is_file():
            yield Path(one)


def _from(folder: Path, path: Path) -> str:
    return Path(os.path.relpath(path, folder)).as_posix()
