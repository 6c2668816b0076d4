"""Drives read from logs have the same values in the same ticks as episode/columns.py, which reads frame by frame."""

from __future__ import annotations

import hashlib
import pickle
from pathlib import Path

import numpy as np
import pytest

from tests import other_vehicle
from tests.house import ROOT
from tests.learn.made_logs import car, rows_of, write_log
from tunefree_hil.base.course import Tracking
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.formats.find import load_format
from tunefree_hil.bus.formats.rows import survey
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.episode.candump import read_candump, read_rows
from tunefree_hil.episode.columns import columns_from_frames
from tunefree_hil.learn.checks.drive_checks import check_drives
from tunefree_hil.learn.drives.drive import Drive, LogSummary
from tunefree_hil.learn.drives.read import read_drives

NOBODY = Block(lambda params, dt_s: None, lambda params, state, x, dt_s: (state, params), Tracking())
AS_FIELDS = {
    "cmd_throttle_frac": "command.throttle_frac",
    "cmd_brake_frac": "command.brake_frac",
    "cmd_steer_rad": "command.steer_rad",
    "out_throttle_frac": "report.throttle_frac",
    "out_brake_frac": "report.brake_frac",
    "out_steer_rad": "report.steer_rad",
    "speed_mps": "report.speed_mps",
    "accel_mps2": "report.accel_mps2",
    "lateral_accel_mps2": "report.lateral_accel_mps2",
    "yaw_rate_radps": "report.yaw_rate_radps",
    "x_m": "ins.x_m",
    "y_m": "ins.y_m",
    "heading_rad": "ins.heading_rad",
}


def summary_of(drive: Drive) -> LogSummary:
    """The summary of its log."""
    assert drive.log_summary is not None
    return drive.log_summary


def agree(drive: Drive, path: Path, codec: Codec, **options: object) -> int:
    """Compare every column of columns_from_frames; returns how many there are."""
    frames = read_candump(path, allow_cut=True)
    columns = columns_from_frames(frames, codec, NOBODY, drive.dt_s, ticks=drive.n_rows, **options).columns  # type: ignore[arg-type]
    common = [(name, field) for name, field in AS_FIELDS.items() if name in columns]
    for name, field in common:
        np.testing.assert_array_equal(drive.fields[field], columns[name], err_msg=name)
    return len(common)


@pytest.mark.parametrize("vehicle", ["mkz_bywire", other_vehicle.NAME])
def test_a_log_in_virtual_time(vehicle: str, tmp_path: Path) -> None:
    path = write_log(tmp_path / "vehicle.log", rows_of(vehicle, 6.0))
    (drive,) = read_drives([path], car(vehicle).codec)
    assert agree(drive, path, car(vehicle).codec) == len(AS_FIELDS)
    assert drive.n_rows == 600 and drive.dt_s == 0.01 and drive.name == "vehicle.log"
    assert drive.log_hash == "sha256:" + hashlib.sha256(path.read_bytes()).hexdigest()
    assert {"report.wheel_fl_radps", "report.gear", "command.gear", "ins.speed_mps"} <= drive.fields.keys()
    assert drive.fresh.keys() == drive.fields.keys()
    period = {"mkz_bywire": 2, other_vehicle.NAME: 2}[vehicle]
    assert np.flatnonzero(drive.fresh["report.throttle_frac"])[:3].tolist() == [0, period, 2 * period]
    reading = summary_of(drive)
    assert reading.unknown_ids == {} == reading.corrupt_frames
    assert reading.frames == sum(reading.frames_by_message.values()) == len(read_candump(path))


@pytest.mark.parametrize("vehicle", ["mkz_bywire", other_vehicle.NAME])
def test_a_log_in_real_time(vehicle: str, tmp_path: Path) -> None:
    """Epoch stamps, each some ms late; a report is received in the tick after its stamp."""
    chance = np.random.default_rng(3)
    rows = [
        row._replace(time_s=round(row.time_s + chance.uniform(0.0, 0.004), 6))
        for row in rows_of(vehicle, 4.0, zero_s=1.65e9)
    ]
    path = write_log(tmp_path / "a.log", sorted(rows))
    (drive,) = read_drives([path], car(vehicle).codec)
    zero_s = min(row.time_s for row in rows)
    assert agree(drive, path, car(vehicle).codec, zero_s=zero_s, late_ticks=1) == len(AS_FIELDS)
    assert np.isnan(drive.fields["report.speed_mps"][0]) and np.isfinite(drive.fields["command.steer_rad"][0])


def test_a_real_time_run_begins_where_its_bench_log_says(tmp_path: Path) -> None:
    path = write_log(tmp_path / "vehicle.log", rows_of("mkz_bywire", 2.0, zero_s=100.003))
    run = bc.encode(bc.Status(bc.Role.RUNNER, bc.State.RUN, 0, 500))
    (tmp_path / "bench.log").write_text(f"(99.603000) bench {run.id:03X}#{run.data.hex()}\n")
    (drive,) = read_drives([path], car("mkz_bywire").codec)
    assert agree(drive, path, car("mkz_bywire").codec, zero_s=100.103, late_ticks=1) == len(AS_FIELDS)
    (tmp_path / "bench.log").write_text("(99.603000) bench 6E2#00\n")
    with pytest.raises(InputError, match="no RUN"):
        read_drives([path], car("mkz_bywire").codec)


def test_two_frames_in_a_tick_and_disorder(tmp_path: Path) -> None:
    """Of two frames in a tick the later one in the log counts; ticks are in order of time."""
    chance = np.random.default_rng(5)
    rows = rows_of("mkz_bywire", 2.0)
    for i in chance.integers(0, len(rows) - 40, 300).tolist():
        j = i + int(chance.integers(1, 30))
        rows[i], rows[j] = rows[j], rows[i]
    doubled = [row for row in rows for _ in range(int(chance.integers(0, 3)))]
    path = write_log(tmp_path / "a.log", doubled)
    (drive,) = read_drives([path], car("mkz_bywire").codec)
    assert agree(drive, path, car("mkz_bywire").codec) == len(AS_FIELDS)


def test_corrupted_and_short_frames_are_left_out(tmp_path: Path) -> None:
    codec, rows = car(other_vehicle.NAME).codec, rows_of(other_vehicle.NAME, 2.0)
    speed = codec.by_name["DYNAMICS"]
    mine = [i for i, row in enumerate(rows) if row.can_id == speed.key]
    for i in mine[10:15]:
        rows[i] = rows[i]._replace(data=rows[i].data[:5] + bytes([rows[i].data[5] ^ 0x40]) + rows[i].data[6:])
    for i in mine[20:23]:
        rows[i] = rows[i]._replace(data=rows[i].data[:9])
    path = write_log(tmp_path / "a.log", rows)
    (drive,) = read_drives([path], codec)
    assert agree(drive, path, codec) == len(AS_FIELDS)
    assert summary_of(drive).corrupt_frames == {"DYNAMICS": 5} and summary_of(drive).short_frames == {"DYNAMICS": 3}
    assert drive.fresh["report.speed_mps"].sum() == len(mine) - 8


def test_a_drive_that_was_changed_is_still_judged_by_its_frames(tmp_path: Path) -> None:
    rows = rows_of("mkz_bywire", 2.0)
    back = [row._replace(time_s=row.time_s - (0.5 if i > 900 else 0.0)) for i, row in enumerate(rows)]
    (drive,) = read_drives([write_log(tmp_path / "a.log", back)], car("mkz_bywire").codec)
    changed = drive._replace(name="changed", fields=dict(drive.fields))
    assert summary_of(changed) == summary_of(drive)
    for variant in (drive, changed):
        codes = {problem.code for problem in check_drives([variant], car("mkz_bywire").spec)}
        assert "clock_jump" in codes
    codes = {problem.code for problem in check_drives([drive._replace(log_summary=None)], car("mkz_bywire").spec)}
    assert "clock_jump" not in codes


def test_by_wire_obeys_when_all_say_so(tmp_path: Path) -> None:
    """Disabled while the report of one channel says so, and before the first report."""
    codec, rows = car("mkz_bywire").codec, rows_of("mkz_bywire", 3.0)
    steering = codec.by_name["STEERING_REPORT"]
    mask, shift, _, _ = steering.plan.raws["ENABLED"]
    off = ~(mask << shift)
    for i, row in enumerate(rows):
        if row.can_id == steering.key and 1.0 <= row.time_s < 2.0:
            rows[i] = row._replace(data=(int.from_bytes(row.data, "little") & off).to_bytes(8, "little"))
    (drive,) = read_drives([write_log(tmp_path / "a.log", rows)], codec)
    assert np.flatnonzero(~drive.enabled).tolist() == list(range(100, 200))
    bare = [
        row for row in rows if row.can_id not in {codec.by_name[f"{one}_REPORT"].key for one in ("STEERING", "BRAKE")}
    ]
    (drive,) = read_drives([write_log(tmp_path / "b.log", bare)], codec)
    assert drive.enabled.all() and "report.speed_mps" not in drive.fields


def test_names_tell_the_logs_apart_and_progress_is_told(tmp_path: Path) -> None:
    rows, progress = rows_of("mkz_bywire", 1.0), []
    paths = [write_log(tmp_path / one / "vehicle.log", rows) for one in ("run/0", "run/1")]
    drives = read_drives(paths, car("mkz_bywire").codec, progress=lambda share, name: progress.append((share, name)))
    assert [drive.name for drive in drives] == ["0/vehicle.log", "1/vehicle.log"]
    assert progress[-1] == (1.0, "1/vehicle.log") and [one[0] for one in progress] == sorted(one[0] for one in progress)
    again = pickle.loads(pickle.dumps(drives[0]))
    assert summary_of(again) == summary_of(drives[0]) and again.name == drives[0].name


def test_another_format_and_a_line_that_was_cut_off(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.log", rows_of("mkz_bywire", 2.0))
    rows = list(read_rows(path))
    load_format("csv").write(tmp_path / "a.csv", rows, survey(rows))
    with path.open("a") as file:
        file.write("(2.0000")
    drives = read_drives([path, tmp_path / "a.csv"], car("mkz_bywire").codec)
    assert [summary_of(drive).is_truncated for drive in drives] == [True, False]
    for name, values in drives[0].fields.items():
        np.testing.assert_array_equal(values, drives[1].fields[name])


def test_logs_that_no_drive_can_be_made_of(tmp_path: Path) -> None:
    van = write_log(tmp_path / "van.log", rows_of(other_vehicle.NAME, 1.0))
    mkz = write_log(tmp_path / "mkz.log", rows_of("mkz_bywire", 1.0))
    with pytest.raises(InputError, match="not one frame of vehicle 'mkz_bywire'") as caught:
        read_drives([mkz, van], car("mkz_bywire").codec)
    assert caught.value.file == str(van) and caught.value.code == "foreign_log"
    rows = [
        row._replace(time_s=row.time_s + (1e6 if i > 500 else 0.0)) for i, row in enumerate(rows_of("mkz_bywire", 1.0))
    ]
    with pytest.raises(InputError, match="the clock jumps ahead by 1e"):
        read_drives([write_log(tmp_path / "jump.log", rows)], car("mkz_bywire").codec)
    with pytest.raises(InputError, match="no such log"):
        read_drives([tmp_path / "none.log"], car("mkz_bywire").codec)


def test_equal_ids_on_two_channels(shared_data: Path) -> None:
    """The RAV4 has 0x343 on three channels: the command is on can128. Short frames give the fields that they hold."""
    path = shared_data / "comma2k19_rav4" / "drive.candump.log"
    if not path.is_file():
        pytest.skip("no comma2k19_rav4 in the shared data")
    codec = Codec(load_vehicle(ROOT / "dbc" / "rav4_2017"))
    (drive,) = read_drives([path], codec)
    assert drive.fresh["command.accel_mps2"].sum() == pytest.approx(2000, abs=10)
    accel = drive.fields["command.accel_mps2"]
    assert (np.nanmin(accel), np.nanmax(accel)) == pytest.approx((-2.364, 0.872))
    assert 0.78 < drive.enabled.mean() < 0.88, "engaged 83 % of the time"
    zero_s = min(frame.time_s for frame in read_candump(path))
    assert agree(drive, path, codec, zero_s=zero_s, late_ticks=1, by_channel=True) >= 2


def test_equal_ids_on_channels_of_other_names_are_not_mixed(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "comma2k19_rav4" / "drive.candump.log"
    if not path.is_file():
        pytest.skip("no comma2k19_rav4 in the shared data")
    renamed = tmp_path / "renamed.log"
    renamed.write_text(path.read_text().replace(" can", " bus"))
    with pytest.raises(InputError, match=r"comes on bus.*, but vehicle.toml has it on can") as caught:
        read_drives([renamed], Codec(load_vehicle(ROOT / "dbc" / "rav4_2017")))
    assert caught.value.file == str(renamed) and "the same channel names" in caught.value.hint
