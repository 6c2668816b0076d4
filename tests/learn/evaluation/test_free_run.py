"""Free run: a model of the very car is right, another one is not; tables, intervals and hills."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.learn.made_drives import CHANNELS, made_drive, whole
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec, VehicleSpec
from tunefree_hil.learn.evaluation.free_run import (
    EvaluationOptions,
    FreeRunErrors,
    error_reduction,
    evaluate_free_run,
    mean_interval,
    open_plant,
    run_headings,
    table_from_errors,
)
from tunefree_hil.learn.evaluation.motion import MotionTrack, make_motion_track

HORIZONS = (1.0, 3.0)
OPTIONS = EvaluationOptions(horizons_s=HORIZONS, min_free_s=3.0, every_s=2.0)


@pytest.fixture(scope="module")
def vehicle(repo: Path) -> VehicleSpec:
    return load_vehicle(repo / "dbc" / "mkz_bywire")


@pytest.fixture(scope="module")
def tracks(vehicle: VehicleSpec) -> list[MotionTrack]:
    drives = [made_drive(16.0, seed=5, name="a"), made_drive(16.0, seed=6, grade_rad=0.05, name="b")]
    return [make_motion_track(whole(drive), vehicle) for drive in drives]


def model_with(repo: Path, **params: float) -> ModelSpec:
    """The made drives' car, with other constants where given."""
    model = load_model(repo / "bench_configs" / "models" / "mkz_nominal")
    fields = {name: getattr(model, name) for name in model.__struct_fields__}
    own = {
        name: ActuatorSpec(dead_time_s=one.dead_time_s, lag_s=one.lag_s, rate_limit=one.rate_limit)
        for name, one in CHANNELS.items()
    }
    plant = type(model.plant)(kind="physics", params=params)
    return type(model)(**{**fields, "actuators": own, "plant": plant})


@pytest.fixture(scope="module")
def right(repo: Path, vehicle: VehicleSpec, tracks: list[MotionTrack]) -> FreeRunErrors:
    return evaluate_free_run(model_with(repo), vehicle, tracks, OPTIONS)


@pytest.fixture(scope="module")
def wrong(repo: Path, vehicle: VehicleSpec, tracks: list[MotionTrack]) -> FreeRunErrors:
    params = {"drive_force_n": 4000.0, "steer_ratio": 18.0}
    return evaluate_free_run(model_with(repo, **params), vehicle, tracks, OPTIONS)


def test_the_very_car_is_right(right: FreeRunErrors) -> None:
    level = ~right.is_on_hill
    assert right.position_m[level, 1].mean() < 0.08
    assert right.heading_rad[level, 1].mean() < 0.005
    assert right.accel_mps2 < 0.4 and right.yaw_rate_radps < 0.02


def test_the_road_s_slope_is_given(right: FreeRunErrors) -> None:
    assert set(np.array(right.drive_names)[right.is_on_hill]) == {"b"} and set(
        np.array(right.drive_names)[~right.is_on_hill]
    ) == {"a"}
    assert right.speed_mps[right.is_on_hill, 1].mean() < 0.25  # without the slope it would be 1.5 after 3 s


def test_another_car_is_not_and_by_how_much_is_said(right: FreeRunErrors, wrong: FreeRunErrors) -> None:
    assert wrong.position_m[:, 1].mean() > 4.0 * right.position_m[:, 1].mean()
    found = error_reduction(right, wrong, 3.0)
    assert found["value"] > 70.0 and found["n"] == (~right.is_on_hill).sum()
    assert error_reduction(wrong, wrong, 3.0)["value"] == 0.0


def test_the_table_has_rows_for_both_grounds(right: FreeRunErrors) -> None:
    table = table_from_errors(right)
    assert table["level"]["starts"] + table["hills"]["starts"] == len(right.is_on_hill)
    one = table["level"]["3"]["position_m"]
    assert one["mean"] <= one["p95"] and one["mean"] == pytest.approx(right.position_m[~right.is_on_hill, 1].mean())
    assert one["low"] is one["high"] is None, "all of one drive"
    metres = table["level"]["3"]["position_per_m"]["mean"]
    assert 0.0 < metres < one["mean"]


def test_horizons_beyond_the_drive_are_not_invented(
    repo: Path, vehicle: VehicleSpec, tracks: list[MotionTrack]
) -> None:
    found = evaluate_free_run(
        model_with(repo), vehicle, tracks[:1], EvaluationOptions(horizons_s=(3.0, 30.0), min_free_s=3.0, every_s=4.0)
    )
    assert np.isnan(found.position_m[:, 1]).all() and "30" not in table_from_errors(found)["level"]


def test_at_most_so_many_starts(repo: Path, vehicle: VehicleSpec, tracks: list[MotionTrack]) -> None:
    assert (
        len(
            evaluate_free_run(
                model_with(repo), vehicle, tracks, EvaluationOptions(max_starts=2, horizons_s=(1.0,), min_free_s=1.0)
            ).drive_names
        )
        == 2
    )


def test_intervals_draw_drives_not_starts() -> None:
    """Twenty starts of one drive tell of that drive only once."""
    rng = np.random.default_rng(3)
    means = rng.normal(5.0, 1.0, 8)
    values, drives = np.repeat(means, 20), np.repeat([f"drive {i}" for i in range(8)], 20)
    low, high = mean_interval(values, drives)
    assert high - low > 0.6  # starts drawn one by one would say 0.3


@pytest.mark.parametrize("count", [2, 4, 8])
def test_the_interval_of_a_few_drives_holds_the_truth_as_often_as_it_says(count: int) -> None:
    rng, held = np.random.default_rng(5), 0
    for _ in range(400):
        drives = np.repeat([f"drive {i}" for i in range(count)], 3)
        low, high = mean_interval(np.repeat(rng.normal(5.0, 1.0, count), 3), drives)
        held += low <= 5.0 <= high
    assert 0.92 < held / 400 < 0.98


def test_one_drive_has_no_interval() -> None:
    assert np.isnan(mean_interval(np.array([1.0, 3.0]), np.array(["a", "a"]))).all()


def test_no_start_is_said(repo: Path, vehicle: VehicleSpec, tracks: list[MotionTrack]) -> None:
    with pytest.raises(InputError, match="no drive has 41 s"):
        evaluate_free_run(model_with(repo), vehicle, tracks, EvaluationOptions(min_free_s=40.0))


def test_a_plant_that_cannot_be_told_a_motion_is_refused(repo: Path) -> None:
    with pytest.raises(InputError, match="'reference' cannot take over"):
        open_plant(load_model(repo / "bench_configs" / "models" / "mkz_reference"))


def test_headings_begin_at_what_was_measured(repo: Path, vehicle: VehicleSpec, tracks: list[MotionTrack]) -> None:
    found = run_headings({"physics": model_with(repo)}, vehicle, tracks[0], 400, 3.0)["physics"]
    assert len(found) == 301 and abs(found[0] - tracks[0].heading_rad[400]) < 1e-3
    assert np.abs(found - tracks[0].heading_rad[400:701]).max() < 0.02
