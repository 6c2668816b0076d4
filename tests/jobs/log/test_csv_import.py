"""log import: the log says what the CSV said; swapped units and disorder are refused; real files go through."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.episode.drives import in_units, motion, write_csv, write_map
from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.synthetic_dbc import STEP
from tunefree_hil.config.load import json_schema, load_import, load_vehicle
from tunefree_hil.episode.candump import read_candump
from tunefree_hil.jobs.doctor import doctor
from tunefree_hil.jobs.log.check import check
from tunefree_hil.jobs.log.csv_import import import_csv
from tunefree_hil.jobs.log.options import LogCheckOptions, LogImportOptions
from tunefree_hil.jobs.log.plot import collect_series
from tunefree_hil.jobs.options.records import DoctorOptions
from tunefree_hil.learn.drives.read import read_drives

DART = {
    "dart_100hz": "steering_identification_25_sept_2024/car_1_Datarecording_09_25_2024_09_56_53.csv",
    "dart_10hz": "30_step_steering_data/car_1_Datarecording_01_22_2024_12_03_04.csv",
}


def imported(folder: Path, rows: list[dict], **mapping: object) -> tuple[Path, dict, list[str]]:
    mapped = write_map(folder / "m.toml", **mapping)  # type: ignore[arg-type]
    events = list(import_csv(LogImportOptions(write_csv(folder / "d.csv", rows), mapped, folder / "out")))
    return folder / "out", events[-1].data, [event.message for event in events if event.kind == "warning"]


def test_the_log_says_what_the_csv_said(tmp_path: Path) -> None:
    rows = motion()
    out, data, warnings = imported(tmp_path, rows)
    assert warnings == [] and data["frames"] == 7 * len(rows)
    found = collect_series(read_candump(out / "drive.log"), Codec(load_vehicle(out)), ["report.speed_mps", "ins.x_m"])
    for name, column in (("report.speed_mps", "v"), ("ins.x_m", "x")):
        times, values = found[name]
        assert times == pytest.approx([row["t"] for row in rows], abs=1e-6)
        assert values == pytest.approx([row[column] for row in rows], abs=0.5001 * STEP)
    assert data["largest_error"] <= 0.5001 * STEP and data["quantisation"] == STEP


def test_the_folder_is_whole_and_says_that_it_is_invented(tmp_path: Path) -> None:
    out, _, _ = imported(tmp_path, motion())
    assert "Invented" in (out / "vehicle.dbc").read_text() and "Invented" in (out / "vehicle.toml").read_text()
    assert "made by a test" in (out / "vehicle.dbc").read_text()
    assert list(doctor(DoctorOptions(out)))[-1].data["exit"] == 0
    assert {"report.steer_rad", "command.gear", "report.wheel_speed_radps"} <= set(load_vehicle(out).absent)
    events = list(check(LogCheckOptions(out / "drive.log")))
    assert events[-1].data["exit"] == 0, "found beside its log, and whole"


def test_wheels_share_a_can_fd_frame(tmp_path: Path) -> None:
    wheels = "".join(
        f'[[columns]]\ncolumn = "w{name}"\nfield = "report.wheel_{name}_radps"\nunit = "rpm"\n'
        for name in ("fl", "fr", "rl", "rr")
    )
    head = 'schema = "tunefree.import/1"\nname = "w"\nsource = "test"\n[clock]\ncolumn = "t"\nunit = "ms"\n'
    (tmp_path / "m.toml").write_text(head + wheels)
    rows: list[dict] = [{"t": 20 * k, "wfl": 60, "wfr": 61, "wrl": 62, "wrr": 63 if k != 3 else ""} for k in range(10)]
    events = list(
        import_csv(LogImportOptions(write_csv(tmp_path / "d.csv", rows), tmp_path / "m.toml", tmp_path / "out"))
    )
    assert events[-1].data["frames"] == 9, "a row without all four is held out"
    found = collect_series(
        read_candump(tmp_path / "out" / "drive.log"), Codec(load_vehicle(tmp_path / "out")), ["report.wheel_rr_radps"]
    )
    assert found["report.wheel_rr_radps"][1] == pytest.approx([63.0 * 2.0 * math.pi / 60.0] * 9, abs=STEP)


def test_a_column_says_when_the_vehicle_obeyed(tmp_path: Path) -> None:
    rows: list[dict] = [row | {"safe": 2 if 4.0 <= row["t"] < 12.0 else 0} for row in motion()]
    rows[100] = rows[100] | {"safe": ""}
    out, data, _ = imported(tmp_path, rows, more='enabled = { column = "safe", active = 2 }\n')
    assert data["frames"] == 8 * len(rows) - 1, "a state wherever a cell says one"
    vehicle = load_vehicle(out)
    assert [one.message for one in vehicle.state["enabled"]] == ["BYWIRE_STATE"]
    assert "Invented; column 'safe' is 2" in (out / "vehicle.dbc").read_text()
    (drive,) = read_drives([out / "drive.log"], Codec(vehicle))
    time_s = np.arange(drive.n_rows) * drive.dt_s
    inside = (time_s > 4.1) & (time_s < 11.9)
    assert drive.enabled[inside].all() and not drive.enabled[(time_s < 3.9) | (time_s > 12.1)].any()
    assert list(doctor(DoctorOptions(out)))[-1].data["exit"] == 0
    assert list(check(LogCheckOptions(out / "drive.log")))[-1].data["exit"] == 0


def test_a_column_for_obeying_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no column named 'safe'"):
        imported(tmp_path, motion(), more='enabled = { column = "safe" }\n')


def test_gaps_and_empty_cells_are_told_and_not_filled(tmp_path: Path) -> None:
    rows: list[dict] = [row for row in motion() if not 5.0 < row["t"] < 6.5]
    rows[20] = rows[20] | {"v": "nan"}
    out, data, warnings = imported(tmp_path, rows)
    assert warnings[0] == "gap: no row from 5.000 to 6.500 s (1.500 s); not filled"
    assert warnings[1] == "report.speed_mps: 1 cells have no value; their frames are left out"
    assert data["frames"] == 7 * len(rows) - 1
    kept = json.loads((out / "import.json").read_text())
    assert kept["gaps"][0]["begin_s"] == pytest.approx(5.0) and kept["held_out"]["report.speed_mps"] == 1


def test_swapped_units_are_refused_unless_the_reason_is_given(tmp_path: Path) -> None:
    rows = in_units(motion(), {"v": "km/h"})
    with pytest.raises(InputError) as caught:
        imported(tmp_path, rows)
    error = caught.value
    assert error.code == "swapped_units" and error.exit_status == 2
    assert "'v'" in error.message and "'x' and 'y'" in error.message and "'v' in km/h" in error.message
    assert not (tmp_path / "out").exists()
    reason = 'accept = { speed_and_path = "a slipping wheel", accel_and_speed = "the same" }\n'
    _, data, warnings = imported(tmp_path, rows, more=reason)
    assert data["accepted"]["speed_and_path"] == "a slipping wheel"
    assert any("contradict" in warning for warning in warnings)


def test_a_folder_that_is_there_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").touch()
    with pytest.raises(InputError, match="already exists"):
        imported(tmp_path, motion())
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine"]


def test_a_value_that_no_frame_holds(tmp_path: Path) -> None:
    rows = [row | {"x": 1e9 + row["x"]} for row in motion()]
    with pytest.raises(InputError, match=r"ins\.x_m reaches 1e"):
        imported(tmp_path, rows)


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('unit = "m/s"', 'unit = "deg"', "columns[0].unit"),
        ('unit = "m/s"', 'unit = "furlong"', "columns[0].unit"),
        ('"report.speed_mps"', '"report.sped_mps"', "columns[0].field"),
        ('"report.accel_mps2"', '"report.speed_mps"', "columns[1].field"),
        ('"ins.x_m"', '"report.wheel_fl_radps"', "columns"),
        ("[clock]", "[clocks]", "clocks"),
        ('source = "made by a test"', "", "source"),
        ('source = "made by a test"', 'source = "x"\ndelimiter = "::"', "delimiter"),
        ('source = "made by a test"', 'source = "x"\naccept = { speed = "y" }', "accept.speed"),
    ],
)
def test_mistakes_in_a_mapping_file_are_named(tmp_path: Path, old: str, new: str, key: str) -> None:
    path = write_map(tmp_path / "m.toml")
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError) as caught:
        load_import(path)
    assert key in (caught.value.key, *caught.value.message.replace(":", " ").split()) and caught.value.file == str(path)


def test_the_schema_of_mapping_files() -> None:
    schema = json_schema("import")
    units = json.dumps(schema["$defs"]["ColumnSpec"]["properties"]["unit"])
    assert '"km/h"' in units and "hash" not in schema["$defs"]["ImportSpec"]["properties"]


@pytest.mark.slow
def test_the_rav4_minute_goes_through(shared_data: Path, repo: Path, tmp_path: Path) -> None:
    """comma2k19 (comma.ai, MIT licence): what the car's own DBC says is what the invented one says."""
    data = shared_data / "comma2k19_rav4"
    if not data.is_dir():
        pytest.skip("no comma2k19_rav4 in the shared data")
    log, table = data / "drive.candump.log", tmp_path / "rav4.csv"
    command = [sys.executable, repo / "tools" / "imports" / "rav4_csv.py", table, "--log", log]
    subprocess.run([*command, "--dbc", data / "rav4.dbc"], check=True, capture_output=True, timeout=60)
    events = list(import_csv(LogImportOptions(table, repo / "tools" / "imports" / "rav4.toml", tmp_path / "out")))
    (wheels,) = [one for one in events[-1].data["plausibility"] if one["check"] == "wheels_and_speed"]
    assert wheels["holds"] and wheels["factor"] == pytest.approx(1.021, abs=0.005), "2.1 % as the data's README says"
    assert list(check(LogCheckOptions(tmp_path / "out" / "drive.log")))[-1].data["exit"] == 0

    wanted = ["report.speed_mps", "report.steer_rad", "report.wheel_rr_radps", "command.accel_mps2"]
    there, here = Codec(load_vehicle("rav4_2017")), Codec(load_vehicle(tmp_path / "out"))
    true = collect_series(read_candump(log), there, wanted, by_channel=True)
    found = collect_series(read_candump(tmp_path / "out" / "drive.log"), here, wanted)
    for name in wanted:
        values = dict(zip(*(array.tolist() for array in true[name]), strict=True))
        assert len(found[name][0]) > 0.98 * len(values)
        for time_s, value in zip(*(array.tolist() for array in found[name]), strict=True):
            assert value == pytest.approx(values[time_s], abs=STEP), (name, time_s)

    wrong = (repo / "tools" / "imports" / "rav4.toml").read_text().replace('unit = "km/h"', 'unit = "m/s"', 1)
    (tmp_path / "wrong.toml").write_text(wrong)
    with pytest.raises(InputError, match="'speed' in km/h"):
        list(import_csv(LogImportOptions(table, tmp_path / "wrong.toml", tmp_path / "out2")))


@pytest.mark.parametrize("name", list(DART))
def test_real_recordings_go_through(name: str, shared_data: Path, repo: Path, tmp_path: Path) -> None:
    """DART (TU Delft, MIT licence): the encoder's speed against motion capture, the gyro against its yaw."""
    path = shared_data / "dart" / DART[name]
    if not path.is_file():
        pytest.skip(f"no {path.name} of dart in the shared data")
    events = list(import_csv(LogImportOptions(path, repo / "tools" / "imports" / f"{name}.toml", tmp_path / "out")))
    found = {one["check"]: one for one in events[-1].data["plausibility"]}
    assert not [one for one in found.values() if one["holds"] is False]
    if name == "dart_100hz":
        assert found["yaw_rate_and_heading"]["holds"] and found["speed_and_path"]["holds"]
    assert list(check(LogCheckOptions(tmp_path / "out" / "drive.log")))[-1].data["messages"]
    assert "MIT licence" in (tmp_path / "out" / "vehicle.dbc").read_text()
