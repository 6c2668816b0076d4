"""Each fault planted in a good log is found before training; good logs are not refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests import other_vehicle
from tests.house import ROOT
from tests.learn.made_logs import (
    MKZ,
    PEDALS,
    SECONDS,
    VAN,
    car,
    checked,
    drives_of,
    good,
    motion,
    planted,
    refusals,
    rows_of,
    scaled,
)
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GROUPS, Report
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.formats.rows import Row
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.jobs.log.csv_import import import_csv
from tunefree_hil.jobs.log.options import LogImportOptions
from tunefree_hil.learn.checks.drive_checks import check_drives
from tunefree_hil.learn.checks.problem import raise_refusals
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.drives.read import read_drives

BOTH = pytest.mark.parametrize("vehicle", [MKZ, VAN])


@pytest.mark.slow
@BOTH
def test_good_logs(vehicle: str, tmp_path: Path) -> None:
    problems = checked(tmp_path, vehicle, *(list(good(vehicle, seed)) for seed in (1, 2)))
    assert [one.code for one in problems] == ["short"], problems
    assert raise_refusals(problems) == problems


def test_a_good_log_of_real_time(tmp_path: Path) -> None:
    """Epoch stamps that are some ms late and sometimes out of order, like those of a receiver."""
    chance = np.random.default_rng(8)
    rows = [row._replace(time_s=round(1.65e9 + row.time_s + chance.uniform(0.0, 0.008), 6)) for row in good(VAN)]
    for i in range(500, len(rows) - 1, 900):
        rows[i], rows[i + 1] = rows[i + 1], rows[i]
    assert refusals(checked(tmp_path, VAN, rows)) == {}


# --- planted in what was driven --------------------------------------------------------------------------------------


@BOTH
def test_too_short_or_without_braking(vehicle: str, tmp_path: Path) -> None:
    short = checked(tmp_path, vehicle, rows_of(vehicle, 12.0))
    assert "too_short" in refusals(short) and "hold" in refusals(short)["too_short"].message
    rest = car(vehicle).spec.nominal.rest_pedal_frac

    def no_brake(k: int, records: dict) -> dict:
        report = records["report"]._replace(brake_frac=rest, brake_command_frac=rest)
        return records | {"report": report, "command": records["command"]._replace(brake_frac=rest)}

    problems = refusals(checked(tmp_path, vehicle, planted(vehicle, good(vehicle), no_brake, PEDALS)))
    assert problems.keys() == {"no_braking"}


@BOTH
def test_one_speed_only(vehicle: str, tmp_path: Path) -> None:
    def steady(k: int, records: dict) -> dict:
        noise = 0.01 * math.sin(7.0 * k)
        ins = records["ins"]._replace(speed_mps=8.0 + noise, x_m=0.08 * k, y_m=0.0, heading_rad=0.0, accel_mps2=noise)
        ins = ins._replace(yaw_rate_radps=0.0)
        wheel = (8.0 + noise) / (car(vehicle).spec.nominal.wheel_radius_m or 1.0)
        wheels = {f"wheel_{at}_radps": wheel for at in ("fl", "fr", "rl", "rr")}
        quiet = {
            "yaw_rate_radps": 0.0,
            "accel_mps2": noise,
            "steer_rad": 0.01 * noise,
            "steer_command_rad": 0.0,
        }
        report = records["report"]._replace(speed_mps=8.0 + noise, **wheels, **quiet)
        return {"report": report, "ins": ins, "command": records["command"]._replace(steer_rad=0.0)}

    problems = refusals(checked(tmp_path, vehicle, rows_of(vehicle, SECONDS, change=steady)))
    assert problems.keys() == {"one_speed"} and "at one speed only" in problems["one_speed"].message


def test_no_log_and_one_that_never_moves(tmp_path: Path) -> None:
    assert refusals(check_drives([], car("mkz_bywire").spec)).keys() == {"no_log"}
    problems = checked(tmp_path, "mkz_bywire", planted(MKZ, good(MKZ), scaled("speed_mps", 0.0), ["report.speed_mps"]))
    assert "too_short" in refusals(problems)


# --- planted in the frames -------------------------------------------------------------------------------------------


def test_a_number_that_is_none(tmp_path: Path) -> None:
    """Integers on the bus are always finite; floats of another folder, and drives made in code, may not be."""
    (drive,) = drives_of(tmp_path, "mkz_bywire", list(good("mkz_bywire")))
    drive.fields["report.accel_mps2"][700] = np.nan  # type: ignore[index]
    problems = refusals(check_drives([drive], car("mkz_bywire").spec))
    assert problems.keys() == {"not_a_number"} and problems["not_a_number"].field == "report.accel_mps2"
    assert "7.00 s" in problems["not_a_number"].message


def jumped(by_s: float, share: float = 0.5) -> Callable[[list[Row]], list[Row]]:
    def change(rows: list[Row]) -> list[Row]:
        begin = round(share * len(rows))
        return rows[:begin] + [row._replace(time_s=round(row.time_s + by_s, 6)) for row in rows[begin:]]

    return change


@pytest.mark.parametrize(("vehicle", "by_s"), [(MKZ, -5.0), (VAN, -0.3), (MKZ, 1.0), (VAN, 4.0), (MKZ, 30.0)])
def test_a_clock_that_jumps(vehicle: str, by_s: float, tmp_path: Path) -> None:
    rows = jumped(by_s, share=_fast(vehicle))(list(good(vehicle)))
    problems = refusals(checked(tmp_path, vehicle, rows))
    assert "clock_jump" in problems and "clock" in problems["clock_jump"].message


def _fast(vehicle: str) -> float:
    """Where in the good log the speed is highest, as a share of the log."""
    speeds = [records["report"].speed_mps for records in motion(vehicle, SECONDS, 1, 12.0, 1.0)]
    return int(np.argmax(speeds[:2400])) / len(speeds)


@BOTH
def test_a_silence_is_a_gap_and_no_jump(vehicle: str, tmp_path: Path) -> None:
    rows = [row for row in good(vehicle) if not 15.0 <= row.time_s < 16.5]
    problems = checked(tmp_path, vehicle, rows)
    assert refusals(problems) == {} and "gap" in {one.code for one in problems}


def test_a_clock_in_other_units(tmp_path: Path) -> None:
    rows = [row._replace(time_s=round(row.time_s * 10.0, 6)) for row in good("mkz_bywire")]
    assert "wrong_rate" in refusals(checked(tmp_path, "mkz_bywire", rows))


@BOTH
def test_two_vehicles_of_a_kind_in_one_log(vehicle: str, tmp_path: Path) -> None:
    """A log of `candump any` with a car on each channel, which lost a few frames of the second one."""
    lost = np.random.default_rng(4).random(len(good(vehicle, 2))) < 0.03
    second = [
        row._replace(channel="can1", time_s=round(row.time_s + 0.003, 6))
        for row, gone in zip(good(vehicle, 2), lost, strict=True)
        if not gone
    ]
    problems = refusals(checked(tmp_path, vehicle, sorted([*good(vehicle), *second], key=lambda row: row.time_s)))
    assert "two vehicles" in problems["wrong_rate"].message


def test_the_log_of_another_vehicle(tmp_path: Path) -> None:
    """Some ids are shared, but most of the folder's are missing."""
    codec = car("mkz_bywire").codec
    common = {codec.by_name[name].key for name in ("STEERING_REPORT", "STEERING_CMD", "THROTTLE_CMD")}
    rows = [row if row.can_id in common else row._replace(can_id=row.can_id + 0x100) for row in good("mkz_bywire")]
    problems = refusals(checked(tmp_path, "mkz_bywire", rows))
    assert (
        "other_vehicle" in problems
        and "0x" in problems["other_vehicle"].message
        and "mkz_bywire" in problems["other_vehicle"].message
    )


def test_another_van_whose_data_ids_are_others(tmp_path: Path) -> None:
    dynamics = car(other_vehicle.NAME).codec.by_name["DYNAMICS"].key
    rows = [
        row._replace(data=bytes([row.data[0] ^ 0x5A]) + row.data[1:]) if row.can_id == dynamics else row
        for row in good(other_vehicle.NAME)
    ]
    problems = refusals(checked(tmp_path, other_vehicle.NAME, rows))
    assert "other_vehicle" in problems and "data ids" in problems["other_vehicle"].message


def test_frames_that_are_too_short(tmp_path: Path) -> None:
    key = car("mkz_bywire").codec.by_name["GYRO"].key
    rows = [row._replace(data=row.data[:2]) if row.can_id == key else row for row in good("mkz_bywire")]
    assert "DBC" in refusals(checked(tmp_path, "mkz_bywire", rows))["other_vehicle"].message


def test_a_few_bad_frames_are_only_told(tmp_path: Path) -> None:
    rows = list(good(other_vehicle.NAME))
    for i in range(1000, 4000, 400):
        rows[i] = rows[i]._replace(data=bytes([rows[i].data[0] ^ 1]) + rows[i].data[1:])
    problems = checked(tmp_path, other_vehicle.NAME, rows)
    assert refusals(problems) == {} and "bad_frames" in {one.code for one in problems}


@pytest.mark.slow
@BOTH
def test_two_vehicles_in_one_call(vehicle: str, tmp_path: Path) -> None:
    """The second vehicle turns half as much for the same steering angle, or has other unknown ids on its bus."""
    second_log = rows_of(vehicle, SECONDS, seed=2, ratio=2.0)
    problems = refusals(checked(tmp_path, vehicle, list(good(vehicle)), second_log))
    assert "two_vehicles" in problems and "log1.log" in problems["two_vehicles"].message
    logs = [
        [*good(vehicle, seed), *(Row(0.01 * k, "can0", base + k % 8, b"\0") for k in range(800))]
        for seed, base in ((1, 0x700), (2, 0x500))
    ]
    problems = refusals(checked(tmp_path, vehicle, *(sorted(rows) for rows in logs)))
    assert problems.keys() == {"two_vehicles"}


def test_the_same_recording_twice_is_told(tmp_path: Path) -> None:
    problems = checked(tmp_path, "mkz_bywire", list(good("mkz_bywire")), list(good("mkz_bywire")))
    assert "twice" in {one.code for one in problems} and refusals(problems) == {}


# --- real recordings -------------------------------------------------------------------------------------------------


def test_the_rav4_minute_is_not_refused(shared_data: Path) -> None:
    path = shared_data / "comma2k19_rav4" / "drive.candump.log"
    if not path.is_file():
        pytest.skip("no comma2k19_rav4 in the shared data")
    spec = load_vehicle(ROOT / "dbc" / "rav4_2017")
    problems = check_drives(read_drives([path], Codec(spec)), spec)
    assert refusals(problems) == {}, problems


DART = {
    "dart_100hz": ("steering_identification_25_sept_2024",),
    "dart_10hz": ("20_step_input_data_rubbery_floor", "30_step_steering_data"),
}


@pytest.mark.slow
@pytest.mark.parametrize("mapping", DART)
def test_dart_is_not_refused(mapping: str, shared_data: Path, tmp_path: Path) -> None:
    """The shorter files of each folder in one call: a car without a brake and with a nonlinear servo."""
    drives: list[Drive] = []
    for folder in DART[mapping]:
        files = sorted((shared_data / "dart" / folder).glob("*.csv"), key=lambda path: path.stat().st_size)
        if not files:
            pytest.skip(f"no {folder} of dart in the shared data")
        for path in files[:6]:
            out = tmp_path / folder / path.stem
            out.parent.mkdir(exist_ok=True)
            try:
                list(import_csv(LogImportOptions(path, ROOT / "tools" / "imports" / f"{mapping}.toml", out)))
            except InputError as error:
                assert error.code == "swapped_units"  # some of them do not pass the import's own check
                continue
            spec = load_vehicle(out)
            drives += read_drives([out / "drive.log"], Codec(spec))
    assert len(drives) >= 5
    problems = check_drives(drives, spec)
    assert refusals(problems) == {}, problems


def test_every_field_a_check_speaks_of_is_one() -> None:
    from tunefree_hil.learn.checks.stuck_signals import DRIVING_SIGNALS
    from tunefree_hil.learn.drives import drive

    names = {f"{group}.{name}" for group, record in GROUPS.items() for name in record._fields}
    both = (drive.INS_FIRST_SPEEDS, drive.INS_FIRST_YAW_RATES)
    assert both == (drive.CHASSIS_FIRST_SPEEDS[::-1], drive.CHASSIS_FIRST_YAW_RATES[::-1])
    lists = (*both, drive.THROTTLE_FIELDS, drive.BRAKE_FIELDS, drive.STEER_FIELDS, tuple(DRIVING_SIGNALS))
    assert all(name in names for some in lists for name in some)
    assert Report().throttle_frac != 0.0
