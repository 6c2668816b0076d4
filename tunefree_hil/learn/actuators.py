"""Identifies a by-wire channel: dead time, lag of order 1 or 2, rate limit, dead band, gain, offset (design D5).

The kernel that drives the bench is simulated on the recorded commands and held against the recorded outputs: a coarse
grid of dead time and lag first, then least squares. Order and rate limit are chosen by the error on held-out parts.
Where the rate limit was reached, dead time and lag are found again from what happened far from it.
What the logs cannot show keeps the data sheet's number, widened, and says why.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from typing import Any

import numpy as np

from tunefree_hil.learn.actuator_search import (
    BETTER,
    Case,
    Found,
    best_of,
    calmed,
    case_of,
    choose,
    disturbed,
    error_of,
    explained,
    fitted,
    starts_of,
)
from tunefree_hil.learn.actuator_shapes import Scale, Shape, misses, value_at
from tunefree_hil.learn.channel_doubts import (
    TIMES,
    at_least_0,
    doubted,
    from_sheet,
    judged,
    not_excited,
    unreached,
    wider,
)
from tunefree_hil.learn.pairs import Pairs
from tunefree_hil.learn.sheet import ChannelSheet
from tunefree_hil.learn.smooth import noise_of, quantum_of
from tunefree_hil.learn.values import NORMAL_95, ActuatorFit, Value, exactly

LEAST_SMALL_ROWS = 100  # about rest, for a dead band
SMALL_SHARE = 0.1  # of the span: what counts as about rest
# Of a tick: where between two ticks something happens only the bend of the output tells, and that is the form's word
# as much as the car's. No drive however long makes an interval of a time narrower than this to each side.
BETWEEN_TICKS = 0.1
MOST_UNKNOWN = 200.0  # an unknown that far off says nothing any more
FOLLOWS = 0.5  # share of the output's variance that the command must explain
PLAIN = (Shape(1, False), Shape(1, False, uneven=True), Shape(2, False))
EVEN = (Shape(1, False), Shape(2, False))  # where only the motion is seen, which is too little for more
LIMITED = (Shape(1, True), Shape(2, True))


def fit(training: Pairs, held_out: Pairs, sheet: ChannelSheet, echo: bool = True) -> Generator[Any, None, ActuatorFit]:
    """Identify one channel; yields (done, total) steps. echo: whether command and output come from one report.

    A channel that the logs do not move, or whose output does not follow, comes back as its data sheet has it.
    """
    why = not_excited(training)
    if why:
        return from_sheet(sheet, why)
    case = case_of(training, held_out, sheet)
    by_motion = any(pair.window for pair in training.some)
    shapes = EVEN if by_motion else (*PLAIN, *LIMITED)
    total = len(shapes) + 3
    yield 0, total
    starts = starts_of(case)
    if by_motion:
        case = disturbed(case, starts[0])
    candidates: list[Found] = []
    for i, shape in enumerate(shapes):
        yield i + 1, total
        candidates.append(best_of(case, shape, starts))
    chosen = choose(case, candidates)
    share = explained(case, chosen.way)
    if share < FOLLOWS:
        return from_sheet(sheet, f"the output does not follow the command (it explains {max(share, 0.0):.0%} of it)")
    rate = unreached(sheet, case.scale.rate)
    whole = case
    if chosen.shape.limited:
        rate = Value(chosen.way.params.rate_limit, *_ends(chosen, "rate_limit", case.scale))
        quiet = calmed(case, chosen)
        if quiet is not None:
            yield total - 2, total
            case, chosen = quiet, _again(quiet, chosen)
    yield total - 1, total
    chosen, band = _banded(case, chosen)
    yield total, total
    found = _as_fit(case, chosen, rate, band, training, whole)
    return found if echo else doubted(found, training.some[0].dt_s)


def _again(quiet: Case, limited: Found) -> Found:
    """Dead time and lag where no rate limit was near."""
    params = limited.way.params
    lag_s = params.lag_s if params.order == 1.0 else 1.0 / (math.pi * params.natural_hz)
    starts = [(params.dead_time_s, lag_s)]
    return choose(quiet, [best_of(quiet, shape, starts) for shape in PLAIN])


def _banded(case: Case, chosen: Found) -> tuple[Found, Value]:
    """With a dead band where the logs show one; and the dead band's value either way."""
    small = _small_rows(case)
    most = SMALL_SHARE * case.scale.span
    if small < LEAST_SMALL_ROWS:
        why = f"{small} reports of small commands off rest, {LEAST_SMALL_ROWS} are needed; neutral"
        return chosen, Value(0.0, 0.0, most, False, why)
    shape = chosen.shape._replace(banded=True)
    params = {**chosen.way.params._asdict(), "uneven": chosen.way.uneven}
    start = {name: params[name] for name in chosen.shape.names()}
    some = fitted(case, shape, {**start, "dead_band": 0.02 * case.scale.span})
    low, high = _ends(some, "dead_band", case.scale)
    if low > 0.0 and some.error < BETTER * chosen.error:
        return some, Value(some.way.params.dead_band, low, high)
    if high <= most:
        return chosen, Value(0.0, 0.0, max(high, 0.0), True, "none to be seen")
    return chosen, Value(0.0, 0.0, most, False, "small commands do not tell it from the offset; neutral")


def _small_rows(case: Case) -> int:
    """Reports whose command is about rest, but not at it."""
    rest, span = case.scale.rest, case.scale.span
    count = 0
    for pair in case.training:
        off = np.abs(pair.command - rest)
        count += int(np.sum(pair.counts & (off < SMALL_SHARE * span) & (off > 0.002 * span)))
    return count


def _as_fit(case: Case, chosen: Found, rate: Value, band: Value, pairs: Pairs, whole: Case) -> ActuatorFit:
    """The numbers as a model holds them. whole: all that is compared, the rate limit's neighbourhood too."""
    scale, shape, dt_s = case.scale, chosen.shape, case.training[0].dt_s
    even = chosen.way.even()
    found: dict[str, Value] = {}
    for name in shape.names():
        if name in ActuatorFit._fields:
            value = Value(getattr(chosen.way.params, name), *_ends(chosen, name, scale))
            if name in TIMES:
                value = at_least_0(wider(value, BETWEEN_TICKS * dt_s))
            found[name] = judged(name, value)
    found["dead_time_s"] = at_least_0(wider(found["dead_time_s"], NORMAL_95 * pairs.apart_s))
    output = np.concatenate([pair.output[pair.counts] for pair in case.training])
    quantum = quantum_of(output)
    found["offset"] = wider(found["offset"], 0.5 * quantum)
    lag = found.get("lag_s", exactly(0.0))
    if shape.order == 0:
        why = "shorter than the reports can tell from dead time"
        lag = Value(0.0, 0.0, 0.5 * dt_s, True, why)
        found["dead_time_s"] = at_least_0(wider(found["dead_time_s"], 0.5 * dt_s, why))
        if any(pair.window for pair in case.training):
            lag = Value(0.0, 0.0, found["dead_time_s"].high, False, "the motion does not tell it from dead time")
    elif shape.uneven:
        lag = _of_both_ways(chosen, lag)
    left = [misses(chosen.way, [pair], 1.0) for pair in case.training]  # without the corners that the output itself has
    noise = math.sqrt(float(np.mean([noise_of(one, quantum) ** 2 for one in left])))
    error = error_of(whole, even._replace(params=even.params._replace(rate_limit=rate.value))) * scale.sigma
    return ActuatorFit(
        found["dead_time_s"], max(shape.order, 1), lag, found.get("natural_hz", exactly(0.0)),
        found.get("damping", exactly(1.0)), rate, band, found["gain"], found["offset"], noise, quantum,
        error if case.held_out else math.nan, pairs.rows, pairs.words,
    )  # fmt: skip


def _of_both_ways(chosen: Found, lag: Value) -> Value:
    """The one lag that the bench's actuator has, of a channel that is quicker one way than the other."""
    turn, uneven = math.cosh(chosen.way.uneven), chosen.way.uneven
    up, down = (1e3 * lag.value * math.exp(sign * uneven) for sign in (1.0, -1.0))
    why = f"the mean of {up:.0f} ms upwards and {down:.0f} ms downwards"
    return Value(lag.value * turn, lag.low * turn, lag.high * turn, lag.known, why)


def _ends(found: Found, name: str, scale: Scale) -> tuple[float, float]:
    """A value's interval, in its own unit."""
    i = found.shape.names().index(name)
    low, high = found.least.interval(i)
    return value_at(name, max(low, -MOST_UNKNOWN), scale), value_at(name, min(high, MOST_UNKNOWN), scale)
