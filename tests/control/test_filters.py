"""Filters against scipy.signal and by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy.signal

from tunefree_hil.control.contract import LeadLag
from tunefree_hil.control.filters import SecondOrderState, butterworth, first_order, first_order_step, second_order_step

signal: Any = scipy.signal  # its stubs do not know which form is returned


@pytest.mark.parametrize(("cutoff_hz", "dt_s"), [(10.0, 0.01), (5.0, 0.01), (2.0, 0.02)])
def test_butterworth_equals_scipy(cutoff_hz, dt_s):
    wc = 2.0 * math.pi * cutoff_hz
    top, bottom = signal.butter(2, wc, analog=True)
    b, a = signal.bilinear(top, bottom, fs=1.0 / dt_s)  # no pre-warp
    filt = butterworth(cutoff_hz, dt_s)
    assert np.allclose([filt.b0, filt.b1, filt.b2], b / a[0], rtol=1e-12)
    assert np.allclose([1.0, filt.a1, filt.a2], a / a[0], rtol=1e-12)
    values = np.random.default_rng(1).normal(size=300)
    state, out = SecondOrderState(0.0, 0.0), []
    for value in values.tolist():
        state, y = second_order_step(filt, state, value)
        out.append(y)
    assert np.allclose(out, signal.lfilter(b, a, values), atol=1e-12)


def test_cutoff_lies_where_the_docstring_says():
    filt = butterworth(10.0, 0.01)
    hz, gain = signal.freqz([filt.b0, filt.b1, filt.b2], [1.0, filt.a1, filt.a2], worN=20000, fs=100.0)
    assert hz[np.argmin(np.abs(np.abs(gain) - math.sqrt(0.5)))] == pytest.approx(9.69, abs=0.01)


def test_lead_lag():
    lead_lag = LeadLag(weight=1.0, alpha=4.0, beta=2.0, tau_s=0.1)
    filt = first_order(lead_lag, 0.01)
    b, a = signal.bilinear([2.0 * 0.1, 2.0], [0.4, 1.0], fs=100.0)
    assert np.allclose([filt.b0, filt.b1, filt.a1], [b[0], b[1], a[1]])
    inner = 0.0
    for _ in range(500):
        inner, out = first_order_step(filt, inner, 1.5)
    assert out == pytest.approx(3.0, rel=1e-3)
    assert first_order_step(first_order(LeadLag(), 0.01), 0.0, 0.7)[1] == 0.7


def test_lead_lag_state_is_limited():
    filt = first_order(LeadLag(1.0, 4.0, 1.0, 0.1, state_limit=1.0), 0.01)
    assert first_order_step(filt, 0.0, 50.0)[0] == 1.0
