"""What a drive shows of every requirement, by signals whose peaks, rates and swings are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tunefree_hil.base.course import Course
from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec
from tunefree_hil.config.tuning.require_schema import REQUIREMENTS
from tunefree_hil.episode.recording import Recording, make_recording
from tunefree_hil.episode.scenario import build_course
from tunefree_hil.grade.metrics import samples_from_recording
from tunefree_hil.grade.oscillation.detection import find_oscillations
from tunefree_hil.grade.requirements.limits import CRITERIA
from tunefree_hil.grade.requirements.measure import measure_requirements

Array = np.ndarray
DT_S, DURATION_S = 0.01, 20.0
SPEED_MPS = 15.0
TICKS = round(DURATION_S / DT_S)
TIME_S = np.arange(TICKS) * DT_S


def course(curvature: ProfileSpec | None = None) -> Course:
    level = ProfileSpec(t_s=[0.0, DURATION_S], value=[SPEED_MPS, SPEED_MPS])
    straight = ProfileSpec(t_s=[0.0, DURATION_S], value=[0.0, 0.0])
    return build_course(
        ScenarioSpec(schema="tunefree.scenario/1", name="road", speed=level, curvature=curvature or straight), DT_S
    )


STRAIGHT = course()


def recording(**columns: Array) -> Recording:
    calm = {
        name: np.zeros(TICKS)
        for name in (
            *("lateral_error_m", "heading_error_rad", "station_error_m", "speed_error_mps", "cmd_steer_rad"),
            *("cmd_throttle_frac", "cmd_brake_frac", "accel_mps2", "yaw_rate_radps", "replan", "ref_accel_mps2"),
            "ref_curvature_1pm",
        )
    }
    speeds = {name: np.full(TICKS, SPEED_MPS) for name in ("speed_mps", "ref_speed_mps")}
    return make_recording({**calm, **speeds, **columns}, DT_S)


def measured(drive: Recording, road: Course = STRAIGHT, replans: int = 0) -> dict[str, float | None]:
    report = find_oscillations(drive.columns, drive.dt_s)
    return measure_requirements(drive, road, samples_from_recording(drive), report, replans)


def pulse(at_s: float, height: float, width_s: float = 0.5) -> Array:
    return np.where(np.abs(TIME_S - at_s) <= 0.5 * width_s, height, 0.0)


def test_a_calm_drive_has_every_value_and_all_are_0() -> None:
    values = measured(recording())
    assert tuple(values) == REQUIREMENTS
    assert values == dict.fromkeys(REQUIREMENTS, 0.0)


@pytest.mark.parametrize(
    ("name", "column"),
    [
        ("lateral_error_peak_m", "lateral_error_m"),
        ("heading_error_peak_rad", "heading_error_rad"),
        ("station_error_peak_m", "station_error_m"),
        ("speed_error_peak_mps", "speed_error_mps"),
    ],
)
def test_a_peak_counts_from_the_third_second_on(name: str, column: str) -> None:
    start = pulse(1.0, 0.9) + pulse(10.0, -0.3)
    assert measured(recording(**{column: start}))[name] == pytest.approx(0.3)
    late = pulse(CRITERIA.start_s + 0.3, 0.9)
    assert measured(recording(**{column: late}))[name] == pytest.approx(0.9)


def test_the_rms_is_that_of_the_rest() -> None:
    error = np.where(CRITERIA.start_s > TIME_S, 1.0, 0.1)
    assert measured(recording(lateral_error_m=error))["lateral_error_rms_m"] == pytest.approx(0.1, rel=1e-3)


def test_jerk_that_the_path_asks_for_is_not_the_gains_() -> None:
    """A bend within 0.5 s, driven 0.2 s late, has the path's own jerk; on the straight the same is all excess."""
    bend = course(ProfileSpec(t_s=[0.0, 9.9, 10.4, DURATION_S], value=[0.0, 0.0, 0.01, 0.01]))
    yaw_rate = SPEED_MPS * np.interp(TIME_S - 0.2, [9.9, 10.4], [0.0, 0.01])
    drive = recording(yaw_rate_radps=yaw_rate)
    assert measured(drive, bend)["lateral_jerk_peak_mps3"] == pytest.approx(0.0, abs=0.05)
    jerk_mps3 = SPEED_MPS**2 * 0.01 / 0.5
    assert measured(drive)["lateral_jerk_peak_mps3"] == pytest.approx(jerk_mps3, rel=0.15)


def test_longitudinal_jerk_is_a_mean_over_half_a_second() -> None:
    step = np.where(TIME_S < 10.0, 0.0, 2.0)
    assert measured(recording(accel_mps2=step))["accel_jerk_peak_mps3"] == pytest.approx(4.0, rel=1e-6)
    noise = 0.2 * (-1.0) ** np.arange(TICKS)
    assert measured(recording(accel_mps2=noise))["accel_jerk_peak_mps3"] == pytest.approx(0.0, abs=1e-9)


def test_steering_rate_is_taken_over_a_tenth_of_a_second() -> None:
    ramp = np.interp(TIME_S, [8.0, 9.0], [0.0, 4.0])
    assert measured(recording(cmd_steer_rad=ramp))["steer_rate_peak_radps"] == pytest.approx(4.0, rel=1e-6)


def test_the_end_of_a_path_that_ends_in_a_bend_is_not_the_gains_() -> None:
    """There the path goes on straight, so the wheel turns back at once."""
    back = np.interp(TIME_S, [DURATION_S - 0.5, DURATION_S - 0.3], [1.0, 0.0])
    values = measured(recording(cmd_steer_rad=back, yaw_rate_radps=0.2 * back))
    assert values["steer_rate_peak_radps"] == 0.0 and values["lateral_jerk_peak_mps3"] == 0.0


@settings(max_examples=15)
@given(amplitude_rad=st.floats(0.02, 1.0), frequency_hz=st.floats(0.7, 2.5))
def test_a_swinging_wheel_has_its_amplitude_peak_to_peak(amplitude_rad: float, frequency_hz: float) -> None:
    wheel = 0.5 * amplitude_rad * np.sin(2.0 * math.pi * frequency_hz * TIME_S)
    values = measured(recording(cmd_steer_rad=wheel))
    assert values["steer_oscillation_rad"] == pytest.approx(amplitude_rad, rel=0.1)
    assert values["accel_oscillation_mps2"] == 0.0


def test_the_worse_pedal_counts() -> None:
    brake = 0.2 * (1.0 + np.sin(2.0 * math.pi * TIME_S))
    assert measured(recording(cmd_brake_frac=brake))["pedal_oscillation_frac"] == pytest.approx(0.4, rel=0.05)


def test_what_a_recording_does_not_have_is_none() -> None:
    values = measured(make_recording({"lateral_error_m": np.zeros(TICKS)}, DT_S))
    known = {name for name, value in values.items() if value is not None}
    assert known == {"lateral_error_peak_m", "lateral_error_rms_m"}


def test_a_drive_that_ends_at_the_start_has_no_errors() -> None:
    short = make_recording({"lateral_error_m": np.zeros(200), "replan": np.zeros(200)}, DT_S)
    values = measured(short, replans=2)
    assert {name for name, value in values.items() if value is not None} == {"replans"}
    assert values["replans"] == 2.0
