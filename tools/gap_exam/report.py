"""The table as Markdown and JSON; with its pictures (pictures.py) all that is written of an exam."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tools.gap_exam.files import write, write_json
from tools.gap_exam.limits import Limit
from tools.gap_exam.outcomes import OUTCOMES
from tools.gap_exam.pictures import DOWN, draw_limits, draw_outcomes, heading
from tools.gap_exam.score import Row
from tools.gap_exam.words import excited_words, label, limit_words, said

__all__ = ["as_json", "limit_words", "markdown", "write_report"]
WHOLE = "*"  # at a row whose intervals draw whole models


def markdown(rows: Sequence[Row], limits: Sequence[Limit], title: str, done: Sequence[str] = ()) -> str:
    """The page: how much of it is done, outcomes (they sum to 100 %), figures, limits."""
    lines = [
        f"# {title}",
        "",
        *(f"{words}." for words in done),
        "",
        f"| | n | models | {' | '.join(name.replace('_', ' ') for name in OUTCOMES)} |",
        "|---" * (3 + len(OUTCOMES)) + "|",
    ]
    for row in rows:
        parts = shares({name: row.outcomes[name] for name in OUTCOMES})
        of = " | ".join(f"{parts[name]:.1f} %" for name in OUTCOMES)
        lines.append(f"| {row.name} | {row.n} | {row.models}{WHOLE if row.whole else ''} | {of} |")
    if any(row.whole for row in rows):
        lines += ["", f"{WHOLE} logs share models: intervals draw whole models."]
    lines += ["", "| row | figure | value (95 % interval) |", "|---|---|---|"]
    for row in rows:
        lines += [f"| {row.name} | {name.replace('_', ' ')} | {said(name, one)} |" for name, one in row.figures.items()]
    if limits:
        lines += ["", "| effect | named in 90 % of logs from | by excited drives alone | logs |", "|---|---|---|---|"]
        lines += [f"| {label(one.name)} | {limit_words(one)} | {excited_words(one)} | {one.n} |" for one in limits]
        lines += ["", f"Intervals from slight to gross; open: nothing was asked beyond. {DOWN}."]
    return "\n".join(lines) + "\n"


def shares(outcomes: Mapping[str, int]) -> dict[str, float]:
    """Outcomes in percent with one digit, rounded so that they sum to 100.0."""
    n = sum(outcomes.values())
    exact = {name: 1000.0 * count / n for name, count in outcomes.items()}
    tenths = {name: int(value) for name, value in exact.items()}
    by_rest = sorted(exact, key=lambda name: tenths[name] - exact[name])
    for name in by_rest[: 1000 - sum(tenths.values())]:
        tenths[name] += 1
    return {name: count / 10.0 for name, count in tenths.items()}


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
                "models": row.models,
                "whole_models": row.whole,
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
        draw_outcomes(paths[-1], rows, heading(domain, done))
    if limits:
        paths.append(folder / "limits.png")
        draw_limits(paths[-1], limits, heading(domain, done))
    return paths
