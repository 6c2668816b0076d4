"""Steps within bounds, and parameters on their scales."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tunefree_hil.base.contracts import Prior
from tunefree_hil.gap.problem import FLAT, bounded
from tunefree_hil.gap.suspects import free_of


@settings(deadline=None)
@given(st.integers(0, 10_000))
def test_a_step_within_bounds_is_no_worse_than_any_other_there(seed: int) -> None:
    chance = np.random.default_rng(seed)
    root = chance.standard_normal((6, 3))
    curve, slope = root.T @ root + 0.1 * np.eye(3), 3.0 * chance.standard_normal(3)
    z, low, high = np.zeros(3), -np.ones(3), np.ones(3)

    def cost(step: np.ndarray) -> float:
        return float(2.0 * slope @ step + step @ curve @ step)

    step = bounded(curve, slope, z, low, high)
    assert (abs(step) <= 1.0 + 1e-12).all()
    clipped = np.clip(-np.linalg.solve(curve, slope), low, high)
    assert cost(step) <= cost(clipped) + 1e-6 * abs(cost(clipped)) + 1e-9
    assert cost(step) <= 1e-9  # it is no worse than staying


@settings(deadline=None)
@given(st.integers(0, 10_000), st.floats(-2.0, 4.0))
def test_of_parameters_that_do_nearly_the_same_none_is_held_that_need_not_be(seed: int, decades: float) -> None:
    """Together they would go far beyond their ends, and not all of them belong there."""
    chance = np.random.default_rng(seed)
    root = chance.standard_normal((12, 8))
    root[:, 1] = root[:, 0] + 0.01 * chance.standard_normal(12)
    root[:, 3] = root[:, 2] - root[:, 4] + 0.01 * chance.standard_normal(12)
    curve = 10.0**decades * root.T @ root + np.eye(8)
    slope = chance.uniform(0.0, 5.0) * chance.standard_normal(8) * np.sqrt(np.diag(curve))
    z = np.where(chance.uniform(size=8) < 0.3, 2.0, chance.uniform(-2.0, 2.0, 8))
    low, high = np.full(8, -2.0), np.full(8, 2.0)

    step = bounded(curve, slope, z, low, high)
    assert (z + step >= low - 1e-12).all() and (z + step <= high + 1e-12).all()
    pull = -(slope + (curve + FLAT * np.eye(8)) @ step)
    pull = np.where(z + step <= low + 1e-12, np.maximum(pull, 0.0), pull)
    pull = np.where(z + step >= high - 1e-12, np.minimum(pull, 0.0), pull)
    assert np.abs(pull).max() <= 1e-7 * (1.0 + np.abs(slope).max())  # nothing pulls anything to where it may still go


def test_a_parameter_that_nothing_feels_stays_where_it_is() -> None:
    curve = np.diag([2.0, 0.0])
    assert bounded(curve, np.array([1.0, 0.0]), np.zeros(2), -np.ones(2), np.ones(2)) == pytest.approx([-0.5, 0.0])


@pytest.mark.parametrize("prior", [Prior(0.01, 0.5, 0.1, "log"), Prior(-0.2, 0.6, 0.1), Prior(0.01, 0.8, 0.1)])
def test_a_parameter_goes_to_its_scale_and_back_and_never_through_nought(prior: Prior) -> None:
    free = free_of("some.delay_s", prior, 0.0)
    assert free.value(0.0) == pytest.approx(prior.low) and free.value(1.0) == pytest.approx(prior.high)
    assert free.value(free.place(0.3)) == pytest.approx(0.3)
    if prior.low > 0.0:
        assert free.value(free.least) > 0.0
