"""Steps within bounds, and parameters on their scales."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from tunefree_hil.base.contracts import Prior
from tunefree_hil.gap.estimation.candidates import free_parameter_from_prior
from tunefree_hil.gap.estimation.least_squares import MAX_JOINT_VARIANCE, FreeParameter, LeastSquaresProblem
from tunefree_hil.gap.estimation.nuisance import Nuisance

KEYS = ("a", "b", "c")
R = 0.98
TOGETHER = np.array([[1.0, R, 0.0], [R, 1.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("prior", [Prior(0.01, 0.5, 0.1, "log"), Prior(-0.2, 0.6, 0.1), Prior(0.01, 0.8, 0.1)])
def test_a_parameter_is_converted_to_u_and_back_and_never_through_zero(prior: Prior) -> None:
    free = free_parameter_from_prior("some.delay_s", prior, 0.0)
    assert free.value_from_u(0.0) == pytest.approx(prior.low) and free.value_from_u(1.0) == pytest.approx(prior.high)
    assert free.value_from_u(free.u_from_value(0.3)) == pytest.approx(0.3)
    if prior.low > 0.0:
        assert free.value_from_u(free.u_min) > 0.0


def problem(correlation: np.ndarray, *, known: bool) -> LeastSquaresProblem:
    return LeastSquaresProblem(
        cast(Any, None), [Nuisance(key, 0.0, 1.0) for key in KEYS], correlation, has_calibration_prior=known
    )


def test_well_known_combinations_have_joint_bounds_with_a_calibration_prior() -> None:
    (wall,) = problem(TOGETHER, known=True).joint_bounds(KEYS, ())
    assert abs(wall) == pytest.approx(abs(np.array([1.0, -1.0, 0.0])) / (2.0 * (1.0 - R)) ** 0.5)
    assert len(problem(TOGETHER, known=False).joint_bounds(KEYS, ())) == 0
    assert len(problem(np.eye(3), known=True).joint_bounds(KEYS, ())) == 0, (
        "no direction is known better than each number"
    )
    loose = TOGETHER.copy()
    loose[0, 1] = loose[1, 0] = 0.9 * (1.0 - MAX_JOINT_VARIANCE)
    assert len(problem(loose, known=True).joint_bounds(KEYS, ())) == 0


def test_a_free_parameter_has_no_joint_bound_and_keeps_its_column() -> None:
    free = (FreeParameter("b", 0.0, 1.0, False, 0.0, 0.0, 1.0),)
    walls = problem(TOGETHER, known=True).joint_bounds(("a", "c", "b"), free)
    assert walls.shape == (0, 3)
    more = problem(TOGETHER, known=True).joint_bounds(
        ("a", "b", "effect.x"), (FreeParameter("effect.x", 0.0, 1.0, False, 0.0, 0.0, 1.0),)
    )
    assert more.shape == (1, 3) and (more[:, 2] == 0.0).all() and (more[:, :2] != 0.0).all()
