"""The table of pairs says what the score says: capped values, missing metrics dropped, the rest renormalised."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.grade.weight_regression.made_pairs import METRICS, base_weights, drive, ruled_pairs, table_of
from tunefree_hil.base.errors import InputError
from tunefree_hil.grade.score import weighted_mean
from tunefree_hil.grade.weight_regression.pairs import (
    DrivePair,
    DriverKind,
    find_reversed_pairs,
    make_pair_table,
    score_margins,
)

VALUES = st.lists(st.floats(0.0, 5.0), min_size=len(METRICS), max_size=len(METRICS))
MULTIPLIERS = st.lists(st.floats(0.1, 5.0), min_size=len(METRICS), max_size=len(METRICS))


@given(human=VALUES, generated=VALUES, multipliers=MULTIPLIERS, lacks=st.integers(0, len(METRICS) - 1))
def test_a_margin_is_the_difference_of_two_scores(
    human: list[float], generated: list[float], multipliers: list[float], lacks: int
) -> None:
    base = base_weights()
    sides: list[dict[str, float | None]] = [dict(zip(METRICS, values, strict=True)) for values in (human, generated)]
    sides[1][METRICS[lacks]] = None
    pair = DrivePair(drive("a", sides[0]), drive("b", sides[1]), "g", DriverKind.HUMAN)
    margin = score_margins(make_pair_table([pair], base), np.array(multipliers))[0]
    weighing = base_weights(**{name: 10.0 * u for name, u in zip(METRICS, multipliers, strict=True)})
    sides[0][METRICS[lacks]] = None
    expected = weighted_mean(sides[1], weighing) - weighted_mean(sides[0], weighing)
    assert margin == pytest.approx(expected, abs=1e-9)


def test_a_metric_without_a_base_weight_is_no_column() -> None:
    base = base_weights(lateral_rms_after_start=3.0, steer_rate_rms=0.0)
    pair = DrivePair(drive("a", [0.1, 0, 0, 0]), drive("b", [0.2, 0, 9, 0]), "g", DriverKind.HUMAN)
    table = make_pair_table([pair], base)
    assert table.metrics == ("lateral_rms_after_start",)
    assert table.shares.tolist() == [1.0]


def test_swapped_pairs_have_opposite_margins() -> None:
    table = table_of(ruled_pairs([1, 2, 3, 4], 3, 1))
    is_swapped = np.arange(table.n_pairs) % 2 == 0
    before, after = (score_margins(one, np.ones(len(METRICS))) for one in (table, table.swap(is_swapped)))
    assert np.allclose(after, np.where(is_swapped, -before, before))


def test_unlike_tasks_are_refused_by_name() -> None:
    pair = DrivePair(
        drive("anna", [0, 0, 0, 0], "u_turn"), drive("gains", [0, 0, 0, 0], "side_pass"), "g", DriverKind.HUMAN
    )
    with pytest.raises(InputError, match=r"anna drove u_turn, gains drove side_pass") as error:
        make_pair_table([pair], base_weights())
    assert error.value.code == "unlike_tasks"


def test_a_drive_without_any_metric_is_refused_by_name() -> None:
    pair = DrivePair(drive("anna", dict.fromkeys(METRICS)), drive("gains", [0, 0, 0, 0]), "g", DriverKind.HUMAN)
    with pytest.raises(InputError, match="anna / gains") as error:
        make_pair_table([pair], base_weights())
    assert error.value.code == "nothing_to_grade"


def test_a_pair_and_its_reverse_are_found() -> None:
    pairs = ruled_pairs([1, 1, 1, 1], 2, 5, n_each=2)
    assert find_reversed_pairs(pairs) == []
    turned = pairs[1]._replace(human=pairs[1].generated, generated=pairs[1].human)
    assert find_reversed_pairs([*pairs, turned]) == [(1, 4)]
