"""Values: what is known, what is not, and the lag that two numbers make."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tunefree_hil.learn.estimate import (
    ActuatorFit,
    Estimate,
    compute_rise_63_s,
    data_from_estimates,
    make_exact_estimate,
    make_unidentified_estimate,
)


def fit(order: int = 1) -> ActuatorFit:
    value = Estimate(0.1, 0.09, 0.11)
    return ActuatorFit(
        value,
        order,
        value,
        make_exact_estimate(3.0),
        make_exact_estimate(0.7),
        make_exact_estimate(math.inf),
        make_exact_estimate(0.0),
        make_exact_estimate(1.0),
        make_exact_estimate(0.0),
    )


def test_what_is_not_known_is_wide_and_says_why() -> None:
    value = make_unidentified_estimate(4.0, "the drives never showed it")
    assert (value.low, value.high, value.known) == (2.0, 6.0, False) and "never" in value.why
    assert make_unidentified_estimate(math.inf, "", low=7.0).low == 7.0


@pytest.mark.parametrize(("natural_hz", "damping"), [(2.0, 0.4), (3.0, 1.0), (1.5, 2.5)])
def test_the_63_percent_time_is_that_of_the_step_response(natural_hz: float, damping: float) -> None:
    natural = 2.0 * math.pi * natural_hz
    y = slope = 0.0
    dt_s, t = 1e-5, 0.0
    while y < 1.0 - math.exp(-1.0):
        slope += dt_s * (natural * natural * (1.0 - y) - 2.0 * damping * natural * slope)
        y += dt_s * slope
        t += dt_s
    assert compute_rise_63_s(natural_hz, damping) == pytest.approx(t, rel=1e-3)


def test_only_the_numbers_of_its_order_are_told() -> None:
    assert "lag_s" in fit(1).estimates() and "damping" not in fit(1).estimates()
    assert {"natural_hz", "damping"} < set(fit(2).estimates()) and "lag_s" not in fit(2).estimates()
    assert fit(1).lag_63_s() == 0.1
    assert fit(2).params(rest=0.15).order == 2.0 and fit().params(rest=0.15).initial == 0.15


def test_a_card_holds_plain_numbers() -> None:
    data = data_from_estimates(
        {"rate_limit": make_unidentified_estimate(math.inf, "not reached", low=np.float64(2.0).item(), high=math.inf)}
    )
    assert data["rate_limit"]["value"] is None and data["rate_limit"]["low"] == 2.0


@pytest.mark.parametrize("is_needed", [True, False])
def test_a_card_has_the_same_keys_whether_a_number_is_needed_or_not(is_needed: bool) -> None:
    data = data_from_estimates({"drag": Estimate(1.0, 0.5, 1.5, False, "never shown", is_needed)})
    assert data == {"drag": {"value": 1.0, "low": 0.5, "high": 1.5, "known": False, "why": "never shown"}}
    assert list(data["drag"]) == ["value", "low", "high", "known", "why"]
