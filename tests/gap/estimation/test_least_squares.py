"""Steps within bounds, and parameters on their scales."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from tunefree_hil.base.contracts import Prior
from tunefree_hil.gap.estimation.candidates import free_of
from tunefree_hil.gap.estimation.least_squares import TIGHT, Free, Problem
from tunefree_hil.gap.estimation.nuisance import Nuisance

KEYS = ("a", "b", "c")
R = 0.98
TOGETHER = np.array([[1.0, R, 0.0], [R, 1.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("prior", [Prior(0.01, 0.5, 0.1, "log"), Prior(-0.2, 0.6, 0.1), Prior(0.01, 0.8, 0.1)])
def test_a_parameter_goes_to_its_scale_and_back_and_never_through_nought(prior: Prior) -> None:
    free = free_of("some.delay_s", prior, 0.0)
    assert free.value(0.0) == pytest.approx(prior.low) and free.value(1.0) == pytest.approx(prior.high)
    assert free.value(free.place(0.3)) == pytest.approx(0.3)
    if prior.low > 0.0:
        assert free.value(free.least) > 0.0


def problem(correlation: np.ndarray, *, known: bool) -> Problem:
    return Problem(cast(Any, None), [Nuisance(key, 0.0, 1.0) for key in KEYS], correlation, known=known)


def test_what_numbers_come_to_together_has_walls_where_own_logs_told_it() -> None:
    (wall,) = problem(TOGETHER, known=True).walls(KEYS, ())
    assert abs(wall) == pytest.approx(abs(np.array([1.0, -1.0, 0.0])) / (2.0 * (1.0 - R)) ** 0.5)
    assert len(problem(TOGETHER, known=False).walls(KEYS, ())) == 0
    assert len(problem(np.eye(3), known=True).walls(KEYS, ())) == 0, "no direction is known better than each number"
    loose = TOGETHER.copy()
    loose[0, 1] = loose[1, 0] = 0.9 * (1.0 - TIGHT)
    assert len(problem(loose, known=True).walls(KEYS, ())) == 0


def test_what_is_free_has_no_wall_and_keeps_its_place() -> None:
    free = (Free("b", 0.0, 1.0, False, 0.0, 0.0, 1.0),)
    walls = problem(TOGETHER, known=True).walls(("a", "c", "b"), free)
    assert walls.shape == (0, 3)
    more = problem(TOGETHER, known=True).walls(
        ("a", "b", "effect.x"), (Free("effect.x", 0.0, 1.0, False, 0.0, 0.0, 1.0),)
    )
    assert more.shape == (1, 3) and (more[:, 2] == 0.0).all() and (more[:, :2] != 0.0).all()
