"""What logs cannot say of a by-wire channel: then the data sheet speaks, widened, with the reason."""

from __future__ import annotations

import math

import numpy as np

from tunefree_hil.learn.actuator_shapes import MOST_LAG_S
from tunefree_hil.learn.pairs import Pairs
from tunefree_hil.learn.sheet import ChannelSheet
from tunefree_hil.learn.smooth import quantum_of
from tunefree_hil.learn.values import ActuatorFit, Value, exactly, unknown

LEAST_ROWS = 300
LEAST_CHANGES = 8  # of the command by 2 % of its span, from which on a channel counts as excited
TIMES = ("dead_time_s", "lag_s")
LOOSE_S, LOOSE_FACTOR = 0.1, 10.0  # an interval so wide says next to nothing
MOST_TOLD = 1e3
AT_THE_END = 0.95  # of the longest lag that is looked for
LOOK_S = 0.2  # between two looks: a ramp is a change too


def not_excited(pairs: Pairs) -> str:
    """Why these pairs cannot identify a channel, '' where they can."""
    if not pairs.some:
        return "the logs hold no pairs of command and output"
    if pairs.rows < LEAST_ROWS:
        return f"only {pairs.rows} reports to compare, {LEAST_ROWS} are needed"
    command = np.concatenate([pair.command for pair in pairs.some])
    span = float(np.ptp(command))
    step = max(quantum_of(command), 1e-9)
    looks = [pair.command[:: max(round(LOOK_S / pair.dt_s), 1)] for pair in pairs.some]
    changes = sum(int(np.sum(np.abs(np.diff(one)) > 0.02 * span)) for one in looks)
    if span <= 5.0 * step or changes < LEAST_CHANGES:
        low, high = float(command.min()), float(command.max())
        return f"its command is constant, or nearly ({low:.4g} to {high:.4g}, {changes} changes)"
    return ""


def from_sheet(sheet: ChannelSheet, why: str) -> ActuatorFit:
    """A channel by its data sheet, widened."""
    reason = f"{why}; {'data sheet' if sheet.stated else 'nothing stated, neutral'}"

    def wide(value: float, low: float, high: float) -> Value:
        return Value(value, low, high, False, reason)

    dead_s, lag_s, rate = sheet.dead_time_s, sheet.lag_s, sheet.rate_limit
    return ActuatorFit(
        wide(dead_s, 0.0, 2.0 * dead_s + 0.1),
        1,
        wide(lag_s, 0.0, 2.0 * lag_s + 0.1),
        exactly(0.0),
        exactly(1.0),
        wide(rate, 0.5 * rate if math.isfinite(rate) else 0.0, math.inf),
        wide(0.0, 0.0, 0.02),
        wide(1.0, 0.9, 1.1),
        wide(0.0, -0.02, 0.02),
        words=reason,
    )


def unreached(sheet: ChannelSheet, seen: float) -> Value:
    """A rate limit that the drives never reached: the data sheet's, unless the output was seen to be faster."""
    why = f"never reached: the output moved {seen:.3g} per s at most"
    if sheet.rate_limit >= seen and math.isfinite(sheet.rate_limit):
        return unknown(sheet.rate_limit, f"{why}; data sheet", low=seen, high=math.inf)
    return unknown(math.inf, f"{why}; none stated", low=seen, high=math.inf)


def judged(name: str, value: Value) -> Value:
    """The value, called unknown where its interval says next to nothing; its number is then still the best guess."""
    low, high = max(value.low, 0.0 if name in TIMES else value.low), value.high
    if name == "dead_time_s":
        hardly = high - low > 2.0 * LOOSE_S
    elif name in ("lag_s", "natural_hz", "damping"):
        hardly = high > LOOSE_FACTOR * max(low, 1e-9) and high > LOOSE_S
    else:
        return value
    if not hardly:
        return value
    return Value(value.value, low, min(high, MOST_TOLD), False, "these logs hardly show it")


def wider(value: Value, by: float, why: str = "") -> Value:
    """The same value with an interval wider to both sides."""
    return value._replace(low=value.low - by, high=value.high + by, why=why or value.why)


def at_least_0(value: Value) -> Value:
    """The same value, its interval not below 0."""
    return value._replace(low=max(value.low, 0.0))


def in_motion(found: ActuatorFit, sheet: ChannelSheet) -> ActuatorFit:
    """A channel of which only the motion was seen: what a command is worth is the plant's, the lag may be the car's.

    Where the motion shows neither dead time nor lag, the data sheet's stand, wider by what the motion leaves open.
    """
    if not _timed(found):
        return from_sheet(sheet, "the motion hardly shows it, and no output is reported")
    why = "seen in the motion only: what a command is worth is fitted as a constant of the plant"
    lag_why = "seen in the motion only: it holds the car's own answer too"
    times: dict[str, Value] = {}
    if found.order == 1:
        times["lag_s"] = found.lag_s._replace(low=0.0, why=found.lag_s.why or lag_why)
    else:
        times["natural_hz"] = found.natural_hz._replace(high=MOST_TOLD, why=found.natural_hz.why or lag_why)
    return found._replace(
        rate_limit=Value(math.inf, 0.0, math.inf, False, why),
        dead_band=exactly(0.0, why),
        gain=exactly(1.0, why),
        offset=exactly(0.0, why),
        **times,
    )


def _timed(found: ActuatorFit) -> bool:
    """Whether the motion tells one of a channel's times. A lag as long as any that is looked for is none: a car whose
    command hardly moves changes by itself as slowly.
    """
    lag = found.lag_s if found.order == 1 else found.natural_hz
    longest = found.order == 1 and found.lag_s.value > AT_THE_END * MOST_LAG_S
    return not longest and (found.dead_time_s.known or lag.known)


def doubted(found: ActuatorFit, dt_s: float) -> ActuatorFit:
    """Without an echo a tick either way on the bus is not known."""
    why = "without an echo of the command the bus's own delay is taken for the bench's, give or take a tick each way"
    dead = at_least_0(wider(found.dead_time_s, 2.0 * dt_s, why))
    return found._replace(dead_time_s=dead)
