"""What a signal meets on its way, in steps of 1 ms: delays, lags, limits, play. All are identities when neutral."""

from __future__ import annotations

import math

from tools.gap_exam.fast import fast

STEP_S = 1e-3
STEPS_PER_S = 1000.0


@fast
def late(row, i, delay_s):
    """row as it was delay_s before step i, straight lines between steps; its first value before the beginning."""
    if delay_s <= 0.0:
        return row[i]
    place = i - delay_s * STEPS_PER_S
    if place <= 0.0:
        return row[0]
    whole = int(place)
    part = place - whole
    return row[whole] + part * (row[whole + 1] - row[whole])


@fast
def lagged(before, target, tau_s):
    """First-order lag, exact for a target that holds during the step."""
    if tau_s <= 0.0:
        return target
    return target + (before - target) * math.exp(-STEP_S / tau_s)


@fast
def held_rate(before, target, rate):
    """target, approached no faster than `rate` a second."""
    most = rate * STEP_S
    return min(max(target, before - most), before + most)


@fast
def without_band(x, half_width):
    """What is left of x beyond a dead band about 0."""
    if half_width <= 0.0:
        return x
    return math.copysign(max(abs(x) - half_width, 0.0), x)


@fast
def within(x, limit):
    """x between -limit and limit."""
    return min(max(x, -limit), limit)


@fast
def with_play(before, x, half_width):
    """The driven side of a loose joint: it rests until the driving side has crossed the gap."""
    if half_width <= 0.0:
        return x
    return min(max(before, x - half_width), x + half_width)


@fast
def stuck(before, x, level):
    """A positioner with dry friction: its spring pulls with the error, and it moves only by what exceeds the friction.

    The time constant of the yielding (4 ms) is far below what a log shows.
    """
    if level <= 0.0:
        return x
    pull = without_band(x - before, level)
    return before + pull * (1.0 - math.exp(-STEP_S / 0.004))


@fast
def oscillator(place, rate, target, natural_hz, damping):
    """A second-order lag, semi-implicit: (place, rate) after the step."""
    omega = 2.0 * math.pi * natural_hz
    rate = (rate + STEP_S * omega * omega * (target - place)) / (1.0 + 2.0 * damping * omega * STEP_S)
    return place + STEP_S * rate, rate
