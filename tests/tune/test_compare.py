"""Medians, intervals, ratios and random search (design D9)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tune.drive_study import FIRST, SPACE, bowl, settings
from tunefree_hil.base.errors import InputError
from tunefree_hil.tune.compare import best_baseline, best_so_far, improvement, random_search, spread
from tunefree_hil.tune.study import Baseline, open_study


@given(st.lists(st.floats(0.01, 10.0), min_size=1, max_size=12))
def test_a_spread_holds_its_median(values: list[float]) -> None:
    found = spread(values)
    assert min(values) <= found.low <= found.value <= found.high <= max(values)
    assert found.n == len(values)
    assert found == spread(values[::-1])._replace(low=found.low, high=found.high)


def test_few_values_give_their_range() -> None:
    assert spread([3.0, 1.0, 2.0, 10.0]) == (2.5, 1.0, 10.0, 4)


def test_the_interval_covers_the_truth_about_as_often_as_it_says() -> None:
    """Of a normal's median at n = 25, in 200 repeats; a percentile bootstrap is a little too sure at this size."""
    chance = np.random.default_rng(5)
    hits = sum(
        found.low <= 0.0 <= found.high for found in (spread(row) for row in chance.normal(size=(200, 25)).tolist())
    )
    assert 0.86 <= hits / 200 <= 0.995


def test_an_interval_repeats_and_narrows() -> None:
    values = np.random.default_rng(1).normal(size=400).tolist()
    assert spread(values, seed=3) == spread(values, seed=3)
    few, many = spread(values[:20]), spread(values)
    assert many.high - many.low < 0.5 * (few.high - few.low)


def test_ratios_are_paired() -> None:
    assert improvement([0.3, 0.4, 0.6], 1.0).value == pytest.approx(0.4)
    paired = improvement([1.0, 4.0, 9.0], [2.0, 8.0, 18.0])
    assert (paired.low, paired.value, paired.high) == (0.5, 0.5, 0.5)


@pytest.mark.parametrize(("tuned", "manual"), [([], 1.0), ([1.0], 0.0), ([1.0, 2.0], [1.0]), ([float("nan")], 1.0)])
def test_ratios_of_nothing_are_refused(tuned: list[float], manual: float | list[float]) -> None:
    with pytest.raises(InputError):
        improvement(tuned, manual)


def test_the_best_baseline_says_that_it_replanned() -> None:
    drives = {"left_turn": {"replans": 1}, "u_turn": {"replans": 2}, "straight": {}}
    baselines = {"as_shipped": Baseline({}, 0.9, {}), "mrac_on": Baseline({}, 0.7, drives)}
    assert best_baseline(baselines) == ("mrac_on", 0.7, 3)
    with pytest.raises(InputError):
        best_baseline({})


def test_best_so_far_never_rises() -> None:
    assert best_so_far([3.0, 4.0, 1.0, 2.0]) == [3.0, 3.0, 1.0, 1.0]
    assert best_so_far([]) == []


def test_random_search_is_the_random_study_without_a_file(tmp_path: Path) -> None:
    with open_study(tmp_path / "study.db", settings("random")) as study:
        list(study.run(8, bowl))
        assert random_search(SPACE, 8, bowl, seed=3, first=FIRST) == study.trials()
