"""Rewriting recorded frames: what is planted is there, in its signal, and nothing else has changed."""

from __future__ import annotations

import tomllib
from pathlib import Path

import cantools
import numpy as np
import pytest

from tests.house import ROOT
from tests.tools.gap_exam.drives_for_tests import clean, vehicle
from tools.gap_exam import bus, cases, recordings, semi_real
from tools.gap_exam.files import Run
from tools.gap_exam.recordings import NoRecording, make_ready
from tools.gap_exam.semi_real import planted, read, written

RAV4 = ROOT / "dbc" / "rav4_2017"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """A log and the folder that it is read with."""
    folder = tmp_path_factory.mktemp("car")
    bus.write_folder(folder, vehicle())
    return cases.log_of(clean(), 9), folder


def values(text: str, folder: Path, message: str, signal: str) -> tuple[np.ndarray, np.ndarray]:
    """(stamps, physical values) of a signal."""
    one = cantools.database.load_file(folder / "vehicle.dbc").get_message_by_name(message)
    frames = [frame for frame in read(text) if frame.can_id == one.frame_id and len(frame.data) >= one.length]
    stamps = np.array([float(frame.stamp) for frame in frames])
    return stamps, np.array([one.decode(frame.data)[signal] for frame in frames])


def test_nothing_planted_is_nothing_changed(recorded: tuple[str, Path]) -> None:
    assert written(read(recorded[0])) == recorded[0]


@pytest.mark.slow
def test_scales_biases_and_filters(recorded: tuple[str, Path]) -> None:
    text, folder = recorded
    for effects, message, signal, wanted in (
        ({"speed_scale": {"scale_frac": 1.05}}, "STEER_STATE", "SPEED", lambda x: 1.05 * x),
        ({"speed_scale": {"scale_frac": 1.05}}, "WHEELS", "REAR_LEFT", lambda x: 1.05 * x),
        ({"yaw_rate_bias": {"bias_radps": 0.03}}, "INERTIA", "YAW", lambda x: x + 0.03),
        ({"accel_bias": {"bias_mps2": -0.2}}, "INERTIA", "LONG", lambda x: x - 0.2),
        ({"steer_report_offset": {"offset_rad": 0.1}}, "STEER_STATE", "ANGLE", lambda x: x + np.degrees(0.1)),
    ):
        new = planted(text, folder, effects)
        stamps, before = values(text, folder, message, signal)
        same, after = values(new, folder, message, signal)
        step = cantools.database.load_file(folder / "vehicle.dbc").get_message_by_name(message)
        factor = float(step.get_signal_by_name(signal).scale)
        assert np.array_equal(stamps, same) and np.abs(after - wanted(before)).max() <= 0.5001 * factor
    other = values(new, folder, "STEER_STATE", "ECHO")[1]
    assert np.array_equal(other, values(text, folder, "STEER_STATE", "ECHO")[1]), "its neighbours stay"
    changed = sum(a != b for a, b in zip(text.splitlines(), new.splitlines(), strict=True))
    assert 0 < changed <= len(before), "no other message is touched"
    softened = values(planted(text, folder, {"yaw_rate_filter": {"tau_s": 0.3}}), folder, "INERTIA", "YAW")[1]
    raw = values(text, folder, "INERTIA", "YAW")[1]
    y, share = raw[0], 1.0 - np.exp(-0.01 / 0.3)
    wanted_row = []
    for one in raw:
        y += share * (one - y)
        wanted_row.append(y)
    assert np.abs(softened[1:] - np.array(wanted_row)[1:]).max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "moved", "by_s"),
    [
        ("report_latency", {"THROTTLE_STATE", "BRAKE_STATE", "STEER_STATE", "WHEELS", "INERTIA", "GEAR_STATE"}, 0.07),
        ("ins_latency", {"INS_PLACE", "INS_MOTION"}, 0.07),
        ("steer_dead_time", {"STEER_DEMAND"}, -0.07),
    ],
)
def test_delays_move_stamps(recorded: tuple[str, Path], name: str, moved: set[str], by_s: float) -> None:
    text, folder = recorded
    new = planted(text, folder, {name: {"delay_s": 0.07}})
    ids = {one.frame_id: one.name for one in cantools.database.load_file(folder / "vehicle.dbc").messages}
    before, after = read(text), read(new)
    assert len(before) == len(after)
    for number, message in ids.items():
        times = [np.array([float(f.stamp) for f in some if f.can_id == number]) for some in (before, after)]
        assert np.allclose(times[1] - times[0], by_s if message in moved else 0.0, atol=1e-6), message
        assert [f.data for f in before if f.can_id == number] == [f.data for f in after if f.can_id == number]
    stamps = [float(one.stamp) for one in after]
    assert stamps == sorted(stamps)


def test_an_angle_in_two_parts_and_its_sum() -> None:
    """The RAV4's steering angle is a coarse part and a fraction, and its last byte the maker's sum: both hold after."""
    text = "(1.000000) can0 025#00001000C00000FD\n(1.012000) can0 025#0FF00000600000BB\n(1.013000) can1 025#00\n"
    new = planted(text, RAV4, {"steer_report_offset": {"offset_rad": 0.05}})
    angle = [values(one, RAV4, "STEER_ANGLE_SENSOR", "STEER_ANGLE")[1] for one in (text, new)]
    fraction = [values(one, RAV4, "STEER_ANGLE_SENSOR", "STEER_FRACTION")[1] for one in (text, new)]
    total = [a + f for a, f in zip(angle, fraction, strict=True)]
    assert np.abs(total[1] - total[0] - np.degrees(0.05)).max() <= 0.051
    first = read(new)[0].data
    assert first[-1] == (0x25 + 8 + sum(first[:-1])) & 0xFF
    assert read(new)[2] == read(text)[2], "another channel is another car's"


def test_what_cannot_be_planted_is_said(recorded: tuple[str, Path]) -> None:
    with pytest.raises(ValueError, match="payload cannot be planted"):
        planted(*recorded, {"payload": {"mass_kg": 100.0}})


def test_recordings_that_are_not_there_are_named(tmp_path: Path) -> None:
    with pytest.raises(NoRecording, match="09_57_26"):
        make_ready(Run(tmp_path / "run"), tmp_path)


def test_a_sheet_that_has_no_place_for_the_track_is_said() -> None:
    sheet = "[nominal]\nmass_kg = 1.0\n"
    assert tomllib.loads(recordings.with_track("a = 1\n" + sheet))["nominal"]["track_m"] == 1.57
    for wrong in (sheet.replace("nominal", "other"), f"a = 1\n{sheet}\ntrack_m = 1.5\n"):
        with pytest.raises(NoRecording, match="nominal"):
            recordings.with_track(wrong)


@pytest.mark.slow
def test_the_rav4s_minute_rewritten(tmp_path: Path, shared_data: Path) -> None:
    """Of the recording, not of a toy: the angle moves by the offset, as far as its steps of 0.1 degrees allow."""
    run = Run(tmp_path)
    recordings._rav4(run, shared_data)
    case = cases.Case(0, "semi", -1, "", "recorded", 0, {"steer_report_offset": {"offset_rad": 0.1}}, 1, source="rav4")
    folder, (text,), _ = semi_real.question(run, case)
    raw = (tmp_path / "recordings" / "rav4" / "drive.log").read_text()
    assert tomllib.loads((folder / "vehicle.toml").read_text())["nominal"]["track_m"] == 1.57
    assert len(read(raw)) == len(read(text)) > 30000
    total = [
        sum(values(one, folder, "STEER_ANGLE_SENSOR", part)[1] for part in ("STEER_ANGLE", "STEER_FRACTION"))
        for one in (raw, text)
    ]
    assert np.abs(total[1] - total[0] - np.degrees(0.1)).max() <= 0.051
    assert (run.folder / "recordings" / "rav4" / "vehicle.logs" / "00.log").read_text() == raw
