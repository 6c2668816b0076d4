"""Recordings: columns as docs/reference/files.md names them, whole files or none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.episode.recording import COLUMNS, Recording, load_recording, make_recording, save_recording


def some() -> Recording:
    columns = {"speed_mps": np.array([1.0, 2.0, np.nan]), "x_m": np.zeros(3), "yaw_rate_radps": np.full(3, np.nan)}
    return make_recording(columns, 0.02, {"speed_mps": "ins.speed_mps", "yaw_rate_radps": "ins.yaw_rate_radps"})


def test_the_columns_of_the_interface() -> None:
    named = """t_s tick ref_x_m ref_y_m ref_heading_rad ref_speed_mps ref_accel_mps2 ref_curvature_1pm station_error_m
    speed_error_mps lateral_error_m lateral_error_rate_mps heading_error_rad heading_error_rate_radps cmd_throttle_frac
    cmd_brake_frac cmd_steer_rad out_throttle_frac out_brake_frac out_steer_rad speed_mps accel_mps2 lateral_accel_mps2
    yaw_rate_radps x_m y_m heading_rad replan"""
    assert set(COLUMNS) == set(named.split())
    assert len(COLUMNS) == 28


def test_a_column_without_a_number_is_absent() -> None:
    recording = some()
    assert list(recording.columns) == ["t_s", "tick", "speed_mps", "x_m"]
    assert recording.get("yaw_rate_radps") is None
    assert recording.instead == {"speed_mps": "ins.speed_mps"}
    assert recording.ticks == 3
    np.testing.assert_array_equal(recording.columns["t_s"], [0.0, 0.02, 0.04])


def test_mistakes_of_a_caller() -> None:
    with pytest.raises(ValueError, match="speed_kph"):
        make_recording({"speed_kph": np.zeros(3)}, 0.01)
    with pytest.raises(ValueError, match="one length"):
        make_recording({"x_m": np.zeros(3), "y_m": np.zeros(4)}, 0.01)


def test_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "columns.npz"
    save_recording(some(), path)
    again = load_recording(path)
    assert again.dt_s == 0.02
    assert again.instead == some().instead
    assert list(again.columns) == list(some().columns)
    for name, values in some().columns.items():
        np.testing.assert_array_equal(again.columns[name], values)
    assert list(tmp_path.iterdir()) == [path]


def test_the_same_recording_is_the_same_file(tmp_path: Path) -> None:
    save_recording(some(), tmp_path / "a.npz")
    save_recording(some(), tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_no_half_file(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="cannot write"):
        save_recording(some(), tmp_path / "missing" / "columns.npz")
    assert list(tmp_path.iterdir()) == []


def test_files_that_are_none_of_ours(tmp_path: Path) -> None:
    path = tmp_path / "columns.npz"
    with pytest.raises(InputError, match="no such file"):
        load_recording(path)
    for data in (b"PK\x03\x04 cut off", b""):
        path.write_bytes(data)
        with pytest.raises(InputError, match="not a readable"):
            load_recording(path)
    np.savez(path, a=np.zeros(3))
    with pytest.raises(InputError, match="no columns 'tick'"):
        load_recording(path)
