"""The recorded persons of the measure `weights`: parts driven by hand, compared on the bandwidth of both sides."""

from __future__ import annotations

import numpy as np
import pytest

from tools.measures._weights_recorded import (
    COMPARED,
    DATA,
    ROW_S,
    SHORTEST_S,
    SLOWEST_MPS,
    HumanDrive,
    generated_metrics,
    human_metrics,
    read_human_drives,
    road_of,
)
from tunefree_hil.episode.recording import make_recording
from tunefree_hil.episode.scenario import build_course

RATE_RADPS = 8.5
TIME_S = np.arange(0.0, 40.0, ROW_S)


def made_drive() -> HumanDrive:
    speed = 12.0 + np.sin(0.3 * TIME_S)
    yaw_rate = 0.1 * np.sin(0.5 * TIME_S)
    return HumanDrive("made", speed, yaw_rate, 45.0 * yaw_rate / speed)


def test_both_sides_of_the_same_motion_have_the_same_metrics() -> None:
    drive, ticks = made_drive(), np.arange(0.0, 40.0, 0.01) - 0.045  # a row is the mean of its ten ticks
    columns = {
        "speed_mps": np.interp(ticks, TIME_S, drive.speed_mps),
        "yaw_rate_radps": np.interp(ticks, TIME_S, drive.yaw_rate_radps),
        "cmd_steer_rad": np.interp(ticks, TIME_S, drive.wheel_rad),
    }
    human = human_metrics(drive, RATE_RADPS)
    generated = generated_metrics(make_recording(columns, 0.01), len(TIME_S), RATE_RADPS)
    assert set(human) == set(COMPARED)
    for name in COMPARED:
        assert human[name] == pytest.approx(generated[name], rel=0.02)


def test_the_road_is_the_drive_without_its_fast_movements() -> None:
    drive = made_drive()
    shaken = drive._replace(yaw_rate_radps=drive.yaw_rate_radps + 0.05 * np.sin(8.0 * TIME_S))
    smooth, rough = (np.array(road_of(one, 1.0).curvature.value) for one in (drive, shaken))
    assert np.abs(smooth - rough)[8:-8].max() < 0.05 * np.abs(smooth).max()
    course = build_course(road_of(drive, 1.0), 0.01)
    assert float(course.station_m[-1]) == pytest.approx(np.trapezoid(drive.speed_mps, TIME_S), rel=0.02)


@pytest.mark.skipif(not DATA.is_dir(), reason=f"needs the recorded minutes in {DATA}")
def test_only_parts_without_any_assistance_are_read() -> None:
    drives = read_human_drives(45.0)
    assert len(drives) >= 10
    for drive in drives:
        assert len(drive.speed_mps) * ROW_S >= SHORTEST_S and drive.speed_mps.min() > SLOWEST_MPS
        values = human_metrics(drive, RATE_RADPS)
        assert all(value is not None and value < 3.0 for value in values.values()), drive.name


@pytest.mark.skipif(not DATA.is_dir(), reason=f"needs the recorded minutes in {DATA}")
def test_wheel_angles_are_scaled_to_the_vehicle() -> None:
    """Twice the angle per curvature: twice the wheel's angles."""
    for small, large in zip(read_human_drives(45.0), read_human_drives(90.0), strict=True):
        assert np.allclose(2.0 * small.wheel_rad, large.wheel_rad)
