"""Differences by block: their interval, and many questions at once."""

from __future__ import annotations

import numpy as np

from tunefree_hil.gap.estimation.evidence import bootstrapped, holm


def test_a_difference_of_a_few_blocks_is_not_sure_and_one_of_all_is() -> None:
    chance = np.random.default_rng(1)
    one = bootstrapped(np.concatenate([[200.0], -1.0 + 0.1 * chance.standard_normal(14)]))
    assert one.total > 100.0 and one.low < 0.0 and one.doubt > 0.05
    all_of_them = bootstrapped(10.0 + chance.standard_normal(15))
    assert all_of_them.low > 100.0 and all_of_them.doubt == 0.5**15


def test_a_few_blocks_that_say_the_same_may_do_so_by_chance() -> None:
    """Six blocks, as a minute leaves them to be judged: no draw of equal signs is of another one."""
    few = bootstrapped(np.full(6, 10.0))
    assert few.low > 0.0 and few.doubt == 0.5**6
    assert holm({f"rival {i}": few.doubt for i in range(3)}) and not holm({f"rival {i}": few.doubt for i in range(4)})


def test_holm_asks_more_of_each_the_more_are_asked() -> None:
    assert holm({"a": 0.03}) == {"a"}
    assert holm({"a": 0.03, "b": 0.5}) == set()
    assert holm({"a": 0.001, "b": 0.04, "c": 0.6}) == {"a"}
    assert holm({"a": 0.001, "b": 0.02, "c": 0.04}) == {"a", "b", "c"}
