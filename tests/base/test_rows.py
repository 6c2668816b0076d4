"""Rows hold every field of a record, each in its place."""

from __future__ import annotations

from typing import Any

import pytest

from tunefree_hil.base.records import Ins, Report
from tunefree_hil.base.rows import (
    INS_WIDTH,
    REPORT_WIDTH,
    interpolate_ins,
    interpolate_report,
    next_row,
    pack_ins,
    pack_report,
    pack_row,
)

CASES = [(Report, pack_report, interpolate_report, REPORT_WIDTH), (Ins, pack_ins, interpolate_ins, INS_WIDTH)]


@pytest.mark.parametrize(("record", "pack", "interpolate", "width"), CASES)
def test_every_field_comes_back_in_its_place(record: Any, pack: Any, interpolate: Any, width: int) -> None:
    """A field that is added to the record and not to rows.py comes back as its default, NaN."""
    newer = record(*(0.1 * (i + 1) for i in range(width)))
    older = record(*(0.2 * (i + 1) for i in range(width)))
    rows = [0.0] * (2 * width)
    assert pack(rows, 0, older) == width and pack(rows, width, newer) == 2 * width == len(rows)
    assert rows == [*older, *newer]
    copy = [0.0] * width
    assert pack_row(copy, 0, newer) == width and copy == list(newer)
    assert interpolate(rows, 0, width, 0.0) == newer
    half = interpolate(rows, 0, width, 0.5)
    for name in record._fields:
        ends = getattr(newer, name), getattr(older, name)
        expected = ends[1] if name == "gear" else 0.5 * (ends[0] + ends[1])
        assert getattr(half, name) == pytest.approx(expected), name


def test_rows_are_a_ring() -> None:
    assert next_row([0.0] * 6, 0, 3) == 3 and next_row([0.0] * 6, 3, 3) == 0
