"""Ranks: what is compared with what, and what has no rank."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tools.measures.transfer import BEST, Graded, correlations

SETS = 80
SCORE = np.linspace(0.1, 3.0, SETS)


def graded(score: np.ndarray, finished: np.ndarray | None = None) -> Graded:
    return Graded(score, np.ones(len(score), dtype=bool) if finished is None else finished)


def test_the_same_order_is_1_whatever_the_scale_and_the_other_way_round_minus_1() -> None:
    same = correlations(graded(np.exp(SCORE)), graded(SCORE), 1)
    assert [same[name]["rho"] for name in ("finished", "all", f"best_{BEST}")] == pytest.approx([1.0] * 3)
    assert correlations(graded(-SCORE), graded(SCORE), 1)["all"]["rho"] == pytest.approx(-1.0)


def test_sets_that_end_early_on_either_side_are_counted_apart() -> None:
    broken = SCORE.copy()
    broken[-20:] = 10.0
    found = correlations(graded(broken, broken < 10.0), graded(SCORE, SCORE > 0.2), 1)
    assert found["finished"]["n"] == np.count_nonzero((broken < 10.0) & (SCORE > 0.2)) < SETS == found["all"]["n"]
    assert found["finished"]["rho"] == pytest.approx(1.0) and found["all"]["rho"] < 1.0


def test_the_best_are_the_vehicles() -> None:
    model = SCORE.copy()
    model[BEST:] = model[BEST:][::-1]  # wrong about the bad ones only
    found = correlations(graded(model), graded(SCORE), 1)
    assert found[f"best_{BEST}"] == {"rho": pytest.approx(1.0), "n": BEST, "low": pytest.approx(1.0),
                                     "high": pytest.approx(1.0)}  # fmt: skip
    assert found["all"]["low"] <= found["all"]["rho"] <= found["all"]["high"] < 1.0


def test_a_plant_that_tells_nothing_apart_has_no_rank() -> None:
    found = correlations(graded(np.full(SETS, 10.0)), graded(SCORE), 1)
    assert math.isnan(found["all"]["rho"])
    assert math.isnan(correlations(graded(SCORE[:2]), graded(SCORE[:2]), 1)["all"]["rho"])
