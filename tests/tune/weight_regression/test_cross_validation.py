"""Held-out pairs are ranked by what was learned of others; with permuted labels they are ranked by chance."""

from __future__ import annotations

import numpy as np
import pytest

from tests.grade.weight_regression.made_pairs import ruled_pairs, table_of
from tunefree_hil.grade.weight_regression.pairs import DrivePair, score_margins
from tunefree_hil.grade.weight_regression.ranking import ranking_accuracy
from tunefree_hil.tune.weight_regression.cross_validation import (
    STRENGTHS,
    Regression,
    choose_strength,
    rank_held_out,
    regress,
)

pytestmark = pytest.mark.slow

RULE = [6.0, 0.0, 1.0, 1.0]


def finished(pairs: list[DrivePair], seed: int = 1) -> Regression:
    steps = regress(table_of(pairs), [pair.group for pair in pairs], 0.05, seed)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


@pytest.fixture(scope="module")
def pairs() -> list[DrivePair]:
    return ruled_pairs(RULE, 20, 7)


@pytest.fixture(scope="module")
def regression(pairs: list[DrivePair]) -> Regression:
    return finished(pairs)


def test_held_out_pairs_are_ranked_better_than_by_the_base_weights(
    pairs: list[DrivePair], regression: Regression
) -> None:
    base = ranking_accuracy(score_margins(table_of(pairs), np.ones(4)))
    assert ranking_accuracy(regression.held_out.margins) > max(0.9, base + 0.1)


def test_permuted_labels_give_chance(regression: Regression) -> None:
    assert abs(np.mean(regression.permuted) - 0.5) < 0.04
    assert all(0.3 < share < 0.7 for share in regression.permuted)


def test_random_labels_give_chance_and_a_strong_pull() -> None:
    noise = ruled_pairs(RULE, 20, 8)
    is_swapped = np.random.default_rng(3).random(len(noise)) < 0.5
    table, groups = table_of(noise).swap(is_swapped), [pair.group for pair in noise]
    accuracy = ranking_accuracy(rank_held_out(table, groups, 0.05, 1).margins)
    assert 0.35 < accuracy < 0.65
    assert choose_strength(table, groups, 0.05, 1).strength >= 0.1


def test_the_strength_is_the_largest_that_is_about_as_good(pairs: list[DrivePair]) -> None:
    choice = choose_strength(table_of(pairs), [pair.group for pair in pairs], 0.05, 1)
    best = int(np.argmin(choice.losses))
    assert len(choice.losses) == len(STRENGTHS) and choice.strength >= STRENGTHS[best]
    assert choice.losses[STRENGTHS.index(choice.strength)] < choice.losses[-1]


def test_the_held_out_group_is_not_in_the_weights(pairs: list[DrivePair]) -> None:
    """A group that says the opposite of all others is ranked wrong when it is held out."""
    groups = [pair.group for pair in pairs]
    is_swapped = np.array([group == groups[0] for group in groups])
    table = table_of(pairs).swap(is_swapped)
    margins = rank_held_out(table, groups, 0.05, 1).margins
    assert ranking_accuracy(margins[is_swapped]) < 0.3
    assert ranking_accuracy(margins[~is_swapped]) > 0.8


def test_the_same_seed_gives_the_same_weights(pairs: list[DrivePair], regression: Regression) -> None:
    again = finished(pairs)
    assert (again.fit.multipliers == regression.fit.multipliers).all()
    assert again.permuted == regression.permuted
