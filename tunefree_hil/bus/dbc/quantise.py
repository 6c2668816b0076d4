"""Quantises a value for a signal: wrap, scale, clip, round. Kernels, shared by codec and wire Block."""

from __future__ import annotations

import math

from tunefree_hil.base.kernel import kernel
from tunefree_hil.bus.dbc.message_map import TWO_PI

MOST_TURNS_RAD = 1.0e9  # an angle beyond is no angle: it is sent as raw 0, like NaN


@kernel
def rint(value: float) -> float:
    """The nearest whole number, halves to the even one, as Python's round. |value| below 2^52."""
    low = float(math.floor(value))
    rest = value - low
    if rest > 0.5:
        return low + 1.0
    if rest == 0.5:
        half = low / 2.0
        return low if float(math.floor(half)) == half else low + 1.0
    return low


@kernel
def wrap_turn(angle_rad: float, low_rad: float) -> float:
    """The same angle within [low_rad, low_rad + 2 pi); NaN for no angle."""
    if not abs(angle_rad) <= MOST_TURNS_RAD:
        return math.nan
    return angle_rad - TWO_PI * float(math.floor((angle_rad - low_rad) / TWO_PI))


@kernel
def to_raw(steps: float, low: float, high: float, turn: float) -> float:
    """Whole steps within [low, high]; 0 for NaN. turn > 0: an angle, which leaves one end and comes in at the other."""
    if steps != steps:
        return 0.0
    if turn > 0.0:
        if rint(steps) > high:
            steps = steps - turn
        elif rint(steps) < low:
            steps = steps + turn
    if steps < low:
        return low
    if steps > high:
        return high
    return rint(steps)
