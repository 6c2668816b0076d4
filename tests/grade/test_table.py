"""docs/reference/grading.md lists every metric of the table, and no other."""

from __future__ import annotations

import re

from tests.house import ROOT
from tunefree_hil.grade.table import ASPECTS, TABLE, names_by_aspect


def test_the_page_lists_the_table() -> None:
    rows = [
        line for line in (ROOT / "docs" / "reference" / "grading.md").read_text().splitlines() if line.startswith("|")
    ]
    found: dict[str, set[str]] = {}
    aspect = ""
    for row in rows[2:]:
        cells = [cell.strip() for cell in row.split("|")[1:-1]]
        aspect = cells[0] or aspect
        names = re.findall(r"`(\w+)`", cells[1])
        if "_harsh`" in cells[1] and "each also" in cells[1]:
            names = [name for name in names if name != "_harsh"]
            names += [f"{name}_harsh" for name in names]
        found.setdefault(aspect, set()).update(names)
    assert found == {name: set(metrics) for name, metrics in names_by_aspect().items()}
    assert tuple(found) == ASPECTS


def test_every_row_says_what_it_needs() -> None:
    for name, row in TABLE.items():
        assert row.needs and row.description and row.aspect in ASPECTS, name
        assert (row.limit > 0.0) == (row.aggregation == "share"), name
