"""The table as Markdown and JSON, and as pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tools.gap_exam.catalogue import kind_of
from tools.gap_exam.files import write, write_json
from tools.gap_exam.limits import Limit
from tools.gap_exam.outcomes import OUTCOMES
from tools.gap_exam.score import Row
from tools.gap_exam.statistics import Figure

COLOURS = {"right": "#2a7f62", "in_set": "#9ccc9c", "partial": "#f2c45a", "silent": "#b8bcc4", "wrong": "#c0392b",
           "cannot_test": "#7f8fa6", "failed": "#2f3640"}  # fmt: skip
SHARES = {"right", "right_or_in_set", "wrong", "silent", "at_least_one", "covered", "right_link", "forced_right",
          "forced_wrong", "none_of_these", "absorbed", "value_error_median", "value_error_90th", "gap_closed_median",
          "gap_closed_10th", "replay_down", "replay_worst", "name_same", "net_same", "name_other", "net_other",
          "name_over_net_same", "name_beats_net_other"}  # fmt: skip


def said(name: str, figure: Figure) -> str:
    """A figure with its interval: '91.2 % (86.0 to 94.6, n = 240)'."""
    scale, unit = (100.0, " %") if name in SHARES else (1.0, " s" if name == "seconds" else "")
    value, low, high = (math.nan if one is None else scale * one for one in figure[:3])
    return f"{value:.3g}{unit} ({low:.3g} to {high:.3g}, n = {figure.n})"


def markdown(rows: Sequence[Row], limits: Sequence[Limit], title: str, done: Sequence[str] = ()) -> str:
    """The page: how much of it is done, outcomes (they sum to 100 %), figures, limits."""
    lines = [
        f"# {title}",
        "",
        *(f"{words}." for words in done),
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
        lines += ["", "| effect | named in 90 % of logs from | by excited drives alone | logs |", "|---|---|---|---|"]
        lines += [f"| {one.name} | {limit_words(one)} | {excited_words(one)} | {one.n} |" for one in limits]
    return "\n".join(lines) + "\n"


def limit_words(one: Limit) -> str:
    """The smallest value that is named, with its interval and unit; gains as departure from 1."""
    if one.value is None:
        return "never"
    ends = [f"{edge:.3g}" for edge in (one.low, one.high) if edge is not None]
    spread = f" ({' to '.join(ends)})" if len(ends) == 2 else ""
    return f"{'1 ± ' if kind_of(one.name).way in ('factor', 'less') else ''}{one.value:.3g}{spread} {one.unit}"


def excited_words(one: Limit) -> str:
    """The same by the drives that excite."""
    return "never" if one.excited is None else limit_words(one._replace(value=one.excited, low=None, high=None))


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
    folder: Path,
    rows: Sequence[Row],
    limits: Sequence[Limit],
    wrong: Sequence[dict[str, Any]],
    domain: str,
    done: Sequence[str] = (),
) -> list[Path]:
    """table.md, table.json, outcomes.png and, where limits were asked for, limits.png; what was written."""
    paths = [folder / "table.md", folder / "table.json"]
    write(paths[0], markdown(rows, limits, f"Exam of {domain}", done))
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
    """For every effect the sizes that were asked, darker the more were named, and where 90 % are, with its interval."""
    plt = _plotter()
    figure, axes = plt.subplots(figsize=(9.5, 0.25 * len(limits) + 1.4), layout="constrained")
    for place, one in enumerate(limits):
        for size, _, named, logs in one.steps:
            shade = plt.cm.Greens(0.15 + 0.75 * named / logs)
            axes.scatter(size, place, s=60, color=shade, edgecolors="#888888", linewidths=0.5)
        middle, low, high = (min(max(edge, -0.05), 1.05) for edge in one.at)
        axes.plot([low, high], [place, place], color="black", linewidth=0.8, zorder=0)
        if one.value is not None:
            axes.plot([middle, middle], [place - 0.35, place + 0.35], color="black", linewidth=2.0)
        axes.annotate(limit_words(one), (1.07, place), va="center", fontsize=7, annotation_clip=False)
    axes.set_yticks(range(len(limits)), [one.name for one in limits], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(-0.06, 1.45)
    axes.set_xticks([0.0, 0.5, 1.0], ["just noticeable", "", "gross"])
    axes.set_xlabel("size; darker: more of the logs named; bar: named in 90 % from here on, with its 95 % interval")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _plotter() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt
