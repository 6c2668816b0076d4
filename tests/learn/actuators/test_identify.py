"""Actuators: what is found, how sure it is, and what cannot be known."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.learn.made_drives import made_pairs
from tunefree_hil.learn.actuators.identify import BETWEEN_TICKS, fit, from_sheet, not_excited
from tunefree_hil.learn.actuators.model import Scale, Shape, Way, answered, bounds, params_at, value_at, vector
from tunefree_hil.learn.actuators.samples import Pair, Pairs, up_to_stops
from tunefree_hil.learn.compiled_process import Worker
from tunefree_hil.learn.data_sheet import ChannelSheet
from tunefree_hil.learn.estimate import ActuatorFit, Value
from tunefree_hil.plant.actuation.actuators import ActuatorParams

SHEET = ChannelSheet(0.0, 0.1, 0.08, 8.55, True)
MODULE = "tunefree_hil.learn.actuators.identify"


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    with Worker() as one:
        yield one


def found(worker: Worker, truth: ActuatorParams, seed: int, seconds: float = 90.0, **more: Any) -> ActuatorFit:
    training = made_pairs(truth, seconds, seed, **more)
    return worker.result(MODULE, "fit", training, made_pairs(truth, 20.0, seed + 100, **more), SHEET, True)


def test_unknowns_and_values_are_each_other() -> None:
    scale = Scale(0.15, 0.5, 2.0, 0.001)
    values = {
        "dead_time_s": 0.07,
        "natural_hz": 4.0,
        "damping": 0.6,
        "gain": 0.9,
        "offset": 0.01,
        "rate_limit": 1.5,
        "dead_band": 0.02,
    }
    shape = Shape(2, True, True)
    x = vector(shape, values, scale)
    assert {name: value_at(name, one, scale) for name, one in zip(shape.names(), x, strict=True)} == pytest.approx(
        values
    )
    low, high = bounds(shape, scale)
    assert (low < x).all() and (x < high).all()
    assert params_at(Shape(0, False), np.zeros(3), scale).params == ActuatorParams(rest=0.15)


def test_commands_that_never_move_are_named() -> None:
    still = Pair(np.full(2000, 0.15), np.full(2000, 0.15), np.ones(2000, dtype=bool), 0.01)
    assert "constant" in not_excited(Pairs("brake", (still,), ""))
    assert "no pairs" in not_excited(Pairs("brake", (), ""))
    few = still._replace(counts=np.arange(2000) < 20)
    assert "only 20 reports" in not_excited(Pairs("brake", (few,), ""))


def test_what_is_not_shown_is_the_data_sheets_and_wide() -> None:
    with pytest.raises(StopIteration) as end:
        next(fit(Pairs("brake", (), ""), Pairs("brake", (), ""), SHEET))
    plain = end.value.value
    assert plain == from_sheet(SHEET, "the logs hold no pairs of command and output")
    assert not plain.dead_time_s.known and plain.dead_time_s.value == 0.1 and plain.dead_time_s.high > 0.2
    assert "data sheet" in plain.words and plain.rate_limit.high == math.inf


@pytest.mark.slow
def test_no_drive_tells_a_time_better_than_a_tenth_of_a_tick(worker: Worker) -> None:
    one = found(worker, ActuatorParams(dead_time_s=0.085, lag_s=0.06), 5)  # no noise at all
    tenth = BETWEEN_TICKS * made_pairs(ActuatorParams(), 1.0, 1).some[0].dt_s
    for value in (one.dead_time_s, one.lag_s):
        assert value.low <= value.value - tenth and value.value + tenth <= value.high


@pytest.mark.slow
@pytest.mark.parametrize(
    "truth",
    [
        ActuatorParams(dead_time_s=0.085, lag_s=0.06),
        ActuatorParams(dead_time_s=0.03, lag_s=0.12, rate_limit=2.0, gain=0.96, offset=0.02),
        ActuatorParams(dead_time_s=0.112, order=2.0, natural_hz=2.5, damping=0.8),
        ActuatorParams(dead_time_s=0.05, lag_s=0.05, dead_band=0.03, rest=0.15, initial=0.15),
    ],
)
def test_the_truth_is_found(worker: Worker, truth: ActuatorParams) -> None:
    sheet = SHEET._replace(rest=truth.rest)
    seen = {"noise": 0.002, "quantum": 0.001}
    training, other = made_pairs(truth, 90.0, 5, **seen), made_pairs(truth, 20.0, 105, **seen)
    one = worker.result(MODULE, "fit", training, other, sheet, True)
    assert one.order == truth.order
    assert one.dead_time_s.value == pytest.approx(truth.dead_time_s, abs=0.0015)
    if truth.order == 1.0:
        assert one.lag_s.value == pytest.approx(truth.lag_s, rel=0.03)
    else:
        assert (one.natural_hz.value, one.damping.value) == pytest.approx((2.5, 0.8), rel=0.03)
    assert one.gain.value == pytest.approx(truth.gain, abs=0.004)
    assert one.offset.value == pytest.approx(truth.offset, abs=0.004)
    assert one.dead_band.value == pytest.approx(truth.dead_band, abs=0.004)
    assert one.noise == pytest.approx(0.002, rel=0.15) and one.quantum == pytest.approx(0.001)
    if math.isfinite(truth.rate_limit):
        assert one.rate_limit.known and one.rate_limit.value == pytest.approx(2.0, rel=0.02)
    else:
        assert not one.rate_limit.known and one.rate_limit.low > 1.0, "the fastest that was seen"


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say(worker: Worker) -> None:
    chance = np.random.default_rng(11)
    hits: dict[str, list[bool]] = {}
    for seed in range(10):
        truth = ActuatorParams(
            dead_time_s=float(chance.uniform(0.02, 0.2)),
            lag_s=float(chance.uniform(0.03, 0.2)),
            gain=float(chance.uniform(0.95, 1.05)),
            offset=float(chance.uniform(-0.02, 0.02)),
        )
        one = found(worker, truth, seed, 40.0, noise=0.005, quantum=0.001)
        for name, value in one.numbers().items():
            if name in ("dead_time_s", "lag_s", "gain", "offset") and value.known:
                hits.setdefault(name, []).append(value.low <= getattr(truth, name) <= value.high)
    every = [hit for some in hits.values() for hit in some]
    assert len(every) >= 36 and np.mean(every) >= 0.85, {name: np.mean(some) for name, some in hits.items()}


def stopping(truth: ActuatorParams, seconds: float, seed: int, by: float) -> Pairs:
    """A channel that obeys its commands, which go to 1.8, no further than its output reaches `by` to either side."""
    pairs = made_pairs(truth, seconds, seed, span=1.8)
    (asked,) = pairs.some
    low, high = ((end - truth.offset) / truth.gain for end in (-by, by))
    output = answered(Way(truth), np.clip(asked.command, low, high), asked.dt_s)
    output += 0.002 * np.random.default_rng(seed).standard_normal(len(output))
    return pairs._replace(some=(asked._replace(output=output),))


@pytest.mark.slow
def test_a_channel_that_stops_short_of_its_commands_is_known_by_what_it_could_obey(worker: Worker) -> None:
    truth = ActuatorParams(dead_time_s=0.085, lag_s=0.06, gain=0.94, offset=0.03)
    raw = stopping(truth, 90.0, 5, 1.0), stopping(truth, 20.0, 105, 1.0)
    one = worker.result(MODULE, "fit", *up_to_stops(*raw), SHEET, True)
    assert "it stops at a command of " in one.words and one.order == 1
    assert one.dead_time_s.value == pytest.approx(truth.dead_time_s, abs=0.0015)
    assert one.lag_s.value == pytest.approx(truth.lag_s, rel=0.03)
    assert one.gain.value == pytest.approx(truth.gain, abs=0.004)
    assert one.offset.value == pytest.approx(truth.offset, abs=0.004)
    taken = worker.result(MODULE, "fit", *raw, SHEET, True)
    assert taken.gain.value < truth.gain - 0.015, "with all that was asked for it seems to be a weaker channel"


@pytest.mark.slow
def test_a_lag_that_no_tick_shows_is_left_out(worker: Worker) -> None:
    one = found(worker, ActuatorParams(dead_time_s=0.03), 3, noise=0.001)
    assert one.lag_s.value == 0.0 and one.lag_s.known
    assert one.dead_time_s == Value(*one.dead_time_s) and one.dead_time_s.low <= 0.03 <= one.dead_time_s.high


@pytest.mark.slow
def test_an_output_that_does_not_follow_is_not_fitted(worker: Worker) -> None:
    pairs = made_pairs(ActuatorParams(lag_s=0.05), 60.0, 3, noise=0.002)
    turned = pairs._replace(some=tuple(one._replace(output=-one.output) for one in pairs.some))
    one = worker.result(MODULE, "fit", turned, turned, SHEET, True)
    assert not one.dead_time_s.known and "does not follow" in one.words


@pytest.mark.slow
def test_without_an_echo_it_is_wider(worker: Worker) -> None:
    pairs = made_pairs(ActuatorParams(dead_time_s=0.1, lag_s=0.05), 60.0, 3, noise=0.002)
    one = worker.result(MODULE, "fit", pairs, pairs, SHEET, False)
    assert one.dead_time_s.high - one.dead_time_s.low > 0.04 and "echo" in one.dead_time_s.why
