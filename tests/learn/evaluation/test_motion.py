"""Tracks: rows of motion and of what caused it, aligned; smoothed without inventing; hills told from level ground."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.learn.drives.test_road_slope import drive_with
from tests.learn.made_drives import CHANNELS, REST, made_drive, whole
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.config.schema import ActuatorSpec, EffectSpec, ModelSpec, VehicleSpec
from tunefree_hil.learn.drives.drive import Drive, DrivePart
from tunefree_hil.learn.evaluation.motion import (
    SMOOTHING_ROWS,
    MotionTrack,
    body_change,
    find_starts,
    is_hilly,
    make_motion_track,
    make_motion_tracks,
    simulate_actuators,
    smooth_motion_signal,
)


@pytest.fixture(scope="module")
def vehicle(repo: Path) -> VehicleSpec:
    return load_vehicle(repo / "dbc" / "mkz_bywire")


@pytest.fixture(scope="module")
def drive() -> Drive:
    return made_drive(20.0, seed=4)


@pytest.fixture(scope="module")
def track(drive: Drive, vehicle: VehicleSpec) -> MotionTrack:
    return make_motion_track(whole(drive), vehicle)


@pytest.fixture(scope="module")
def truth(repo: Path) -> ModelSpec:
    """A model whose actuators are those of the made drives."""
    model = load_model(repo / "bench_configs" / "models" / "mkz_nominal")
    fields = {name: getattr(model, name) for name in model.__struct_fields__}
    own = {
        name: ActuatorSpec(dead_time_s=one.dead_time_s, lag_s=one.lag_s, rate_limit=one.rate_limit)
        for name, one in CHANNELS.items()
    }
    return type(model)(**{**fields, "actuators": own})


def test_outputs_of_the_true_actuators_are_the_recorded_ones(track: MotionTrack, truth: ModelSpec) -> None:
    """Only if commands stand in the rows in which they act: a tick more or less is far outside."""
    missed = simulate_actuators(track, truth, REST) - track.recorded
    assert np.abs(missed[100:, 2]).std() < 0.003
    assert missed[100:, :2].std() < 0.002  # between two reports there is a straight line
    late = np.roll(simulate_actuators(track, truth, REST), 1, axis=0) - track.recorded
    assert late[100:, 2].std() > 3.0 * missed[100:, 2].std()


def test_labels_are_nearer_to_the_truth_than_what_was_measured(vehicle: VehicleSpec) -> None:
    time_s = np.arange(2000) * 0.01
    speed = 10.0 + 2.0 * np.sin(0.8 * time_s)
    found = smooth_motion_signal(speed + np.random.default_rng(1).normal(0.0, 0.02, len(speed)))
    assert np.abs(found - speed).std() < 0.008
    assert np.abs(smooth_motion_signal(speed, 0.01) - 1.6 * np.cos(0.8 * time_s)).max() < 0.01


def test_what_is_too_short_to_smooth_is_nothing() -> None:
    values = np.ones(200)
    values[60] = np.nan
    values[100] = np.nan
    found = smooth_motion_signal(values)
    assert np.isfinite(found[:60]).all() and np.isnan(found[60:101]).all() and np.isfinite(found[101:]).all()


def test_a_slope_is_seen_and_level_ground_is_level(vehicle: VehicleSpec, track: MotionTrack) -> None:
    uphill = make_motion_track(whole(made_drive(20.0, seed=4, grade_rad=0.04)), vehicle)
    moving = uphill.speed_mps > 2.0
    middle = slice(200, 1800)
    assert np.abs(uphill.grade_rad[middle][moving[middle]] - 0.04).mean() < 0.006
    assert is_hilly(uphill, 500, 1000)
    assert not track.grade_rad.any() and not is_hilly(track, 500, 1000)


def test_what_an_accelerometer_says_throughout_is_no_hill_but_for_its_share(vehicle: VehicleSpec) -> None:
    drive = drive_with(0.25)
    assert not make_motion_track(whole(drive), vehicle).grade_rad.any()
    (road,) = make_motion_tracks([whole(drive)], vehicle, road_share=1.0)
    assert np.median(road.grade_rad) == pytest.approx(0.25 / G_MPS2, abs=0.003)


def test_rows_in_another_gear_or_with_holes_are_not_good(drive: Drive, vehicle: VehicleSpec) -> None:
    gear = np.full(drive.n_rows, 4.0)
    gear[300:400] = 2.0
    fields = {**drive.fields, "report.gear": gear}
    fresh = {**drive.fresh, "report.gear": np.ones(drive.n_rows, dtype=bool)}
    track = make_motion_track(whole(drive._replace(fields=fields, fresh=fresh)), vehicle)
    assert not track.is_good[300:400].any() and track.is_good[100:300].all()
    starts = find_starts(track, 50, 100, 10)
    assert starts and all(row + 100 < 300 or row - 50 >= 400 for row in starts)


def test_without_an_ins_the_pose_is_summed_up(drive: Drive, vehicle: VehicleSpec, track: MotionTrack) -> None:
    fields = {name: value for name, value in drive.fields.items() if not name.startswith("ins.")}
    summed = make_motion_track(whole(drive._replace(fields=fields)), vehicle)
    assert (summed.x_m[0], summed.y_m[0], summed.heading_rad[0]) == (0.0, 0.0, 0.0)
    assert abs((summed.heading_rad[-1] - summed.heading_rad[0]) - (track.heading_rad[-1] - track.heading_rad[0])) < 0.02


def test_a_log_without_speed_is_refused(drive: Drive, vehicle: VehicleSpec) -> None:
    fields = {name: value for name, value in drive.fields.items() if "speed" not in name}
    with pytest.raises(InputError, match=r"the logs have no ins\.speed_mps or report\.speed_mps"):
        make_motion_track(whole(drive._replace(fields=fields)), vehicle)


def test_reports_stand_where_there_are_no_commands(drive: Drive, vehicle: VehicleSpec, truth: ModelSpec) -> None:
    fields = {name: value for name, value in drive.fields.items() if "command" not in name}
    track = make_motion_track(whole(drive._replace(fields=fields)), vehicle)
    assert not track.follows_command.any() and np.array_equal(simulate_actuators(track, truth, REST), track.recorded)


def test_a_rate_limit_counts_behind_the_actuators_lag(track: MotionTrack, truth: ModelSpec) -> None:
    fields = {name: getattr(truth, name) for name in truth.__struct_fields__}
    limited = [EffectSpec(name="steer_rate_limit", params={"rate_radps": 0.2})]
    slow = ActuatorSpec(dead_time_s=0.0, lag_s=0.5)
    found = simulate_actuators(track, type(truth)(**{**fields, "effects": limited, "actuators": {"steer": slow}}), REST)
    free = simulate_actuators(track, type(truth)(**{**fields, "effects": [], "actuators": {"steer": slow}}), REST)
    y, expected = 0.0, []  # an effect has been at rest for ever
    for x in free[:, 2]:
        y += float(np.clip(x - y, -0.2 * track.dt_s, 0.2 * track.dt_s))
        expected.append(y)
    assert np.abs(np.diff(free[:, 2])).max() > 0.004 and np.allclose(found[200:, 2], expected[200:], atol=2e-3)


def test_effects_of_a_channel_count(track: MotionTrack, truth: ModelSpec) -> None:
    fields = {name: getattr(truth, name) for name in truth.__struct_fields__}
    offset = [
        EffectSpec(name="steer_offset", params={"offset_rad": 0.05}),
        EffectSpec(name="grade", params={"grade_rad": 0.1}),
    ]
    other = type(truth)(**{**fields, "effects": offset})
    assert np.allclose(
        simulate_actuators(track, other, REST)[:, 2], simulate_actuators(track, truth, REST)[:, 2] + 0.05
    )
    assert body_change(other).grade_rad == 0.1 and body_change(truth).grade_rad == 0.0


def test_what_a_person_drives_has_the_effects_behind_the_actuators_as_well(
    track: MotionTrack, truth: ModelSpec
) -> None:
    """Else a network would learn them from the motion, and the model that has them would have them twice."""
    effects = [
        EffectSpec(name="steer_offset", params={"offset_rad": 0.05}),
        EffectSpec(name="powertrain_lag", params={"tau_s": 0.3}),
        EffectSpec(name="steer_rate_limit", params={"rate_radps": 0.01}),  # before the report
    ]
    fields = {name: getattr(truth, name) for name in truth.__struct_fields__}
    recorded = track.recorded.copy()
    recorded[:150, 2] = np.nan
    recorded[:50, 0] = 0.5
    person = track._replace(recorded=recorded, follows_command=np.zeros_like(track.follows_command))
    found = simulate_actuators(person, type(truth)(**{**fields, "effects": effects}), REST)
    assert np.isnan(found[:150, 2]).all() and np.allclose(found[150:, 2], recorded[150:, 2] + 0.05)
    assert np.array_equal(found[:, 1], recorded[:, 1])
    assert np.allclose(found[:50, 0], 0.5, atol=1e-3), "the lag begins where the throttle was"
    y, expected = 0.5, []
    for x in recorded[:, 0]:
        y += (1.0 - np.exp(-track.dt_s / 0.3)) * (x - y)
        expected.append(y)
    assert np.abs(found[:, 0] - expected).max() < 0.03 and np.abs(found[:, 0] - recorded[:, 0]).max() > 0.1


def test_short_parts_are_left_out(drive: Drive, vehicle: VehicleSpec) -> None:
    parts = [DrivePart(drive, 0, SMOOTHING_ROWS - 1), DrivePart(drive, 500, 1500)]
    assert [one.begin for one in make_motion_tracks(parts, vehicle)] == [500]
