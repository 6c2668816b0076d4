"""Each metric against a value worked out by hand from docs/reference/apollo.md"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.episode.recording import make_recording
from tunefree_hil.grade.metrics import (
    METRICS,
    LaterRmsMetric,
    MetricSamples,
    MetricScales,
    PeakMetric,
    RmsMetric,
    SeriesMetric,
    StartMetric,
    compute_metric,
    peak,
    rms,
    samples_from_recording,
    start_ticks,
)
from tunefree_hil.grade.table import SUBSET_COLUMN

MKZ = MetricScales(wheelbase_m=2.8448, steer_rad=8.2, steer_rate_radps=8.55, dt_s=0.01)
ROWS = 6
SIGNED = [field for field in MetricSamples._fields if "error" in field or field in ("cmd_steer_rad", "yaw_rate_radps")]


def samples(**columns: Any) -> MetricSamples:
    """Six rows; what is not given is 0."""
    return MetricSamples(
        *(
            np.broadcast_to(np.asarray(columns.get(name, 0.0), dtype=float), ROWS).copy()
            for name in MetricSamples._fields
        )
    )


def spread(value: float) -> float:
    """RMS of six equal values: sqrt(6 s^2 / 5)."""
    return math.sqrt(6.0 * value * value / 5.0)


# name, columns of six rows, the value by hand
BY_HAND: list[tuple[str, dict[str, Any], float | None]] = [
    # e_s / (V x 1 s), v_ref >= 0.03; V is floored at 1 m/s
    ("station_err_std", {"station_error_m": 0.5, "ref_speed_mps": 5.0}, spread(0.1)),
    ("station_err_std", {"station_error_m": 0.5, "ref_speed_mps": 0.03}, spread(0.5)),
    ("station_err_std", {"station_error_m": 0.5, "ref_speed_mps": 0.029}, None),
    # same, |a_ref| >= 1, whatever the speed
    ("station_err_std_harsh", {"station_error_m": 0.5, "ref_speed_mps": 5.0, "ref_accel_mps2": -1.0}, spread(0.1)),
    ("station_err_std_harsh", {"station_error_m": 0.5, "ref_speed_mps": 5.0, "ref_accel_mps2": 0.99}, None),
    ("station_err_std_harsh", {"station_error_m": 0.5, "ref_speed_mps": 0.0, "ref_accel_mps2": 1.0}, spread(0.5)),
    # e_v / V
    ("speed_err_std", {"speed_error_mps": -0.4, "ref_speed_mps": 8.0}, spread(0.05)),
    ("speed_err_std_harsh", {"speed_error_mps": -0.4, "ref_speed_mps": 8.0, "ref_accel_mps2": 1.5}, spread(0.05)),
    # e_y / (C V L x 1 s): 0.1 / (0.1 x 5 x 2.8448); C is floored at 0.02852
    (
        "lateral_err_std",
        {"lateral_error_m": 0.1, "ref_curvature_1pm": -0.1, "ref_speed_mps": 5.0},
        spread(0.1 / 1.4224),
    ),
    ("lateral_err_std", {"lateral_error_m": 0.1, "ref_speed_mps": 5.0}, spread(0.1 / (0.02852 * 5.0 * 2.8448))),
    # same, |kappa| >= 0.05
    (
        "lateral_err_std_harsh",
        {"lateral_error_m": 0.1, "ref_curvature_1pm": -0.05, "ref_speed_mps": 4.0},
        spread(0.1 / (0.05 * 4.0 * 2.8448)),
    ),
    ("lateral_err_std_harsh", {"lateral_error_m": 0.1, "ref_curvature_1pm": 0.049, "ref_speed_mps": 4.0}, None),
    # e_th / (C V x 1 s)
    ("heading_err_std", {"heading_error_rad": 0.02, "ref_curvature_1pm": 0.1, "ref_speed_mps": 2.0}, spread(0.1)),
    ("heading_err_std_harsh", {"heading_error_rad": 0.02, "ref_curvature_1pm": 0.1, "ref_speed_mps": 2.0}, spread(0.1)),
    # e_th' / (C V)
    (
        "heading_err_rate_std",
        {"heading_error_rate_radps": 0.02, "ref_curvature_1pm": 0.1, "ref_speed_mps": 2.0},
        spread(0.1),
    ),
    (
        "heading_err_rate_std_harsh",
        {"heading_error_rate_radps": 0.02, "heading_error_rad": 9.0, "ref_curvature_1pm": 0.1, "ref_speed_mps": 2.0},
        spread(0.1),
    ),
    # max abs / threshold
    ("station_err_peak", {"station_error_m": [0, 0.1, -0.7, 0.3, 0, 0]}, 0.7),
    ("speed_err_peak", {"speed_error_mps": [0, 0.1, -0.25, 0.2, 0, 0]}, 0.5),
    ("lateral_err_peak", {"lateral_error_m": [0, 0.1, -0.279, 0.2, 0, 0]}, 0.558),
    ("heading_err_peak", {"heading_error_rad": [0, 0.1, -0.2618, 0.2, 0, 0]}, 0.5),
    ("heading_err_rate_peak", {"heading_error_rate_radps": [0, 0.1, -0.2618, 0.2, 0, 0]}, 0.5),
    # RMS of the rate / 8.55 rad/s: five steps of 0.0855 rad in 0.01 s
    ("steer_rate_rms", {"cmd_steer_rad": np.arange(6) * 0.0855}, math.sqrt(5.0 / 4.0)),
    # RMS(command / limit)
    ("steering_control_usage", {"cmd_steer_rad": -0.82}, spread(0.1)),
]


@pytest.mark.parametrize(("name", "columns", "expected"), BY_HAND)
def test_by_hand(name: str, columns: dict[str, Any], expected: float | None) -> None:
    found = compute_metric(name, samples(**columns), MKZ)
    assert found == (None if expected is None else pytest.approx(expected))


def test_every_metric_has_an_example_by_hand() -> None:
    in_windows = {"lateral_jerk_rms", "longitudinal_jerk_rms", "pedal_rate_rms"}
    of_the_start = {name for name in METRICS if "start" in name}  # test_start.py
    assert {name for name, _, _ in BY_HAND} | in_windows | of_the_start == set(METRICS)


def test_the_slip_of_the_source() -> None:
    """As written, heading_err_rate_std_harsh divides the heading error (6.1)."""
    rows = samples(heading_error_rate_radps=0.02, heading_error_rad=0.04, ref_curvature_1pm=0.1, ref_speed_mps=2.0)
    assert compute_metric("heading_err_rate_std_harsh", rows, MKZ, as_published=True) == pytest.approx(spread(0.2))
    for name in set(METRICS) - {"heading_err_rate_std_harsh"}:
        assert compute_metric(name, rows, MKZ, as_published=True) == compute_metric(name, rows, MKZ)


def test_the_denominator_is_n_minus_1() -> None:
    assert rms(np.array([1.0, 2.0, 3.0, 4.0, 5.0])) == pytest.approx(math.sqrt(55.0 / 4.0))


def test_only_the_samples_that_count_are_in_n() -> None:
    """5 of 6 samples are harsh: N = 5."""
    rows = samples(speed_error_mps=[9, 1, 1, 1, 1, 1], ref_speed_mps=1.0, ref_accel_mps2=[0, 1, 1, -1, -2, 1])
    assert compute_metric("speed_err_std_harsh", rows, MKZ) == pytest.approx(math.sqrt(5.0 / 4.0))


def test_lateral_jerk_of_a_ramp_and_of_noise() -> None:
    """v x yaw rate rising at 2 m/s3 scores 1; what alternates from tick to tick is noise of the sensor, not jerk."""
    time = np.arange(400) * 0.01
    still = np.full(400, 10.0)
    nothing = MetricSamples._make([None] * len(MetricSamples._fields))
    ramp = nothing._replace(speed_mps=still, yaw_rate_radps=0.2 * time)
    windows = 39
    assert compute_metric("lateral_jerk_rms", ramp, MKZ) == pytest.approx(math.sqrt(windows / (windows - 1)))
    noise = ramp._replace(yaw_rate_radps=0.01 * (-1.0) ** np.arange(400))
    assert compute_metric("lateral_jerk_rms", noise, MKZ) == pytest.approx(0.0, abs=1e-12)


def test_longitudinal_jerk_and_pedal_rate_of_ramps() -> None:
    """Acceleration rising at 2 m/s3 scores 1, and so does throttle or brake at 0.5 duty/s, whatever they rest at."""
    time = np.arange(400) * 0.01
    nothing = MetricSamples._make([None] * len(MetricSamples._fields))
    one = math.sqrt(39 / 38)
    assert compute_metric("longitudinal_jerk_rms", nothing._replace(accel_mps2=-2.0 * time), MKZ) == pytest.approx(one)
    for throttle, brake in ((0.15 + 0.5 * time, 0.15 + 0.0 * time), (0.15 + 0.0 * time, 0.15 + 0.5 * time)):
        pedals = nothing._replace(cmd_throttle_frac=throttle, cmd_brake_frac=brake)
        assert compute_metric("pedal_rate_rms", pedals, MKZ) == pytest.approx(one)


def test_fewer_than_five_samples_say_nothing() -> None:
    assert rms(np.ones(4)) is None
    assert peak(np.ones(4), 1.0) is None
    assert rms(np.ones(5)) is not None
    assert peak(np.array([1.0, 1.0, 1.0, 1.0, math.nan]), 1.0) is None


def test_samples_not_known_yet_do_not_count() -> None:
    rows = samples(lateral_error_m=[math.nan, 0.1, 0.1, 0.1, 0.1, 0.1], ref_speed_mps=[math.nan, 5, 5, 5, 5, 5])
    assert compute_metric("lateral_err_peak", rows, MKZ) == pytest.approx(0.2)
    assert compute_metric("lateral_err_std", rows, MKZ) == pytest.approx(
        math.sqrt(5 / 4) * 0.1 / (0.02852 * 5.0 * 2.8448)
    )


@pytest.mark.parametrize("name", METRICS)
def test_a_missing_column_gives_none_never_0(name: str) -> None:
    ticks = start_ticks(MKZ.dt_s) + 80
    still = {field: np.zeros(ticks) for field in MetricSamples._fields}
    moving = {"ref_speed_mps": 5.0, "ref_accel_mps2": 1.0, "ref_curvature_1pm": 0.1}
    full = MetricSamples(**still | {field: np.full(ticks, value) for field, value in moving.items()})
    row = METRICS[name]
    if isinstance(row, StartMetric):
        full = full._replace(lateral_error_m=0.2 * (np.arange(ticks) == 0))
    assert compute_metric(name, full, MKZ) == pytest.approx(0.0, abs=0.04)
    needed = {"lateral_error_m"}
    if isinstance(row, SeriesMetric):
        needed = set(row.needs)
    elif isinstance(row, (PeakMetric, LaterRmsMetric)):
        needed = {row.error}
    elif isinstance(row, RmsMetric):
        where = SUBSET_COLUMN
        needed = {row.error, "ref_speed_mps", where[row.subset]} | (
            {"ref_curvature_1pm"} if "C" in row.divisors else set()
        )
    for field in MetricSamples._fields:
        found = compute_metric(name, full._replace(**{field: None}), MKZ)
        assert (found is None) == (field in needed), field


columns = st.lists(st.floats(-5.0, 5.0), min_size=ROWS, max_size=ROWS)


@st.composite
def random_samples(draw: st.DrawFn) -> MetricSamples:
    rows = {name: np.array(draw(columns)) for name in MetricSamples._fields}
    rows["ref_speed_mps"] = np.abs(rows["ref_speed_mps"])
    rows["ref_curvature_1pm"] *= 0.02
    return MetricSamples(**rows)


@given(random_samples(), st.floats(0.1, 10.0))
def test_metrics_scale_with_the_errors(rows: MetricSamples, factor: float) -> None:
    """A drive with errors, steering and yaw rate `factor` times as large scores `factor` times as much."""
    larger = rows._replace(**{field: getattr(rows, field) * factor for field in SIGNED})
    for name in METRICS:
        one, other = compute_metric(name, rows, MKZ), compute_metric(name, larger, MKZ)
        assert (one is None) == (other is None)
        if one is not None and other is not None:
            assert other == pytest.approx(one * factor, rel=1e-9, abs=1e-12)


@given(random_samples())
def test_left_is_as_good_as_right(rows: MetricSamples) -> None:
    mirrored = rows._replace(**{field: -getattr(rows, field) for field in (*SIGNED, "ref_curvature_1pm")})
    for name in METRICS:
        assert compute_metric(name, mirrored, MKZ) == compute_metric(name, rows, MKZ)


@given(random_samples(), st.permutations(range(ROWS)))
def test_the_published_metrics_do_not_depend_on_order(rows: MetricSamples, order: list[int]) -> None:
    shuffled = MetricSamples(*(values[order] for values in rows if values is not None))
    for name in METRICS:
        if isinstance(METRICS[name], (RmsMetric, PeakMetric)):
            one, other = compute_metric(name, rows, MKZ), compute_metric(name, shuffled, MKZ)
            assert one == (None if other is None else pytest.approx(other))


def test_samples_are_columns_by_name() -> None:
    recording = make_recording({"lateral_error_m": np.arange(3.0), "x_m": np.zeros(3)}, 0.01)
    rows = samples_from_recording(recording)
    assert rows.lateral_error_m is recording.columns["lateral_error_m"]
    assert rows.station_error_m is None
