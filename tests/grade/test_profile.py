"""The 42 metrics: each new formula against a value by hand, reasons where there is none, parts that make the whole."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.course import Course
from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec, WeightsSpec
from tunefree_hil.episode.recording import COLUMNS, Recording, make_recording
from tunefree_hil.episode.scenario import build_course
from tunefree_hil.grade.metrics import MetricScales
from tunefree_hil.grade.oscillation.report import METRIC_SIGNALS
from tunefree_hil.grade.profile import (
    NO_EXTRAS,
    NO_SWING,
    DriveExtras,
    MetricValue,
    ProfileSettings,
    combine_profiles,
    combine_values,
    planned_stops,
    profile_drive,
    summarise_series,
)
from tunefree_hil.grade.score import SCORE_METRICS, GradeVehicle, grade_drive
from tunefree_hil.grade.signals import FormulaContext
from tunefree_hil.grade.table import ASPECTS, HIGHLIGHTED, PUBLISHED, TABLE, Aggregation, MetricRow, names_by_aspect

DT_S = 0.01
CAR = GradeVehicle(2.8448, 1.4224, 8.0, 8.5, rest_pedal_frac=0.15)
HOWS: tuple[Aggregation, ...] = ("std", "peak", "share", "mean")
# series that look over more than one row: two halves lack what happens between them
OVER_ROWS = {"jerk_bad_sensation", "lateral_jerk_bad_sensation", "heading_acc_bad_sensation",
             "heading_jerk_bad_sensation", "pose_heading_offset_std", "pose_heading_offset_peak", "lateral_jerk_rms",
             "steer_rate_rms", "ending_station_err", "ending_lateral_err", "ending_heading_err",
             "longitudinal_jerk_rms", "pedal_rate_rms", *METRIC_SIGNALS,
             *(name for name in TABLE if "start" in name)}  # fmt: skip


def course(duration_s: float = 4.0, stop: bool = False) -> Course:
    """A bend with harsh curvature, braking harshly at the end where it stops."""
    times, speeds = ([0.0, 1.0, 3.0, duration_s], [4.0, 4.0, 0.0, 0.0]) if stop else ([0.0, duration_s], [4.0, 4.0])
    return build_course(
        ScenarioSpec(
            schema="tunefree.scenario/1",
            name="test",
            speed=ProfileSpec(t_s=times, value=speeds),
            curvature=ProfileSpec(t_s=[0.0, 0.5, 1.0], value=[0.0, 0.08, 0.08]),
        ),
        DT_S,
    )


def recording(rows: int = 400, seed: int = 1, **given: Any) -> Recording:
    """Every column, at random but `given`; no re-plan."""
    chance = np.random.default_rng(seed)
    columns = {name: chance.normal(0.0, 0.3, rows) for name in COLUMNS[2:]}
    columns |= {"ref_speed_mps": np.full(rows, 4.0), "ref_accel_mps2": chance.choice([0.0, -2.0], rows)}
    columns |= {"ref_curvature_1pm": chance.choice([0.0, 0.1], rows), "speed_mps": np.full(rows, 4.0)}
    columns |= {
        "cmd_brake_frac": chance.choice([0.15, 0.2], rows),
        "cmd_throttle_frac": chance.choice([0.15, 0.3], rows),
    }
    columns |= {"x_m": 0.04 * np.arange(rows), "y_m": np.zeros(rows), "replan": np.zeros(rows)}
    columns |= {name: np.broadcast_to(np.asarray(value, dtype=float), rows) for name, value in given.items()}
    return make_recording(columns, DT_S)


def values(
    of: Recording, plan: Course | None = None, beside: DriveExtras = NO_EXTRAS, **options: Any
) -> dict[str, MetricValue]:
    return profile_drive(of, plan or course(), CAR, ProfileSettings(**options), beside)


def test_the_source_has_42() -> None:
    assert len(PUBLISHED) == 42
    counts = {aspect: sum(name in PUBLISHED for name in names) for aspect, names in names_by_aspect().items()}
    assert tuple(counts) == ASPECTS
    assert list(counts.values()) == [18, 5, 6, 6, 2, 3, 2]
    assert set(SCORE_METRICS) <= set(TABLE) and set(HIGHLIGHTED) <= set(PUBLISHED)


def rms(value: float, n: int) -> float:
    return math.sqrt(value * value * n / (n - 1))


STEP = np.where(np.arange(400) < 200, 0.0, 1.0)
RAMP = np.arange(400) * DT_S
BY_HAND: list[tuple[str, dict[str, Any], float, int]] = [
    # e_y' / (C V L): 0.2 / (0.1 x 4 x 2.8448)
    ("lateral_err_rate_std", {"lateral_error_rate_mps": 0.2, "ref_curvature_1pm": 0.1}, rms(0.2 / 1.13792, 400), 400),
    ("lateral_err_rate_std_harsh", {"lateral_error_rate_mps": 0.2 * STEP, "ref_curvature_1pm": 0.1 * STEP},
     rms(0.2 / 1.13792, 200), 200),
    ("lateral_err_rate_peak", {"lateral_error_rate_mps": -0.4 * STEP}, 0.8, 400),
    ("acc_bad_sensation", {"accel_mps2": -4.0 * STEP}, 0.5, 400),
    # 3 m/s3 throughout; 1.9 m/s3 is not felt
    ("jerk_bad_sensation", {"accel_mps2": 3.0 * RAMP}, 1.0, 39),
    ("jerk_bad_sensation", {"accel_mps2": 1.9 * RAMP}, 0.0, 39),
    # 4 m/s x 1 rad/s
    ("lateral_acc_bad_sensation", {"yaw_rate_radps": -1.001 * STEP}, 0.5, 400),
    ("lateral_jerk_bad_sensation", {"yaw_rate_radps": 0.55 * RAMP}, 1.0, 39),
    ("heading_acc_bad_sensation", {"yaw_rate_radps": 3.2 * RAMP}, 1.0, 39),
    # the yaw rate's second derivative is 2 x 0.8
    ("heading_jerk_bad_sensation", {"yaw_rate_radps": 0.8 * RAMP * RAMP}, 1.0, 38),
    ("heading_jerk_bad_sensation", {"yaw_rate_radps": 0.7 * RAMP * RAMP}, 0.0, 38),
    ("throttle_control_usage", {"cmd_throttle_frac": 0.3}, rms(0.3, 400), 400),
    ("throttle_control_usage_harsh", {"cmd_throttle_frac": 0.3, "ref_accel_mps2": STEP}, rms(0.3, 200), 200),
    ("brake_control_usage", {"cmd_brake_frac": 0.2}, rms(0.2, 400), 400),
    ("brake_control_usage_harsh", {"cmd_brake_frac": 0.2, "ref_accel_mps2": -STEP}, rms(0.2, 200), 200),
    ("steering_control_usage_harsh", {"cmd_steer_rad": -4.0, "ref_curvature_1pm": -0.05 * STEP}, rms(0.5, 200), 200),
    # reported throttle while braking; 0.1549 is rest and rounding
    ("throttle_deadzone_mean", {"out_throttle_frac": 0.1 + 0.1 * STEP, "cmd_brake_frac": 0.1549 + 0.01 * STEP},
     0.2, 200),
    ("brake_deadzone_mean", {"out_brake_frac": 0.2 + 0.1 * STEP, "cmd_throttle_frac": 0.1549 + 0.01 * STEP},
     0.3, 200),
    ("replan_trajectory_count", {"replan": np.eye(1, 400, 399)[0]}, 1.0 / 400.0, 400),
    # 0.1 rad between the course (along x) and the heading
    ("pose_heading_offset_std", {"heading_rad": -0.1}, rms(0.1 / math.pi, 390), 390),
    ("pose_heading_offset_peak", {"heading_rad": -0.1 + 2.0 * math.pi}, 0.1 / math.pi, 390),
]  # fmt: skip


@pytest.mark.parametrize(("name", "columns", "expected", "n"), BY_HAND)
def test_by_hand(name: str, columns: dict[str, Any], expected: float, n: int) -> None:
    found = values(recording(**columns), against="current")[name]
    assert found.value == pytest.approx(expected) and (found.n, found.why) == (n, "")


def test_standing_still_has_no_course() -> None:
    found = values(recording(x_m=0.0, y_m=0.0))["pose_heading_offset_std"]
    assert found == MetricValue(None, 0, "no such samples in this drive")


def test_compute_time_and_control_errors() -> None:
    times = np.array([0.002] * 9 + [0.012])
    found = values(recording(), beside=DriveExtras(times, "control_error"))
    assert found["total_time_usage"].value == pytest.approx(math.sqrt((9 * 0.04 + 1.44) / 9))
    assert found["total_time_peak"].value == pytest.approx(1.2)
    assert found["total_time_exceeded_count"] == (0.1, 10, "")
    assert found["control_error_code_count"] == (1.0 / 400.0, 400, "")
    for harmless in ("", "left_lane", "diverged"):
        assert values(recording(), beside=DriveExtras(None, harmless))["control_error_code_count"].value == 0.0
    unknown = values(recording())
    assert unknown["control_error_code_count"].value is None and "bench log" in unknown["control_error_code_count"].why
    assert "compute times" in unknown["total_time_peak"].why


def stopping(station_m: np.ndarray, speed: np.ndarray, **more: Any) -> Recording:
    """A drive along the straight beginning of a course."""
    return recording(len(station_m), x_m=station_m, y_m=np.zeros(len(station_m)), speed_mps=speed, **more)


def test_endings() -> None:
    """Plan: 4 m/s for 1 s, then to 0 in 2 s: it stops at 8 m."""
    plan = build_course(
        ScenarioSpec(
            schema="tunefree.scenario/1",
            name="straight",
            speed=ProfileSpec(t_s=[0.0, 1.0, 3.0, 5.0], value=[4.0, 4.0, 0.0, 0.0]),
            curvature=ProfileSpec(t_s=[0.0, 5.0], value=[0.0, 0.0]),
        ),
        DT_S,
    )
    np.testing.assert_allclose(planned_stops(plan), [8.0])
    speed = np.concatenate([np.full(200, 4.0), np.zeros(50), np.full(50, 0.1), np.zeros(100)])
    error = np.linspace(0.0, 0.399, 400)
    near = stopping(np.full(400, 7.5), speed, station_error_m=error, lateral_error_m=error, heading_error_rad=error)
    found = values(near, plan)
    assert found["ending_station_err"] == (pytest.approx(0.2), 1, ""), "0.5 s of creep is the same standstill"
    assert found["ending_lateral_err"].value == pytest.approx(0.4)
    assert found["ending_heading_err"].value == pytest.approx(0.2 / 0.5236)
    apart = np.concatenate([np.full(100, 4.0), np.zeros(50), np.full(150, 0.1), np.zeros(100)])
    assert values(stopping(np.full(400, 7.5), apart, station_error_m=error), plan)["ending_station_err"].n == 2
    short = stopping(np.full(400, 6.9), speed, station_error_m=error)
    assert values(short, plan)["ending_station_err"].value is None, "more than 1 m to go"
    past = stopping(np.full(400, 9.5), speed, station_error_m=error)
    assert values(past, plan)["ending_station_err"].n == 1
    begins = stopping(np.full(400, 7.5), np.zeros(400), station_error_m=error)
    assert values(begins, plan)["ending_station_err"].n == 0, "it stood from the beginning"


def test_what_is_weighed_is_what_the_score_weighs() -> None:
    one, plan = recording(), course()
    for against, published in (("original", False), ("current", True)):
        weights = WeightsSpec(
            schema="tunefree.weights/1", name="t", against=against, as_published=published,  # type: ignore[arg-type]
            metrics={"lateral_err_peak": 1.0}, lane_half_width_m=1e9, divergence_heading_rad=1e9,
        )  # fmt: skip
        graded = grade_drive(one, plan, weights, CAR)
        found = values(one, plan, against=against, as_published=published)
        assert {name: found[name].value for name in SCORE_METRICS} == graded.metrics


@pytest.mark.parametrize("name", [name for name in TABLE if name not in METRIC_SIGNALS])
def test_a_missing_column_is_none_with_its_name(name: str) -> None:
    full = recording(1000, accel_mps2=np.zeros(1000))
    beside = DriveExtras(np.full(9, 0.001), "")
    for need in TABLE[name].needs:
        gone = {"station_m": "x_m"}.get(need, need)
        if gone in ("control_time_s", "control_error"):
            found = values(full)[name]
        else:
            rest = {key: column for key, column in full.columns.items() if key not in (gone, "t_s", "tick")}
            found = values(make_recording(rest, DT_S), beside=beside)[name]
            assert need in found.why or "plan" in found.why, found
        assert found.value is None and found.why


@pytest.mark.parametrize(
    ("name", "gone"),
    [
        ("oscillation_steer", ("cmd_steer_rad", "out_steer_rad")),
        ("oscillation_accel", ("accel_mps2",)),
        ("oscillation_throttle", ("cmd_throttle_frac",)),
        ("oscillation_brake", ("cmd_brake_frac",)),
        ("oscillation_speed", ("speed_mps",)),
        ("pedal_alternation", ("cmd_brake_frac",)),
    ],
)
def test_an_oscillation_without_its_signal_is_none(name: str, gone: tuple[str, ...]) -> None:
    full = recording(1000)
    rest = {key: column for key, column in full.columns.items() if key not in (*gone, "t_s", "tick")}
    assert values(full)[name].value is not None
    assert values(make_recording(rest, DT_S))[name] == MetricValue(None, 0, NO_SWING)
    assert values(recording(250))[name] == MetricValue(None, 0, NO_SWING), "too short"


numbers = st.lists(st.floats(-9.0, 9.0), min_size=5, max_size=30)


@given(st.sampled_from(HOWS), st.lists(numbers, min_size=1, max_size=5))
def test_parts_make_the_whole(how: Aggregation, parts: list[list[float]]) -> None:
    row = MetricRow("performance", how, "", (), limit=2.0)
    whole = summarise_series(row, np.array([value for part in parts for value in part]))
    combined = combine_values(how, [summarise_series(row, np.array(part)) for part in parts])
    assert combined.n == whole.n
    assert combined.value == pytest.approx(whole.value, rel=1e-9, abs=1e-12)


@given(st.integers(40, 360), st.integers(1, 1000))
def test_halves_of_a_drive_make_the_drive(row: int, seed: int) -> None:
    whole, plan = recording(seed=seed), course()
    halves = [make_recording({k: v[cut] for k, v in whole.columns.items() if k not in ("t_s", "tick")}, DT_S)
              for cut in (slice(None, row), slice(row, None))]  # fmt: skip
    expected = values(whole, plan, against="current", beside=DriveExtras(None, ""))
    parts = combine_profiles([values(half, plan, against="current", beside=DriveExtras(None, "")) for half in halves])
    for name in set(TABLE) - OVER_ROWS:
        if expected[name].value is None:
            assert parts[name].value is None
        else:
            assert parts[name].value == pytest.approx(expected[name].value), name
            assert parts[name].n == expected[name].n


def test_a_drive_without_the_metric_does_not_count() -> None:
    assert combine_values("mean", [MetricValue(None, 3, "few"), MetricValue(2.0, 10)]) == (2.0, 10, "")
    assert combine_values("std", [MetricValue(None, 3, "few"), MetricValue(None, 0, "none")]) == (None, 0, "few")


def test_formulas_leave_their_signals_alone() -> None:
    one = recording()
    before = {name: column.copy() for name, column in one.columns.items()}
    values(one)
    for name, column in before.items():
        np.testing.assert_array_equal(one.columns[name], column)


def test_a_recording_of_nothing_but_speed() -> None:
    bare = make_recording({"speed_mps": np.full(50, 3.0)}, DT_S)
    found = values(bare)
    assert all(value.value is None and value.why for value in found.values())
    assert FormulaContext(MetricScales(1.0, 1.0, 1.0, DT_S), 0.0, np.empty(0)).stops_m.size == 0
