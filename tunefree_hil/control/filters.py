"""Linear filters as kernels; coefficients are computed at build time (bilinear transform)."""

from __future__ import annotations

import math
from typing import NamedTuple

from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.control.contract import LeadLag


class SecondOrder(NamedTuple):
    """y[k] = b0 x[k] + b1 x[k-1] + b2 x[k-2] - a1 y[k-1] - a2 y[k-2]."""

    b0: float
    b1: float
    b2: float
    a1: float
    a2: float


class SecondOrderState(NamedTuple):
    """The two delays of the transposed direct form II."""

    z1: float
    z2: float


class FirstOrder(NamedTuple):
    """w[k] = x[k] - a1 w[k-1], limited to +/- limit; y[k] = b0 w[k] + b1 w[k-1]."""

    b0: float
    b1: float
    a1: float
    limit: float


def butterworth(cutoff_hz: float, dt_s: float) -> SecondOrder:
    """Low-pass of second order, wc^2 / (s^2 + sqrt(2) wc s + wc^2), bilinear *without* pre-warp
    (docs/reference/apollo.md).

    Its -3 dB point therefore lies slightly below `cutoff_hz` (9.69 Hz for 10 Hz at 10 ms).
    """
    warp = 0.5 * dt_s * 2.0 * math.pi * cutoff_hz
    square, lean = warp * warp, math.sqrt(2.0) * warp
    scale = 1.0 / (1.0 + lean + square)
    return SecondOrder(
        square * scale,
        2.0 * square * scale,
        square * scale,
        2.0 * (square - 1.0) * scale,
        (1.0 - lean + square) * scale,
    )


def butterworth_delay_s(cutoff_hz: float) -> float:
    """Delay of slow signals in that low-pass: sqrt(2) / (2 pi cutoff), 22.5 ms at 10 Hz."""
    return math.sqrt(2.0) / (2.0 * math.pi * cutoff_hz)


@kernel
def second_order_step(filt: SecondOrder, state: SecondOrderState, value: float) -> tuple[SecondOrderState, float]:
    """One sample."""
    out = filt.b0 * value + state.z1
    return SecondOrderState(filt.b1 * value - filt.a1 * out + state.z2, filt.b2 * value - filt.a2 * out), out


def first_order(lead_lag: LeadLag, dt_s: float) -> FirstOrder:
    """beta (tau s + 1)/(alpha tau s + 1) by Tustin; tau = 0 is the plain gain beta."""
    top, bottom = 2.0 * lead_lag.tau_s / dt_s, 2.0 * lead_lag.alpha * lead_lag.tau_s / dt_s
    if lead_lag.tau_s == 0.0:
        return FirstOrder(lead_lag.beta, 0.0, 0.0, lead_lag.state_limit)
    scale = lead_lag.beta / (1.0 + bottom)
    return FirstOrder(scale * (1.0 + top), scale * (1.0 - top), (1.0 - bottom) / (1.0 + bottom), lead_lag.state_limit)


@kernel
def first_order_step(filt: FirstOrder, inner: float, value: float) -> tuple[float, float]:
    """(inner state, output): direct form II with a limited state."""
    output = clamp(value - filt.a1 * inner, -filt.limit, filt.limit)
    return output, filt.b0 * output + filt.b1 * inner
