"""Functions of a worker process, on a made problem."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.gap.estimation.test_intervals import DELAY, fitted
from tunefree_hil.base.errors import InputError
from tunefree_hil.gap.workers import worker

TOKEN, KEY = "made up", DELAY.key


class DelayModel:
    """Two drives; the residual of one target is its delay, s, times a slope; above 0.4 s it is no possible car.

    The last row of the first drive is a holdout row.
    """

    SLOPES = (np.array([1.0, -1.0, 50.0]), np.array([2.0, -2.0]))

    def simulate_residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        delay_s = values[KEY]
        if delay_s > 0.4:
            raise InputError("too late", code="no_such_effect", key=KEY)
        return {"steer": [slope * delay_s for slope in self.SLOPES], "brake": [np.zeros(3), np.zeros(2)]}

    def non_holdout_rows(self, name: str) -> list[np.ndarray]:
        return [np.array([True, True, False]), np.array([True, True])]


@pytest.fixture(autouse=True)
def opened() -> Iterator[None]:
    cast(Any, worker._open_problems)[TOKEN] = SimpleNamespace(residual_model=DelayModel())
    yield
    worker.close_problem(TOKEN)


@pytest.mark.parametrize("z", [0.2, 0.7])  # the second: one side is no possible car
def test_the_change_of_each_signal_when_a_parameter_moves(z: float) -> None:
    model = fitted(DELAY, z=z)  # of 0.5 s
    assert worker.measure_sensitivity(TOKEN, model, KEY, 0.12) == {
        "steer": pytest.approx(0.06 * 2.5**0.5),
        "brake": 0.0,
    }
