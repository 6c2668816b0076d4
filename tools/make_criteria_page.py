#!/usr/bin/env python3
"""`tools/make_criteria_page.py`: writes docs/results/criteria.md, all thresholds, from the Criteria records.

A threshold is a field of a frozen record whose name ends in Criteria. What it means, its unit and where its value comes
from stand in the comment above the field or behind it; the record's docstring says what the fields have in common.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "tunefree_hil"
PAGE = ROOT / "docs" / "results" / "criteria.md"
HEAD = """# Criteria: every threshold that decides something

Made by `tools/make_criteria_page.py` from the records in the source. A commit behind a meaning is that of the exam that
first ran with the value ([exams](gap_exam.md)); a row without a source is an engineering choice.
"""


class Threshold(NamedTuple):
    """A field of a criteria record."""

    name: str
    value: str
    meaning: str


class CriteriaRecord(NamedTuple):
    """A criteria record: its file in the package, name, docstring and fields."""

    file: str
    name: str
    doc: str
    thresholds: tuple[Threshold, ...]


def records() -> list[CriteriaRecord]:
    """All criteria records of the package, by file."""
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        lines = source.splitlines()
        for node in ast.parse(source).body:
            if isinstance(node, ast.ClassDef) and node.name.endswith("Criteria"):
                doc = " ".join((ast.get_docstring(node) or "").split())
                file = path.relative_to(PACKAGE).as_posix()
                found.append(CriteriaRecord(file, node.name, doc, tuple(thresholds(node, lines))))
    return found


def thresholds(record: ast.ClassDef, lines: list[str]) -> list[Threshold]:
    """The fields of a record with their comments."""
    fields = [node for node in record.body if isinstance(node, ast.AnnAssign)]
    return [
        Threshold(ast.unparse(field.target), ast.unparse(field.value) if field.value else "", comment(field, lines))
        for field in fields
    ]


def comment(field: ast.AnnAssign, lines: list[str]) -> str:
    """The comment lines right above a field, and the one behind it."""
    above = []
    row = field.lineno - 2
    while row >= 0 and lines[row].lstrip().startswith("#"):
        above.insert(0, lines[row].strip().lstrip("# "))
        row -= 1
    last = (field.end_lineno or field.lineno) - 1
    behind = lines[last][field.end_col_offset or 0 :].partition("#")[2].strip()
    return " ".join([*above, *([behind] if behind else [])])


def page() -> str:
    """The text of the page."""
    parts = [HEAD]
    for record in records():
        parts.append(
            f"\n## `{record.file}`: {record.name}\n{record.doc}\n\n| field | value | meaning |\n|---|---|---|\n"
        )
        parts += [f"| `{t.name}` | {_cell(t.value)} | {_cell(t.meaning)} |\n" for t in record.thresholds]
    return "".join(parts)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def main() -> int:
    """Write the page. Returns 0."""
    PAGE.write_text(page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
