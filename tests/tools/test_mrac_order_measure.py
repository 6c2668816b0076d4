"""The measure of the order: what a cell drives, and that it counts only what was driven."""

from __future__ import annotations

import pytest

from tests.house import ROOT
from tools.measures.mrac_order import RATES, T_REFS_S, OrderCell, describe_order, drive_cell

STEER = str(ROOT / "bench_configs" / "mkz_steer.toml")


@pytest.mark.compiled
def test_a_cell_drives_its_order_on_the_grid() -> None:
    first, third = (drive_cell(OrderCell(STEER, 0.1, 0.077, order)) for order in (1, 3))
    assert first["off"] == third["off"] and first["shipped"] != third["shipped"]
    for row in (first, third):
        assert row["best"]["t_ref_s"] in T_REFS_S and row["best"]["p"] in RATES
        assert row["best"]["score"] < row["off"]["score"]
        assert 0 < row["better_than_off"] < len(T_REFS_S) * len(RATES)


def test_an_order_is_described_by_medians() -> None:
    rows = [
        {
            "off": {"score": 1.0, "lateral_peak": 0.2},
            "shipped": {"score": score, "lateral_peak": 0.1},
            "best": {"score": 0.5, "lateral_peak": score},
            "better_than_off": count,
        }
        for score, count in ((0.6, 1), (0.7, 2), (1.1, 9))
    ]
    found = describe_order(rows, [1.5, 0.5, 2.5])
    assert found["best_over_order_1"] == [1.5, 0.5, 2.5] and found["shipped_over_off"] == 0.7
    assert found["peak_m"] == {"off": 0.2, "shipped": 0.1, "best": 0.7} and found["better_than_off"] == 2
