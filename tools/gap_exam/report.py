"""The table as Markdown and JSON, and as pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tools.gap_exam.catalogue import kind_of
from tools.gap_exam.files import write, write_json
from tools.gap_exam.outcomes import OUTCOMES
from tools.gap_exam.score import Limit, Row
from tools.gap_exam.statistics import Figure

COLOURS = {"right": "#2a7f62", "in_set": "#9ccc9c", "partial": "#f2c45a", "silent": "#b8bcc4", "wrong": "#c0392b",
           "cannot_test": "#7f8fa6", "failed": "#2f3640"}  # fmt: skip
SHARES = {"right", "right_or_in_set", "wrong", "silent", "at_least_one", "covered", "right_link", "forced_right",
          "forced_wrong", "none_of_these", "value_error_median", "value_error_90th", "gap_closed_median",
          "gap_closed_10th", "replay_down", "replay_worst"}  # fmt: skip


def said(name: str, figure: Figure) -> str:
    """A figure with its interval: '91.2 % (86.0 to 94.6, n = 240)'."""
    scale, unit = (100.0, " %") if name in SHARES else (1.0, " s" if name == "seconds" else "")
    value, low, high = (math.nan if one is None else scale * one for one in figure[:3])
    return f"{value:.3g}{unit} ({low:.3g} to {high:.3g}, n = {figure.n})"


def markdown(rows: Sequence[Row], limits: Sequence[Limit], title: str) -> str:
    """The page: outcomes (they sum to 100 %), figures, limits."""
    lines = [
        f"# {title}",
        "",
        f"| | n | {' | '.join(name.replace('_', ' ') for name in OUTCOMES)} |",
        "|---" * (2 + len(OUTCOMES)) + "|",
    ]
    for row in rows:
        shares = " | ".join(f"{100.0 * row.outcomes[name] / row.n:.1f} %" for name in OUTCOMES)
        lines.append(f"| {row.name} | {row.n} | {shares} |")
    lines += ["", "| row | figure | value (95 % interval) |", "|---|---|---|"]
    for row in rows:
        lines += [f"| {row.name} | {name.replace('_', ' ')} | {said(name, one)} |" for name, one in row.figures.items()]
    if limits:
        lines += ["", "| effect | named in 90 % of logs from | logs |", "|---|---|---|"]
        lines += [f"| {one.name} | {limit_words(one)} | {one.n} |" for one in limits]
    return "\n".join(lines) + "\n"


def limit_words(one: Limit) -> str:
    """The smallest value that is named, in its unit; gains as departure from 1."""
    if one.value is None:
        return "never"
    return f"{'1 ± ' if kind_of(one.name).way in ('factor', 'less') else ''}{one.value:.3g} {one.unit}"


def as_json(
    rows: Sequence[Row], limits: Sequence[Limit], wrong: Sequence[dict[str, Any]], domain: str
) -> dict[str, Any]:
    """All of it, for programs."""
    return {
        "schema": "gap-exam-table/1",
        "domain": domain,
        "rows": [
            {
                "name": row.name,
                "n": row.n,
                "outcomes": row.outcomes,
                "figures": {k: v._asdict() for k, v in row.figures.items()},
            }
            for row in rows
        ],
        "limits": [one._asdict() for one in limits],
        "wrong": list(wrong),
    }


def write_report(
    folder: Path, rows: Sequence[Row], limits: Sequence[Limit], wrong: Sequence[dict[str, Any]], domain: str
) -> list[Path]:
    """table.md, table.json, outcomes.png and, where limits were asked for, limits.png; what was written."""
    paths = [folder / "table.md", folder / "table.json"]
    write(paths[0], markdown(rows, limits, f"Exam of {domain}"))
    write_json(paths[1], as_json(rows, limits, wrong, domain))
    if rows:
        paths.append(folder / "outcomes.png")
        draw_outcomes(paths[-1], rows)
    if limits:
        paths.append(folder / "limits.png")
        draw_limits(paths[-1], limits)
    return paths


def draw_outcomes(path: Path, rows: Sequence[Row]) -> None:
    """A bar a row, its outcomes in shares."""
    plt = _plotter()
    figure, axes = plt.subplots(figsize=(9.5, 0.34 * len(rows) + 1.3), layout="constrained")
    left = [0.0] * len(rows)
    for name in OUTCOMES:
        shares = [100.0 * row.outcomes[name] / row.n for row in rows]
        if any(shares):
            axes.barh(
                range(len(rows)), shares, left=left, color=COLOURS[name], label=name.replace("_", " "), height=0.72
            )
        left = [a + b for a, b in zip(left, shares, strict=True)]
    axes.set_yticks(range(len(rows)), [f"{row.name} (n = {row.n})" for row in rows])
    axes.invert_yaxis()
    axes.set_xlim(0.0, 100.0)
    axes.set_xlabel("share of logs [%]")
    axes.legend(ncols=len(OUTCOMES), loc="lower center", bbox_to_anchor=(0.35, 1.0), frameon=False, fontsize="small")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def draw_limits(path: Path, limits: Sequence[Limit]) -> None:
    """For every effect its sizes, filled where its logs were named; the smallest that is named in 90 % is ringed."""
    plt = _plotter()
    figure, axes = plt.subplots(figsize=(9.5, 0.25 * len(limits) + 1.4), layout="constrained")
    for place, one in enumerate(limits):
        for step, (value, named, logs) in enumerate(one.by_value):
            ring = one.value is not None and value == one.value
            axes.scatter(
                step,
                place,
                s=70,
                color=plt.cm.Greens(0.15 + 0.75 * named / logs),
                edgecolors="black" if ring else "none",
            )
            axes.annotate(f"{value:.3g}", (step, place), (7, 0), textcoords="offset points", va="center", fontsize=6.5)
    axes.set_yticks(range(len(limits)), [f"{one.name} [{one.unit}]" for one in limits], fontsize=8)
    axes.invert_yaxis()
    axes.set_xticks([])
    axes.set_xlabel("from just noticeable to gross; darker: more of the logs named; ringed: named in 90 % from here on")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _plotter() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt
