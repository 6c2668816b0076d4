"""Folds hold out whole groups; accuracy counts pairs; its interval widens where pairs of a group are alike."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.grade.weight_regression.made_pairs import drive
from tunefree_hil.grade.weight_regression.pairs import DrivePair, DriverKind
from tunefree_hil.grade.weight_regression.ranking import (
    accuracy_interval,
    margins_of_other_weights,
    other_rows,
    ranking_accuracy,
    split_folds,
)


@given(
    groups=st.lists(st.sampled_from("abcdefg"), min_size=1, max_size=40),
    n_folds=st.integers(1, 8),
    seed=st.integers(0, 9),
)
def test_every_pair_is_held_out_once_with_its_whole_group(groups: list[str], n_folds: int, seed: int) -> None:
    folds = split_folds(groups, n_folds, seed)
    assert len(folds) == min(n_folds, len(set(groups)))
    assert sorted(np.concatenate(folds).tolist()) == list(range(len(groups)))
    for fold in folds:
        held_out = {groups[row] for row in fold}
        assert held_out.isdisjoint(groups[row] for row in other_rows(fold, len(groups)))


def test_folds_follow_from_the_seed_alone() -> None:
    groups = [f"road {number // 3}" for number in range(60)]
    first, again, other = (split_folds(groups, 5, seed) for seed in (1, 1, 2))
    assert all((a == b).all() for a, b in zip(first, again, strict=True))
    assert any(a.tolist() != b.tolist() for a, b in zip(first, other, strict=True))


def test_a_tie_counts_half() -> None:
    assert ranking_accuracy(np.array([1.0, -1.0, 0.0, 2.0])) == 0.625
    assert math.isnan(ranking_accuracy(np.array([])))


def test_the_interval_counts_groups_not_pairs() -> None:
    margins = np.tile([1.0, 1.0, 1.0, -1.0], 50)
    alone = accuracy_interval(margins, [str(row) for row in range(200)], 1)
    alike = accuracy_interval(np.repeat([1.0, 1.0, 1.0, -1.0], 50), [str(row // 50) for row in range(200)], 1)
    assert alone.share == alike.share == 0.75
    assert alike.high - alike.low > 3.0 * (alone.high - alone.low)


def test_pairs_that_other_weights_cannot_grade_are_not_counted() -> None:
    graded = drive("a", [0, 0, 0, 0])._replace(other_scores={"paper": 0.3})
    pairs = [
        DrivePair(graded, graded._replace(other_scores={"paper": 0.5}), "g", DriverKind.HUMAN),
        DrivePair(graded, drive("b", [0, 0, 0, 0]), "h", DriverKind.HUMAN),
    ]
    margins = margins_of_other_weights(pairs, "paper")
    assert margins[0] == pytest.approx(0.2) and math.isnan(margins[1])
    assert accuracy_interval(margins, ["g", "h"], 1)._replace(low=0, high=0) == (1.0, 0, 0, 1)
