"""From metrics to one number: eq. 7, re-plans, failures, and that ending early never pays."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from tests.house import ROOT
from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_weights
from tunefree_hil.config.schema import LimitsSpec, NominalSpec, ProfileSpec, ScenarioSpec, VehicleSpec, WeightsSpec
from tunefree_hil.episode.recording import Recording, make_recording
from tunefree_hil.episode.scenario import build_course
from tunefree_hil.grade.score import (
    SCORE_METRICS,
    GradeVehicle,
    ScenarioEnd,
    ScenarioGrade,
    combine_scores,
    grade_drive,
    grade_vehicle_from_spec,
    weighted_mean,
)
from tunefree_hil.grade.table import COMFORT, EFFORT, PERFORMANCE, SAFETY, TABLE

MKZ = GradeVehicle(2.8448, 1.4224, 8.20305, 8.55211)
DT_S = 0.01
PUBLISHED = {  # docs/reference/apollo.md
    "station_err_std": 1, "speed_err_std": 1, "lateral_err_std": 3, "heading_err_std": 1, "heading_err_rate_std": 2,
    "station_err_std_harsh": 1, "speed_err_std_harsh": 1, "lateral_err_std_harsh": 4, "heading_err_std_harsh": 1,
    "heading_err_rate_std_harsh": 2, "station_err_peak": 1, "speed_err_peak": 1, "lateral_err_peak": 4,
    "heading_err_peak": 1, "heading_err_rate_peak": 1,
}  # fmt: skip


def weights(against: Any = "current", **metrics: float) -> WeightsSpec:
    return WeightsSpec(
        schema="tunefree.weights/1", name="test", against=against, metrics=metrics or {"lateral_err_peak": 1.0}
    )


def course(duration_s: float = 2.0) -> Course:
    return build_course(
        ScenarioSpec(
            schema="tunefree.scenario/1",
            name="straight",
            speed=ProfileSpec(t_s=[0.0, duration_s], value=[5.0, 5.0]),
            curvature=ProfileSpec(t_s=[0.0, duration_s], value=[0.0, 0.0]),
        ),
        DT_S,
    )


COURSE = course()


def recording(ticks: int = COURSE.ticks, **columns: Any) -> Recording:
    """A drive along a straight road; what is not given is without error."""
    along = np.arange(ticks) * 0.05
    base: dict[str, Any] = {
        "ref_speed_mps": 5.0, "ref_accel_mps2": 0.0, "ref_curvature_1pm": 0.0, "station_error_m": 0.0,
        "speed_error_mps": 0.0, "lateral_error_m": 0.0, "heading_error_rad": 0.0, "heading_error_rate_radps": 0.0,
        "cmd_steer_rad": 0.0, "speed_mps": 5.0, "yaw_rate_radps": 0.0, "x_m": along, "y_m": 0.0, "heading_rad": 0.0,
        "replan": 0.0,
    }  # fmt: skip
    filled = {name: np.broadcast_to(np.asarray(values, dtype=float), ticks).copy() for name, values in base.items()}
    filled |= {name: np.broadcast_to(np.asarray(values, dtype=float), ticks).copy() for name, values in columns.items()}
    return make_recording(filled, DT_S)


def score(weights_spec: WeightsSpec, error: str = "", **columns: Any) -> ScenarioGrade:
    return grade_drive(recording(**columns), COURSE, weights_spec, MKZ, ScenarioEnd("straight", error))


def graded(value: float, planned: int) -> ScenarioGrade:
    return ScenarioGrade("x", value, {}, 0, "finished", planned)


def test_eq_7_by_hand() -> None:
    """Two scenarios of 2000 and 1000 samples, scores 0.3 and 0.9: 0.3 x 2/3 + 0.9 x 1/3 = 0.5."""
    assert combine_scores([graded(0.3, 2000), graded(0.9, 1000)]) == pytest.approx(0.5)
    with pytest.raises(ValueError, match="no scenario"):
        combine_scores([])


def test_inner_sum_by_hand() -> None:
    """Peaks 0.2 m / 0.5 m and 0.1 m / 1 m with weights 4 and 1: (4 x 0.4 + 1 x 0.1) / 5 = 0.34."""
    found = score(weights(lateral_err_peak=4.0, station_err_peak=1.0), lateral_error_m=-0.2, station_error_m=0.1)
    assert found.score == pytest.approx(0.34)
    assert found.outcome == "finished"
    assert found.planned_samples == 200
    assert set(found.metrics) == set(SCORE_METRICS)


def test_a_metric_that_could_not_be_had_is_dropped_and_the_rest_renormalised() -> None:
    both = weights(lateral_err_peak=4.0, lateral_err_std_harsh=4.0, heading_err_rate_peak=0.0)
    found = score(both, lateral_error_m=0.2)
    assert found.metrics["lateral_err_std_harsh"] is None
    assert found.dropped == ("lateral_err_std_harsh",)
    assert found.score == pytest.approx(0.4)


def test_the_same_weights_count_in_every_drive_of_a_scenario() -> None:
    """A re-plan's blend bends the current trajectory: that does not bring in a harsh metric that the plan has not."""
    spec = weights(lateral_err_peak=4.0, lateral_err_std_harsh=4.0, station_err_std_harsh=1.0)
    blend = np.where((np.arange(200) > 100) & (np.arange(200) < 160), 1.0, 0.0)
    replan = np.eye(1, 200, 100)[0]
    calm = score(spec, lateral_error_m=0.2, replan=replan)
    bent = score(spec, lateral_error_m=0.2, replan=replan, ref_curvature_1pm=0.08 * blend, ref_accel_mps2=1.5 * blend)
    assert bent.dropped == calm.dropped == ("lateral_err_std_harsh", "station_err_std_harsh")
    assert bent.score == calm.score == pytest.approx(1.4)


def test_harsh_metrics_count_where_the_course_is_harsh() -> None:
    spec = ScenarioSpec(
        schema="tunefree.scenario/1",
        name="bend",
        speed=ProfileSpec(t_s=[0.0, 1.0, 2.0], value=[5.0, 5.0, 3.0]),
        curvature=ProfileSpec(t_s=[0.0, 2.0], value=[0.06, 0.06]),
    )
    bend = build_course(spec, DT_S)
    driven = recording(ref_curvature_1pm=0.06, ref_accel_mps2=np.asarray(bend.accel_mps2)[:200], lateral_error_m=0.1)
    found = grade_drive(driven, bend, weights(lateral_err_std_harsh=1.0, station_err_std_harsh=1.0), MKZ)
    assert found.dropped == ()
    assert found.metrics["lateral_err_std_harsh"] == pytest.approx(0.1 / (0.06 * 5.0 * 2.8448), rel=0.01)
    assert found.metrics["station_err_std_harsh"] == 0.0


def test_each_replan_costs_1() -> None:
    replan = np.zeros(200)
    replan[[20, 150]] = 1.0
    found = score(weights(), lateral_error_m=0.2, replan=replan)
    assert (found.replans, found.score) == (2, pytest.approx(2.4))


@pytest.mark.parametrize("error", ["control_error", "controller_own", "diverged", "left_lane", "ins_missing"])
def test_a_failed_drive_scores_10(error: str) -> None:
    found = score(weights(), error)
    assert (found.outcome, found.score) == (error, 10.0)


@pytest.mark.parametrize("against", ["current", "original"])
@pytest.mark.parametrize(
    ("columns", "outcome"),
    [
        ({"lateral_error_m": np.where(np.arange(200) > 120, -2.01, 0.0)}, "left_lane"),
        ({"heading_error_rad": np.where(np.arange(200) > 120, 1.58, 0.0)}, "diverged"),
        ({"heading_error_rad": np.where(np.arange(200) > 120, math.nan, 0.0)}, "diverged"),
        ({"lateral_error_m": np.where(np.arange(200) > 120, math.inf, 0.0)}, "diverged"),
        ({"lateral_error_m": np.where(np.arange(200) < 5, math.nan, 1.9)}, "finished"),
        ({"lateral_error_m": -1.99, "heading_error_rad": 1.57}, "finished"),
    ],
)
def test_the_columns_are_judged_whatever_the_controller_said(
    against: str, columns: dict[str, Any], outcome: str
) -> None:
    found = score(weights(against), **columns)
    assert found.outcome == outcome
    assert (found.score == 10.0) == (outcome != "finished")


def test_the_lane_is_that_of_the_original_path_also_with_current_weights() -> None:
    """After a re-plan the current error is small; the vehicle is 2.1 m off the path all the same."""
    replan = np.zeros(200)
    replan[50] = 1.0
    found = score(weights("current"), y_m=np.where(np.arange(200) > 50, 2.1, 0.0), replan=replan)
    assert found.outcome == "left_lane"


def test_against_original_a_replan_forgives_nothing() -> None:
    replan = np.zeros(200)
    replan[50] = 1.0
    columns = {"y_m": np.where(np.arange(200) >= 50, 0.6, 0.0), "replan": replan}
    current, original = score(weights("current"), **columns), score(weights("original"), **columns)
    assert current.metrics["lateral_err_peak"] == 0.0
    assert original.metrics["lateral_err_peak"] == pytest.approx(1.2)
    assert original.score == pytest.approx(current.score + 1.2)


errors = st.floats(-1.9, 1.9)


@given(errors, st.floats(-30.0, 30.0), st.integers(0, 12), st.sampled_from(["", "diverged", "control_error"]))
def test_no_drive_scores_above_10_or_below_0(lateral_m: float, station_m: float, replans: int, error: str) -> None:
    replan = np.zeros(200)
    replan[: 10 * replans : 10] = 1.0
    found = score(weights(**PUBLISHED), error, lateral_error_m=lateral_m, station_error_m=station_m, replan=replan)
    assert 0.0 <= found.score <= 10.0


@given(errors, st.integers(0, 199), st.integers(0, 199), st.lists(st.integers(1000, 2500), max_size=3))
def test_failing_earlier_never_scores_better(lateral_m: float, one: int, other: int, planned: list[int]) -> None:
    """Alone and among other scenarios: m_j is what was planned, whatever was driven."""
    rest = [graded(0.2, samples) for samples in planned]

    def total(ticks: int, error: str) -> float:
        drive = recording(ticks, lateral_error_m=lateral_m)
        return combine_scores([grade_drive(drive, COURSE, weights(), MKZ, ScenarioEnd(error=error)), *rest])

    earlier, later = sorted((one, other))
    assert total(earlier + 1, "diverged") >= total(later + 1, "diverged") >= total(COURSE.ticks, "")


@given(st.sampled_from(sorted(PUBLISHED)), st.floats(0.0, 5.0), st.floats(0.0, 5.0))
def test_the_score_rises_with_each_metric(name: str, one: float, other: float) -> None:
    spec = weights(**PUBLISHED)
    low, high = sorted((one, other))
    base: dict[str, float | None] = dict.fromkeys(SCORE_METRICS, 0.4)
    assert weighted_mean({**base, name: low}, spec) <= weighted_mean({**base, name: high}, spec) + 1e-12


def test_a_recording_that_stops_without_a_reason_is_not_graded() -> None:
    with pytest.raises(InputError, match="'straight': 150 of 200 ticks were recorded"):
        grade_drive(recording(150), COURSE, weights(), MKZ, ScenarioEnd("straight"))
    assert grade_drive(recording(195), COURSE, weights(), MKZ).outcome == "finished"


def test_nothing_to_grade() -> None:
    bare = make_recording({"speed_mps": np.ones(200)}, DT_S)
    with pytest.raises(InputError, match="none of the weighted metrics"):
        grade_drive(bare, COURSE, weights(), MKZ)


def test_paper_weights_are_the_published_ones() -> None:
    paper = load_weights(ROOT / "bench_configs" / "weights" / "paper.toml")
    assert paper.metrics == PUBLISHED
    assert sum(paper.metrics.values()) == 25.0
    assert (paper.against, paper.as_published) == ("current", True)
    assert (paper.replan_penalty, paper.failure_score) == (1.0, 10.0)


def test_default_weights_forgive_nothing_and_count_all_four_aspects() -> None:
    default = load_weights(ROOT / "bench_configs" / "weights" / "default.toml")
    assert {TABLE[name].aspect for name in default.metrics} == {PERFORMANCE, SAFETY, COMFORT, EFFORT}
    assert {name for name in default.metrics if name.startswith(("lateral", "station", "speed"))} == {
        "lateral_jerk_rms",
        *(f"{error}_{kind}_after_start" for error in ("lateral", "station", "speed") for kind in ("rms", "peak")),
    }
    assert (default.against, default.as_published, default.largest_value) == ("original", False, 3.0)
    assert (default.replan_penalty, default.failure_score, default.lane_half_width_m) == (1.0, 10.0, 2.0)
    assert default.divergence_heading_rad == pytest.approx(math.pi / 2)


def test_a_metric_counts_up_to_its_largest_value() -> None:
    """Peaks 5 m / 0.5 m = 10, cut to 3, and 0.1 m / 1 m with weights 4 and 1: (4 x 3 + 1 x 0.1) / 5 = 2.42."""
    spec = weights(lateral_err_peak=4.0, station_err_peak=1.0)
    values: dict[str, float | None] = {"lateral_err_peak": 10.0, "station_err_peak": 0.1}
    assert weighted_mean(values, spec) == pytest.approx(8.02)
    assert weighted_mean(values, replace(spec, largest_value=3.0)) == pytest.approx(2.42)


def test_pedals_in_turn_are_a_metric_that_weights_may_name() -> None:
    """A change of pedals every 0.25 s is 4 a second, at a limit of 0.5."""
    throttle_on = np.floor(np.arange(1000) * DT_S / 0.25) % 2.0 == 0.0
    pedals = {
        "cmd_throttle_frac": np.where(throttle_on, 0.3, 0.0),
        "cmd_brake_frac": np.where(throttle_on, 0.0, 0.3),
    }
    found = grade_drive(recording(1000, **pedals), course(10.0), weights(pedal_alternation=1.0), MKZ)
    assert found.metrics["pedal_alternation"] == pytest.approx(8.0, rel=0.05)
    assert found.score == pytest.approx(8.0, rel=0.05)
    assert score(weights(), cmd_throttle_frac=0.3).metrics["pedal_alternation"] is None, "no brake"


def test_numbers_of_the_vehicle() -> None:
    limits = LimitsSpec(steer_rad=8.0, steer_rate_radps=8.5, throttle_frac=0.8, brake_frac=0.5)

    def vehicle(**nominal: Any) -> VehicleSpec:
        return VehicleSpec(
            schema="tunefree.vehicle/1", name="car", dbc=[], bitrate=500000, limits=limits, folder="car",
            nominal=NominalSpec(**nominal),
        )  # fmt: skip

    assert grade_vehicle_from_spec(vehicle(wheelbase_m=3.0, front_axle_m=1.2)) == pytest.approx(
        (3.0, 1.8, 8.0, 8.5, 0.0)
    )
    assert grade_vehicle_from_spec(vehicle(wheelbase_m=3.0)) == pytest.approx((3.0, 1.5, 8.0, 8.5, 0.0))
    with pytest.raises(InputError, match=r"car/vehicle.toml, key nominal.wheelbase_m"):
        grade_vehicle_from_spec(vehicle(steer_ratio=16.0))
