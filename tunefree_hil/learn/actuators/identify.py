"""Identifies a by-wire channel: dead time, lag of order 1 or 2, rate limit, dead band, gain, offset (design D5).

The kernel that drives the bench is simulated on the recorded commands and held against the recorded outputs: a coarse
grid of dead time and lag first, then least squares. Order and rate limit are chosen by the error on held-out parts.
Where the rate limit was reached, dead time and lag are found again from what happened far from it.
What the logs cannot show keeps the data sheet's number, widened, and says why.

Which channels a vehicle's model has, and where the pairs of each come from: reports, or else the motion.

What logs cannot say of a by-wire channel: then the data sheet speaks, widened, with the reason.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from typing import Any

import numpy as np

from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.actuators.model import MOST_LAG_S, Scale, Shape, misses, value_at
from tunefree_hil.learn.actuators.samples import CHANNELS, Pairs, pairs_of, up_to_stops
from tunefree_hil.learn.actuators.samples_from_motion import Law, law_of, pairs_by_motion
from tunefree_hil.learn.actuators.search import (
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
from tunefree_hil.learn.data_sheet import ChannelSheet, asks_accel
from tunefree_hil.learn.drives.drive import Split
from tunefree_hil.learn.drives.smoothing import noise_of, quantum_of
from tunefree_hil.learn.estimate import NORMAL_95, ActuatorFit, Value, exactly, unknown

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


PEDALS_AND_WHEEL = ("throttle", "brake", "steer")


def channels_of(vehicle: VehicleSpec) -> list[str]:
    """The channels of a vehicle's model: what its plant takes, and what else it is commanded by."""
    needed = ("accel", "steer") if asks_accel(vehicle) else PEDALS_AND_WHEEL
    return [name for name in CHANNELS if name in needed or CHANNELS[name] in vehicle.command]


def sources(split: Split, channel: str, vehicle: VehicleSpec) -> tuple[Pairs, Pairs, Law | None]:
    """Training and held-out pairs of a channel; with a law where they are had from the motion, by it."""
    training, held_out = pairs_of(split.training, channel), pairs_of(split.held_out, channel)
    law = None if training.some or held_out.some else law_of(split.training, channel, vehicle)
    if law is None:
        return *up_to_stops(training, held_out), None
    return pairs_by_motion(split.training, law, vehicle), pairs_by_motion(split.held_out, law, vehicle), law


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
