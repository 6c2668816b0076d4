"""Steps within bounds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from tunefree_hil.gap.estimation.least_squares import (
    CURVATURE_FLOOR,
    JOINT_BOUND_SLACK,
    MAX_JOINT_SIGMA,
    Bounds,
    shrink_inside_joint_bounds,
    step_within_bounds,
    step_within_joint_bounds,
)


@settings(deadline=None)
@given(st.integers(0, 10_000))
def test_a_step_within_bounds_is_no_worse_than_the_clipped_one(seed: int) -> None:
    chance = np.random.default_rng(seed)
    root = chance.standard_normal((6, 3))
    curve, slope = root.T @ root + 0.1 * np.eye(3), 3.0 * chance.standard_normal(3)
    z, low, high = np.zeros(3), -np.ones(3), np.ones(3)

    def cost(step: np.ndarray) -> float:
        return float(2.0 * slope @ step + step @ curve @ step)

    step = step_within_bounds(curve, slope, z, Bounds(low, high))
    assert (abs(step) <= 1.0 + 1e-12).all()
    clipped = np.clip(-np.linalg.solve(curve, slope), low, high)
    assert cost(step) <= cost(clipped) + 1e-6 * abs(cost(clipped)) + 1e-9
    assert cost(step) <= 1e-9  # it is no worse than staying


@settings(deadline=None)
@given(st.integers(0, 10_000), st.floats(-2.0, 4.0))
def test_of_nearly_collinear_parameters_none_is_clamped_needlessly(seed: int, decades: float) -> None:
    """Together they would leave their bounds, but not all of them belong there."""
    chance = np.random.default_rng(seed)
    root = chance.standard_normal((12, 8))
    root[:, 1] = root[:, 0] + 0.01 * chance.standard_normal(12)
    root[:, 3] = root[:, 2] - root[:, 4] + 0.01 * chance.standard_normal(12)
    curve = 10.0**decades * root.T @ root + np.eye(8)
    slope = chance.uniform(0.0, 5.0) * chance.standard_normal(8) * np.sqrt(np.diag(curve))
    z = np.where(chance.uniform(size=8) < 0.3, 2.0, chance.uniform(-2.0, 2.0, 8))
    low, high = np.full(8, -2.0), np.full(8, 2.0)

    step = step_within_bounds(curve, slope, z, Bounds(low, high))
    assert (z + step >= low - 1e-12).all() and (z + step <= high + 1e-12).all()
    pull = -(slope + (curve + CURVATURE_FLOOR * np.eye(8)) @ step)
    pull = np.where(z + step <= low + 1e-12, np.maximum(pull, 0.0), pull)
    pull = np.where(z + step >= high - 1e-12, np.minimum(pull, 0.0), pull)
    assert np.abs(pull).max() <= 1e-7 * (1.0 + np.abs(slope).max())  # nothing pulls anything to where it may still go


def test_a_parameter_without_information_stays_where_it_is() -> None:
    curve = np.diag([2.0, 0.0])
    step = step_within_bounds(curve, np.array([1.0, 0.0]), np.zeros(2), Bounds(-np.ones(2), np.ones(2)))
    assert step == pytest.approx([-0.5, 0.0])


def test_without_joint_bounds_a_step_is_the_bounded_one() -> None:
    curve, slope = np.diag([2.0, 3.0]), np.array([1.0, -9.0])
    some = (curve, slope, np.zeros(2), Bounds(-np.ones(2), np.ones(2)))
    assert step_within_joint_bounds(*some, np.zeros((0, 2))) == pytest.approx(step_within_bounds(*some))


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000), st.floats(-1.0, 3.0))
def test_a_step_within_joint_bounds_is_the_minimum_there(seed: int, decades: float) -> None:
    """Two directions that are known three to ten times better than each parameter."""
    chance = np.random.default_rng(seed)
    root, along = chance.standard_normal((9, 5)), np.linalg.qr(chance.standard_normal((5, 2)))[0].T
    curve = 10.0**decades * root.T @ root + np.eye(5)
    slope = 20.0 * chance.standard_normal(5) * np.sqrt(np.diag(curve))
    walls = along * chance.uniform(3.0, 10.0, (2, 1))
    z, low, high = np.zeros(5), np.full(5, -2.0), np.full(5, 2.0)

    def cost(step: np.ndarray) -> float:
        return float(2.0 * slope @ step + step @ curve @ step)

    step = step_within_joint_bounds(curve, slope, z, Bounds(low, high), walls)
    assert np.abs(walls @ step).max() <= 1.01 * MAX_JOINT_SIGMA and (np.abs(step) <= 2.0 + 1e-9).all()
    inside = [
        {"type": "ineq", "fun": lambda x, w=wall, s=side: MAX_JOINT_SIGMA - s * float(w @ x)}
        for wall in walls
        for side in (-1.0, 1.0)
    ]
    best = minimize(
        cost, np.zeros(5), jac=lambda x: 2.0 * (slope + curve @ x), bounds=list(zip(low, high, strict=True)),
        constraints=inside, method="SLSQP", options={"maxiter": 500, "ftol": 1e-12},
    )  # fmt: skip
    assert cost(step) <= float(best.fun) + 1e-3 * abs(float(best.fun))


@settings(deadline=None, max_examples=200)
@given(st.integers(0, 10_000), st.floats(0.0, 4.0), st.booleans())
def test_no_step_exceeds_any_number_of_joint_bounds(seed: int, decades: float, outside: bool) -> None:
    """Twelve directions of twenty parameters, whose information differs by a factor of a thousand."""
    chance = np.random.default_rng(seed)
    root = chance.standard_normal((30, 20)) * 10.0 ** chance.uniform(-1.0, decades, 20)
    curve, slope = root.T @ root + np.eye(20), root.T @ (10.0 * chance.standard_normal(30))
    along = np.linalg.qr(chance.standard_normal((20, 20)))[0].T[:12]
    walls = along / chance.uniform(0.02, 0.9, (12, 1)) ** 0.5
    z = chance.uniform(-2.0, 2.0, 20) if outside else np.zeros(20)
    there = z + step_within_joint_bounds(curve, slope, z, Bounds(np.full(20, -2.0), np.full(20, 2.0)), walls)
    assert np.abs(walls @ there).max() <= 1.001 * JOINT_BOUND_SLACK * MAX_JOINT_SIGMA
    assert np.abs(there).max() <= 2.0 + 1e-9


def test_a_point_beyond_a_joint_bound_is_shrunk_and_other_parameters_stay() -> None:
    walls = np.array([[4.0, 3.0, 0.0]])
    assert shrink_inside_joint_bounds(np.array([2.0, 0.0, 1.5]), walls) == pytest.approx([0.75, 0.0, 1.5])
    inside = np.array([0.5, 0.3, 2.0])
    assert (
        shrink_inside_joint_bounds(inside, walls) is inside
        and shrink_inside_joint_bounds(inside, np.zeros((0, 3))) is inside
    )
