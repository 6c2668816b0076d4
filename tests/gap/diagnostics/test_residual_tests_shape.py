"""How a residual is put into words: late, weak, off."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.gap.diagnostics.residual_tests import fit_shape

DT_S, N = 0.05, 3000


def signal(at_s: np.ndarray) -> np.ndarray:
    return np.sin(0.9 * at_s) + 0.4 * np.sin(2.3 * at_s + 1.0) + 0.2 * np.sin(5.1 * at_s)


def test_what_is_late_weak_and_off_is_said_so() -> None:
    at_s = np.arange(N) * DT_S
    made, truth = signal(at_s), 0.8 * signal(at_s - 0.31) + 0.1
    valid = np.ones(N, dtype=bool)
    valid[:20] = valid[-20:] = False
    shape = fit_shape([made - truth], [truth], [valid], DT_S)
    assert shape is not None
    assert shape.late_s == pytest.approx(0.31, abs=0.005)
    assert shape.gain == pytest.approx(0.8, abs=0.01) and shape.bias == pytest.approx(0.1, abs=0.01)
    assert shape.text(1.0) == "0.31 s late, 20% weak, +0.1 off"


def test_of_a_signal_that_agrees_nothing_is_said() -> None:
    at_s = np.arange(N) * DT_S
    noise = 0.001 * np.random.default_rng(1).standard_normal(N)
    shape = fit_shape([noise], [signal(at_s)], [np.ones(N, dtype=bool)], DT_S)
    assert shape is not None and shape.text(1.0) == ""
