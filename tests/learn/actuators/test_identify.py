"""Identified actuators: values, intervals, and what the logs do not show."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.learn.made_drives import made_pairs
from tunefree_hil.learn.actuators import identify
from tunefree_hil.learn.actuators.identify import IDENTIFICATION, excitation_problem, fit, fit_from_data_sheet
from tunefree_hil.learn.actuators.model import (
    ActuatorModel,
    ActuatorScale,
    ActuatorStructure,
    model_from_unknowns,
    simulate_commands,
    unknown_bounds,
    unknowns_from_values,
    value_from_unknown,
)
from tunefree_hil.learn.actuators.samples import ActuatorSamples, ChannelSamples, clip_to_stops
from tunefree_hil.learn.compiled_process import CompiledProcess
from tunefree_hil.learn.data_sheet import ChannelSheet
from tunefree_hil.learn.estimate import ActuatorFit, Estimate
from tunefree_hil.plant.actuation.actuators import ActuatorParams

SHEET = ChannelSheet(0.0, 0.1, 0.08, 8.55, True)


@pytest.fixture(scope="module")
def worker() -> Iterator[CompiledProcess]:
    with CompiledProcess() as process:
        yield process


def identify_made(
    worker: CompiledProcess, truth: ActuatorParams, seed: int, seconds: float = 90.0, **more: Any
) -> ActuatorFit:
    training = made_pairs(truth, seconds, seed, **more)
    return worker.wait_for_result(identify.fit, training, made_pairs(truth, 20.0, seed + 100, **more), SHEET, True)


def test_unknowns_and_values_are_each_other() -> None:
    scale = ActuatorScale(0.15, 0.5, 2.0, 0.001)
    values = {
        "dead_time_s": 0.07,
        "natural_hz": 4.0,
        "damping": 0.6,
        "gain": 0.9,
        "offset": 0.01,
        "rate_limit": 1.5,
        "dead_band": 0.02,
    }
    shape = ActuatorStructure(2, True, True)
    x = unknowns_from_values(shape, values, scale)
    assert {
        name: value_from_unknown(name, one, scale) for name, one in zip(shape.unknown_names(), x, strict=True)
    } == pytest.approx(values)
    low, high = unknown_bounds(shape, scale)
    assert (low < x).all() and (x < high).all()
    assert model_from_unknowns(ActuatorStructure(0, False), np.zeros(3), scale).params == ActuatorParams(rest=0.15)


def test_commands_that_never_move_are_named() -> None:
    still = ActuatorSamples(np.full(2000, 0.15), np.full(2000, 0.15), np.ones(2000, dtype=bool), 0.01)
    assert "constant" in excitation_problem(ChannelSamples("brake", (still,), ""))
    assert "no samples" in excitation_problem(ChannelSamples("brake", (), ""))
    few = still._replace(is_compared=np.arange(2000) < 20)
    assert "only 20 reports" in excitation_problem(ChannelSamples("brake", (few,), ""))


def test_what_is_not_shown_is_the_data_sheets_and_wide() -> None:
    with pytest.raises(StopIteration) as end:
        next(fit(ChannelSamples("brake", (), ""), ChannelSamples("brake", (), ""), SHEET))
    plain = end.value.value
    assert plain == fit_from_data_sheet(SHEET, "the logs hold no samples of both command and output")
    assert not plain.dead_time_s.known and plain.dead_time_s.value == 0.1 and plain.dead_time_s.high > 0.2
    assert "data sheet" in plain.report and plain.rate_limit.high == math.inf


@pytest.mark.slow
def test_no_drive_tells_a_time_better_than_a_tenth_of_a_tick(worker: CompiledProcess) -> None:
    result = identify_made(worker, ActuatorParams(dead_time_s=0.085, lag_s=0.06), 5)  # no noise at all
    tenth = IDENTIFICATION.time_resolution_ticks * made_pairs(ActuatorParams(), 1.0, 1).segments[0].dt_s
    for value in (result.dead_time_s, result.lag_s):
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
def test_the_truth_is_found(worker: CompiledProcess, truth: ActuatorParams) -> None:
    sheet = SHEET._replace(rest=truth.rest)
    seen = {"noise": 0.002, "quantum": 0.001}
    training, held_out = made_pairs(truth, 90.0, 5, **seen), made_pairs(truth, 20.0, 105, **seen)
    result = worker.wait_for_result(identify.fit, training, held_out, sheet, True)
    assert result.order == truth.order
    assert result.dead_time_s.value == pytest.approx(truth.dead_time_s, abs=0.0015)
    if truth.order == 1.0:
        assert result.lag_s.value == pytest.approx(truth.lag_s, rel=0.03)
    else:
        assert (result.natural_hz.value, result.damping.value) == pytest.approx((2.5, 0.8), rel=0.03)
    assert result.gain.value == pytest.approx(truth.gain, abs=0.004)
    assert result.offset.value == pytest.approx(truth.offset, abs=0.004)
    assert result.dead_band.value == pytest.approx(truth.dead_band, abs=0.004)
    assert result.noise == pytest.approx(0.002, rel=0.15) and result.quantum == pytest.approx(0.001)
    if math.isfinite(truth.rate_limit):
        assert result.rate_limit.known and result.rate_limit.value == pytest.approx(2.0, rel=0.02)
    else:
        assert not result.rate_limit.known and result.rate_limit.low > 1.0, "the fastest that was seen"


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say(worker: CompiledProcess) -> None:
    chance = np.random.default_rng(11)
    hits: dict[str, list[bool]] = {}
    for seed in range(10):
        truth = ActuatorParams(
            dead_time_s=float(chance.uniform(0.02, 0.2)),
            lag_s=float(chance.uniform(0.03, 0.2)),
            gain=float(chance.uniform(0.95, 1.05)),
            offset=float(chance.uniform(-0.02, 0.02)),
        )
        result = identify_made(worker, truth, seed, 40.0, noise=0.005, quantum=0.001)
        for name, value in result.estimates().items():
            if name in ("dead_time_s", "lag_s", "gain", "offset") and value.known:
                hits.setdefault(name, []).append(value.low <= getattr(truth, name) <= value.high)
    all_hits = [hit for some in hits.values() for hit in some]
    assert len(all_hits) >= 36 and np.mean(all_hits) >= 0.85, {name: np.mean(some) for name, some in hits.items()}


def stopping(truth: ActuatorParams, seconds: float, seed: int, stop: float) -> ChannelSamples:
    """A channel whose output stops at +-stop, while its commands go to 1.8."""
    samples = made_pairs(truth, seconds, seed, span=1.8)
    (segment,) = samples.segments
    low, high = ((end - truth.offset) / truth.gain for end in (-stop, stop))
    output = simulate_commands(ActuatorModel(truth), np.clip(segment.command, low, high), segment.dt_s)
    output += 0.002 * np.random.default_rng(seed).standard_normal(len(output))
    return samples._replace(segments=(segment._replace(output=output),))


@pytest.mark.slow
def test_a_channel_that_stops_short_of_its_commands_is_known_by_what_it_could_obey(worker: CompiledProcess) -> None:
    truth = ActuatorParams(dead_time_s=0.085, lag_s=0.06, gain=0.94, offset=0.03)
    raw = stopping(truth, 90.0, 5, 1.0), stopping(truth, 20.0, 105, 1.0)
    result = worker.wait_for_result(identify.fit, *clip_to_stops(*raw), SHEET, True)
    assert "it stops at a command of " in result.report and result.order == 1
    assert result.dead_time_s.value == pytest.approx(truth.dead_time_s, abs=0.0015)
    assert result.lag_s.value == pytest.approx(truth.lag_s, rel=0.03)
    assert result.gain.value == pytest.approx(truth.gain, abs=0.004)
    assert result.offset.value == pytest.approx(truth.offset, abs=0.004)
    unclipped = worker.wait_for_result(identify.fit, *raw, SHEET, True)
    assert unclipped.gain.value < truth.gain - 0.015, "with all that was asked for it seems to be a weaker channel"


@pytest.mark.slow
def test_a_lag_that_no_tick_shows_is_left_out(worker: CompiledProcess) -> None:
    result = identify_made(worker, ActuatorParams(dead_time_s=0.03), 3, noise=0.001)
    assert result.lag_s.value == 0.0 and result.lag_s.known
    assert (
        result.dead_time_s == Estimate(*result.dead_time_s)
        and result.dead_time_s.low <= 0.03 <= result.dead_time_s.high
    )


@pytest.mark.slow
def test_an_output_that_does_not_follow_is_not_fitted(worker: CompiledProcess) -> None:
    samples = made_pairs(ActuatorParams(lag_s=0.05), 60.0, 3, noise=0.002)
    turned = samples._replace(segments=tuple(one._replace(output=-one.output) for one in samples.segments))
    result = worker.wait_for_result(identify.fit, turned, turned, SHEET, True)
    assert not result.dead_time_s.known and "does not follow" in result.report


@pytest.mark.slow
def test_without_an_echo_it_is_wider(worker: CompiledProcess) -> None:
    samples = made_pairs(ActuatorParams(dead_time_s=0.1, lag_s=0.05), 60.0, 3, noise=0.002)
    result = worker.wait_for_result(identify.fit, samples, samples, SHEET, False)
    assert result.dead_time_s.high - result.dead_time_s.low > 0.04 and "echo" in result.dead_time_s.why
