"""Differences by block: their interval, and several tests at once."""

from __future__ import annotations

import numpy as np

from tunefree_hil.gap.estimation.evidence import bootstrap_sum, select_by_holm


def test_a_difference_of_one_block_is_not_significant_and_one_of_all_blocks_is() -> None:
    chance = np.random.default_rng(1)
    one = bootstrap_sum(np.concatenate([[200.0], -1.0 + 0.1 * chance.standard_normal(14)]))
    assert one.total > 100.0 and one.low < 0.0 and one.p_value > 0.05
    all_of_them = bootstrap_sum(10.0 + chance.standard_normal(15))
    assert all_of_them.low > 100.0 and all_of_them.p_value == 0.5**15


def test_a_few_blocks_may_agree_by_chance() -> None:
    """Six blocks, as one minute has: no draw from values of equal sign has the other sign."""
    few = bootstrap_sum(np.full(6, 10.0))
    assert few.low > 0.0 and few.p_value == 0.5**6
    assert select_by_holm({f"rival {i}": few.p_value for i in range(3)}) and not select_by_holm(
        {f"rival {i}": few.p_value for i in range(4)}
    )


def test_holm_requires_smaller_p_values_of_more_names() -> None:
    assert select_by_holm({"a": 0.03}) == {"a"}
    assert select_by_holm({"a": 0.03, "b": 0.5}) == set()
    assert select_by_holm({"a": 0.001, "b": 0.04, "c": 0.6}) == {"a"}
    assert select_by_holm({"a": 0.001, "b": 0.02, "c": 0.04}) == {"a", "b", "c"}
