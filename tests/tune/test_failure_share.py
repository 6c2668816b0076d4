"""Intervals of shares keep what they promise."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.tune.failure_share import compute_failure_share


def probability_of_at_most(failed: int, n: int, share: float) -> float:
    return math.fsum(math.comb(n, k) * share**k * (1.0 - share) ** (n - k) for k in range(failed + 1))


@given(st.integers(2, 300).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_beyond_each_end_the_count_has_a_chance_of_one_in_forty(pair: tuple[int, int]) -> None:
    failed, n = pair
    share = compute_failure_share(failed, n)
    assert share.low <= share.share <= share.high
    if failed < n:
        assert probability_of_at_most(failed, n, share.high) == pytest.approx(0.025, rel=1e-6)
    if failed > 0:
        assert 1.0 - probability_of_at_most(failed - 1, n, share.low) == pytest.approx(0.025, rel=1e-5)
    assert (share.low == 0.0) == (failed == 0) and (share.high == 1.0) == (failed == n)


def test_of_nothing_nothing_is_known() -> None:
    assert compute_failure_share(0, 0) == (0, 0, 0.0, 1.0)
    assert compute_failure_share(0, 0).share == 0.0
