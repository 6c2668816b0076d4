#!/usr/bin/env python3
"""`tools/make_results_page.py`: writes the pages of docs/results/ from their CSV files and tools/results_pages/.

A CSV is the record: `tools/measure NAME` and `python -m tools.gap_exam score` print what is entered there.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "results"

TEMPLATES = Path(__file__).resolve().with_name("results_pages")


def table(path: Path) -> str:
    """A CSV as a Markdown table; underscores of its heads become spaces."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    heads = [head.replace("_", " ") for head in rows[0]]
    lines = [_row(heads), "|" + "---|" * len(heads), *map(_row, rows[1:])]
    return "\n".join(lines)


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def pages() -> dict[str, str]:
    """File name -> text."""
    tables = {path.stem: table(path) for path in sorted(FOLDER.glob("*.csv"))}
    return {path.name: path.read_text(encoding="utf-8").format(**tables) for path in sorted(TEMPLATES.glob("*.md"))}


def main() -> int:
    """Write the pages. Returns 0."""
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
