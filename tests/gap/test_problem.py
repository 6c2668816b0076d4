"""Steps within bounds, and parameters on their scales."""

from __future__ import annotations

import pytest

from tunefree_hil.base.contracts import Prior
from tunefree_hil.gap.suspects import free_of


@pytest.mark.parametrize("prior", [Prior(0.01, 0.5, 0.1, "log"), Prior(-0.2, 0.6, 0.1), Prior(0.01, 0.8, 0.1)])
def test_a_parameter_goes_to_its_scale_and_back_and_never_through_nought(prior: Prior) -> None:
    free = free_of("some.delay_s", prior, 0.0)
    assert free.value(0.0) == pytest.approx(prior.low) and free.value(1.0) == pytest.approx(prior.high)
    assert free.value(free.place(0.3)) == pytest.approx(0.3)
    if prior.low > 0.0:
        assert free.value(free.least) > 0.0
