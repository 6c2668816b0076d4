"""The start of a drive: no metric after it contains it, and overshoot and settling are those of known responses."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.grade.metrics import METRICS, START, MetricSamples, MetricScales, compute_metric, start_ticks

MKZ = MetricScales(wheelbase_m=2.8448, steer_rad=8.2, steer_rate_radps=8.55, dt_s=0.01)
TICKS = 1000
T = np.arange(TICKS) * MKZ.dt_s
FIRST = start_ticks(MKZ.dt_s)
AFTER = [name for name in METRICS if name.endswith("_after_start")]
ERRORS = ("lateral_error_m", "station_error_m", "speed_error_mps", "heading_error_rad")
NOTHING = MetricSamples._make([None] * len(MetricSamples._fields))


def drive(**columns: Any) -> MetricSamples:
    """Errors of TICKS rows; what is not given is 0."""
    errors = {name: np.broadcast_to(np.asarray(columns.get(name, 0.0), dtype=float), TICKS).copy() for name in ERRORS}
    return NOTHING._replace(**errors)


def start(lateral_error_m: Any) -> tuple[float | None, float | None]:
    rows = drive(lateral_error_m=lateral_error_m)
    return compute_metric("start_overshoot", rows, MKZ), compute_metric("start_settling", rows, MKZ)


@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=FIRST), st.sampled_from(ERRORS), st.floats(0.0, 0.3))
def test_no_metric_after_the_start_contains_it(values: list[float], error: str, later: float) -> None:
    """Peaks and RMS of a drive are the same whatever happens during its start."""
    assert len(AFTER) == 8
    begun = np.zeros(FIRST)
    begun[: len(values)] = values
    wild = drive(**{error: np.concatenate([begun, np.full(TICKS - FIRST, later)])})
    calm = drive(**{error: np.concatenate([np.zeros(FIRST), np.full(TICKS - FIRST, later)])})
    for name in AFTER:
        assert compute_metric(name, wild, MKZ) == compute_metric(name, calm, MKZ)


@pytest.mark.parametrize("name", AFTER)
def test_what_comes_after_the_start_counts_from_its_first_tick_on(name: str) -> None:
    """One error of 0.1 in the first row, either way round."""
    error = next(column for column in ERRORS if column.startswith(name.split("_")[0]))
    values = np.zeros(TICKS)
    values[FIRST] = -0.1
    formula: Any = METRICS[name]
    if "peak" in name:
        expected = 0.1 / formula.threshold
    else:
        expected = 0.1 / formula.scale / math.sqrt(TICKS - FIRST - 1)
    assert compute_metric(name, drive(**{error: values}), MKZ) == pytest.approx(expected)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("damping", [0.2, 0.4, 0.7])
def test_overshoot_of_a_second_order_response(damping: float, side: float) -> None:
    """exp(-pi d / sqrt(1 - d^2)), and 0 without oscillation."""
    natural_radps = 3.0
    damped_radps = natural_radps * math.sqrt(1.0 - damping**2)
    decay = np.exp(-damping * natural_radps * T)
    response = decay * (np.cos(damped_radps * T) + damping * natural_radps / damped_radps * np.sin(damped_radps * T))
    overshoot, _ = start(0.2 * side * response)
    assert overshoot == pytest.approx(math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2)), abs=0.02)
    assert start(0.2 * side * np.exp(-3.0 * T))[0] == 0.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_settling_of_a_decay(side: float) -> None:
    """0.2 m exp(-2 t) is within 0.05 m after ln(4) / 2 s = 0.69 s; what comes back has not settled."""
    _, settling = start(0.2 * side * np.exp(-2.0 * T))
    assert settling == pytest.approx(math.log(4.0) / 2.0 / START.duration_s, abs=0.1 / START.duration_s)
    swinging = np.where(T < 2.0, 0.2 * np.exp(-2.0 * T), -0.06 * (T < 2.5))
    assert start(side * swinging)[1] == pytest.approx(2.5 / START.duration_s, abs=0.1 / START.duration_s)
    assert start(side * 0.2)[1] == 1.0
    assert start(side * 0.2 * (T < 0.05))[1] == pytest.approx(0.1 / START.duration_s)


def test_noise_is_no_overshoot_and_does_not_unsettle() -> None:
    chance = np.random.default_rng(1)
    overshoot, settling = start(0.2 * np.exp(-2.0 * T) + chance.normal(0.0, 0.009, TICKS))
    assert overshoot is not None and overshoot < 0.06
    assert settling == pytest.approx(0.69 / START.duration_s, abs=0.15 / START.duration_s)


def test_what_comes_later_is_no_part_of_the_start() -> None:
    settled = 0.2 * np.exp(-3.0 * T)
    assert start(settled) == start(np.where(np.arange(TICKS) < FIRST, settled, -1.0))


@pytest.mark.parametrize("first_m", [0.0, 0.99 * START.min_offset_m, math.nan])
def test_a_drive_that_starts_on_its_road_has_no_start(first_m: float) -> None:
    """Nor has one whose later error is large, or one without any position."""
    error = np.full(TICKS, math.nan) if math.isnan(first_m) else np.where(T == 0.0, first_m, -0.3)
    assert start(error) == (None, None)


def test_the_first_known_error_is_the_offset_and_a_cut_start_none() -> None:
    known_late = np.where(np.arange(TICKS) < 5, math.nan, 0.2)
    assert start(known_late) == (0.0, 1.0)
    cut = NOTHING._replace(lateral_error_m=np.full(FIRST - 1, 0.2))
    assert compute_metric("start_overshoot", cut, MKZ) is None and compute_metric("start_settling", cut, MKZ) is None
    assert all(compute_metric(name, cut, MKZ) is None for name in AFTER)
