"""Errors against the original path: the follower is the second opinion."""

from __future__ import annotations

import numpy as np
import pytest

from tunefree_hil.base.course import Course
from tunefree_hil.base.records import Ins
from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec
from tunefree_hil.control.follower import make_follower
from tunefree_hil.episode.recording import Recording, make_recording
from tunefree_hil.episode.scenario import build_course
from tunefree_hil.grade.metrics import samples_from_recording
from tunefree_hil.grade.original_reference import samples_against_original

DT_S = 0.01
REAR_AXLE_M = 1.4224
ERRORS = (
    "station_error_m",
    "speed_error_mps",
    "lateral_error_m",
    "heading_error_rad",
    "heading_error_rate_radps",
    "ref_speed_mps",
    "ref_accel_mps2",
    "ref_curvature_1pm",
    "lateral_error_rate_mps",
)


def course() -> Course:
    """A U-turn and a bend back, with a stop in the middle; the path comes within 12 m of itself."""
    return build_course(
        ScenarioSpec(
            schema="tunefree.scenario/1",
            name="test",
            speed=ProfileSpec(t_s=[0, 6, 8, 9, 11, 18], value=[4.0, 4.0, 0.0, 0.0, 5.0, 5.0]),
            curvature=ProfileSpec(t_s=[0, 1, 2, 5, 6, 10, 12, 14, 18], value=[0, 0, 0.15, 0.15, 0, 0, -0.1, 0.05, 0]),
        ),
        DT_S,
    )


COURSE = course()


def drive(lateral_m: float, late_m: float) -> tuple[Recording, np.ndarray, np.ndarray]:
    """A vehicle that weaves about the path and falls behind; (recording, path errors as the follower says them)."""
    where = COURSE.first_station_m + np.arange(len(COURSE.path_x_m)) * COURSE.spacing_m
    time = np.arange(COURSE.ticks) * DT_S
    station = np.asarray(COURSE.station_m[:-1]) - late_m * np.minimum(time / 5.0, 1.0)
    heading = np.interp(station, where, COURSE.path_heading_rad)
    side = lateral_m * np.sin(0.7 * time)
    x = np.interp(station, where, COURSE.path_x_m) - side * np.sin(heading)
    y = np.interp(station, where, COURSE.path_y_m) + side * np.cos(heading)
    heading = heading + 0.1 * np.sin(0.5 * time)
    speed = np.maximum(np.gradient(station, DT_S), 0.0)
    yaw_rate = np.gradient(heading, DT_S)
    follower = make_follower(COURSE, REAR_AXLE_M)
    state, trackings = follower.init(follower.params, DT_S), []
    for k, row in enumerate(np.stack([x, y, heading, speed, 0.0 * x, yaw_rate], axis=1).tolist()):
        state, tracking = follower.step(follower.params, state, (k, Ins(*row)), DT_S)
        trackings.append(tracking)
    fields = (*ERRORS, "replan")
    columns = {name: np.array([getattr(item, name) for item in trackings]) for name in fields}
    vehicle = {"x_m": x, "y_m": y, "heading_rad": heading, "speed_mps": speed, "yaw_rate_radps": yaw_rate}
    path_errors = np.array([(item.path_lateral_error_m, item.path_heading_error_rad) for item in trackings])
    return make_recording({**columns, **vehicle}, DT_S), path_errors[:, 0], path_errors[:, 1]


def against_original(recording: Recording) -> dict[str, np.ndarray]:
    """The samples by name, all of them there."""
    found = samples_against_original(recording, COURSE, REAR_AXLE_M)._asdict()
    return {name: values for name, values in found.items() if values is not None}


def test_without_a_replan_the_columns_are_the_answer() -> None:
    recording, lateral, _ = drive(0.3, 0.5)
    found = samples_against_original(recording, COURSE, REAR_AXLE_M)
    assert recording.columns["replan"].sum() == 0.0
    assert found.lateral_error_m is recording.columns["lateral_error_m"]
    np.testing.assert_array_equal(found.lateral_error_m, lateral)


def test_recomputed_errors_are_the_followers_own() -> None:
    """With a re-plan marked at tick 0 all rows are recomputed, and re-anchored where they were: the start."""
    recording, _, _ = drive(0.3, 0.5)
    marked = make_recording({**recording.columns, "replan": np.eye(1, recording.ticks, 0)[0]}, DT_S)
    found = against_original(marked)
    for name in ERRORS[1:]:
        np.testing.assert_allclose(found[name], recording.columns[name], atol=1e-9, err_msg=name)
    shift = found["station_error_m"] - recording.columns["station_error_m"]
    np.testing.assert_allclose(shift[1:], shift[1], atol=1e-9)


def test_after_a_replan_the_path_is_still_the_old_one() -> None:
    recording, lateral, heading = drive(1.2, 0.5)
    replans = np.flatnonzero(recording.columns["replan"])
    assert len(replans) >= 2
    found = against_original(recording)
    np.testing.assert_allclose(found["lateral_error_m"], lateral, atol=1e-9)
    np.testing.assert_allclose(found["heading_error_rad"], heading, atol=1e-9)
    late = slice(replans[0] + 1, None)
    assert np.abs(found["lateral_error_m"][late] - recording.columns["lateral_error_m"][late]).max() > 0.5
    for name in ERRORS:
        np.testing.assert_array_equal(found[name][: replans[0] + 1], recording.columns[name][: replans[0] + 1])


def test_the_station_error_begins_at_0_after_a_replan() -> None:
    recording, _, _ = drive(0.1, 4.0)
    replans = np.flatnonzero(recording.columns["replan"])
    assert len(replans) >= 1
    found = against_original(recording)
    assert found["station_error_m"][replans[0]] > 2.5
    for row in replans:
        assert found["station_error_m"][row + 1] == pytest.approx(0.0, abs=0.05)


def test_what_cannot_be_recomputed_is_none() -> None:
    recording, _, _ = drive(1.2, 0.5)
    blind = make_recording({name: values for name, values in recording.columns.items() if name != "x_m"}, DT_S)
    found = samples_against_original(blind, COURSE, REAR_AXLE_M)
    assert all(getattr(found, name) is None for name in ERRORS[:5])
    for name in ("heading_error_rate_radps", "speed_error_mps"):
        partly = make_recording({n: v for n, v in recording.columns.items() if n != name}, DT_S)
        found = samples_against_original(partly, COURSE, REAR_AXLE_M)
        assert getattr(found, name) is None
        assert found.lateral_error_m is not None


def test_the_chassis_sensors_have_no_say_in_the_errors() -> None:
    """Speed and yaw rate are those of the follower, the INS's; the columns of these names are the chassis's."""
    recording, _, _ = drive(1.2, 0.5)
    off = {
        "speed_mps": recording.columns["speed_mps"] + 0.3,
        "yaw_rate_radps": recording.columns["yaw_rate_radps"] - 0.1,
    }
    found = against_original(make_recording({**recording.columns, **off}, DT_S))
    for name, values in against_original(recording).items():
        if name in ERRORS:
            np.testing.assert_array_equal(found[name], values, err_msg=name)


def test_a_recording_without_a_follower() -> None:
    bare = make_recording({"speed_mps": np.ones(9)}, DT_S)
    found, current = samples_against_original(bare, COURSE, REAR_AXLE_M), samples_from_recording(bare)
    assert found.speed_mps is current.speed_mps
    assert found.lateral_error_m is None
