"""A delay gives back what went in, n ticks later."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import run
from tunefree_hil.base.records import Command, Ins, Measurement, Report
from tunefree_hil.plant.actuation.delay import delay


@given(st.lists(st.floats(-1e6, 1e6), max_size=30), st.integers(0, 12))
def test_shifts_by_n(inputs: list[float], n: int) -> None:
    assert run(delay(n, 7.0), inputs, 0.01) == ([7.0] * n + inputs)[: len(inputs)]


def test_takes_any_record() -> None:
    first, later = (Measurement(Report(speed_mps=v), Ins(x_m=v)) for v in (1.0, 2.0))
    assert run(delay(1, first), [later, first], 0.01) == [first, later]
    assert run(delay(0, Command()), [Command(0.2)], 0.01) == [Command(0.2)]


def test_cannot_look_ahead() -> None:
    with pytest.raises(InputError):
        delay(-1, 0.0)
