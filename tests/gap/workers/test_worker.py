"""What a process that has a question open is asked, on a question made up."""

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


class Late:
    """Two drives of one target that misses its delay, s, times a slope; from 0.4 s on it is no car. The last row of
    the first drive may not be looked at.
    """

    SLOPES = (np.array([1.0, -1.0, 50.0]), np.array([2.0, -2.0]))

    def residuals(self, values: dict[str, float]) -> dict[str, list[np.ndarray]]:
        delay_s = values[KEY]
        if delay_s > 0.4:
            raise InputError("too late", code="no_such_effect", key=KEY)
        return {"steer": [slope * delay_s for slope in self.SLOPES], "brake": [np.zeros(3), np.zeros(2)]}

    def seen(self, name: str) -> list[np.ndarray]:
        return [np.array([True, True, False]), np.array([True, True])]


@pytest.fixture(autouse=True)
def opened() -> Iterator[None]:
    cast(Any, worker._questions)[TOKEN] = SimpleNamespace(work=Late())
    yield
    worker.forget(TOKEN)


@pytest.mark.parametrize("z", [0.2, 0.7])  # the second: to one side it is no car any more
def test_what_another_value_moves_of_each_signal(z: float) -> None:
    model = fitted(DELAY, z=z)  # of 0.5 s
    assert worker.moved_by(TOKEN, model, KEY, 0.12) == {
        "steer": pytest.approx(0.06 * 2.5**0.5),
        "brake": 0.0,
    }
