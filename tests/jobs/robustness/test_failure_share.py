"""Intervals of shares: those of scipy, and what they promise."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from tunefree_hil.jobs.robustness.failure_share import failure_share


@given(st.integers(2, 3000).flatmap(lambda n: st.tuples(st.integers(1, n - 1), st.just(n))))
def test_the_interval_is_that_of_clopper_and_pearson(pair: tuple[int, int]) -> None:
    failed, n = pair
    share, exact = failure_share(failed, n), binomtest(failed, n).proportion_ci(method="exact")
    assert (share.low, share.high) == pytest.approx((exact.low, exact.high), rel=1e-6, abs=1e-9)
    assert share.low < share.share < share.high


@pytest.mark.parametrize("n", [1, 20, 1000])
def test_no_failure_has_the_upper_bound_of_the_rule_of_three(n: int) -> None:
    none, every = failure_share(0, n), failure_share(n, n)
    assert none.low == 0.0 and (1.0 - none.high) ** n == pytest.approx(0.05)
    assert none.high < 3.0 / n
    assert every.high == 1.0 and every.low == pytest.approx(1.0 - none.high)


def test_of_nothing_nothing_is_known() -> None:
    assert failure_share(0, 0) == (0, 0, 0.0, 1.0)
    assert failure_share(0, 0).share == 0.0
