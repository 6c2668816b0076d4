"""Runs and spacing of flags against plain loops."""

from __future__ import annotations

from itertools import groupby

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.learn.drives.runs import covered_rows, find_runs, sample_interval_ticks, true_throughout


def test_runs() -> None:
    flags = np.array([1, 1, 0, 1, 1, 1, 0, 1], dtype=bool)
    assert find_runs(flags) == [(0, 2), (3, 6), (7, 8)]
    assert find_runs(flags, 2) == [(0, 2), (3, 6)] and find_runs(flags, 3, 10) == [(13, 16)]
    assert find_runs(np.zeros(3, dtype=bool)) == [] == find_runs(np.zeros(0, dtype=bool))


@given(st.lists(st.booleans(), max_size=40), st.integers(1, 5), st.integers(0, 9))
def test_runs_are_those_that_one_counts_by_hand(flags: list[bool], least: int, first: int) -> None:
    expected, begin = [], first
    for holds, group in groupby(flags):
        count = len(list(group))
        expected += [(begin, begin + count)] if holds and count >= least else []
        begin += count
    assert find_runs(np.array(flags, dtype=bool), least, first) == expected


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.integers(0, 9), st.integers(0, 9))
def test_throughout_looks_at_every_row_about_it(flags: list[bool], before: int, behind: int) -> None:
    result = true_throughout(np.array(flags), before, behind)
    for k, is_true in enumerate(result):
        begin, end = k - before, k + behind + 1
        assert is_true == (begin >= 0 and end <= len(flags) and all(flags[begin:end]))


def test_the_usual_distance_is_not_that_of_the_gaps() -> None:
    fresh = np.zeros(400, dtype=bool)
    fresh[3:200:4] = True
    fresh[390] = True
    assert sample_interval_ticks(fresh) == 4.0
    assert sample_interval_ticks(np.array([1, 0, 1, 0, 0, 1], dtype=bool)) == 2.5
    assert sample_interval_ticks(fresh[:5]) == 1.0 == sample_interval_ticks(np.zeros(3, dtype=bool)), (
        "one value or none is no distance"
    )


def test_a_signal_is_there_between_values_that_are_no_gap_apart() -> None:
    fresh = np.zeros(200, dtype=bool)
    fresh[[10, 20, 30, 90, 100]] = True
    is_covered = covered_rows(fresh, 0.01)
    assert np.flatnonzero(is_covered).tolist() == [*range(10, 31), *range(90, 101)]
    assert not covered_rows(fresh & False, 0.01).any()
