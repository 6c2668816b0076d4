"""scenarios, log check and log show: what they print, what --json gets, how they end."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.config.load import load_scenario, load_vehicle
from tunefree_hil.jobs.log import check as log_check
from tunefree_hil.jobs.log import show as log_show
from tunefree_hil.jobs.log.options import LogCheckOptions, LogShowOptions
from tunefree_hil.jobs.options.records import ScenariosOptions
from tunefree_hil.jobs.scenarios import describe_scenario, scenarios

SCENARIO = """
schema = "tunefree.scenario/1"
name = "{name}"
speed = {{ t_s = [0.0, 10.0], value = [{speed}, {speed}] }}
curvature = {{ t_s = [0.0, 10.0], value = [0.05, 0.05] }}
start = {{ speed_mps = {speed} }}
"""


def lines(events: Iterable[Event]) -> tuple[list[str], Event]:
    found = list(events)
    assert found[-1].kind == "result"
    return [event.message for event in found if event.kind == "line"], found[-1]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with two scenarios of its own: 5 m/s and 30 m/s round a bend of 20 m."""
    folder = tmp_path / "bench_configs" / "scenarios"
    folder.mkdir(parents=True)
    for name, speed in (("slow_bend", 5.0), ("mad_bend", 30.0)):
        (folder / f"{name}.toml").write_text(SCENARIO.format(name=name, speed=speed))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_scenario_in_numbers(here: Path) -> None:
    row = describe_scenario(load_scenario("slow_bend"))
    assert row["duration_s"] == pytest.approx(10.0)
    assert row["length_m"] == pytest.approx(50.0)
    assert row["speed_mps"] == pytest.approx([5.0, 5.0])
    assert row["lateral_accel_mps2"] == pytest.approx(5.0 * 5.0 * 0.05)
    assert row["problems"] == []


def test_what_a_vehicle_cannot_drive_is_named(here: Path) -> None:
    said, result = lines(scenarios(ScenariosOptions("mad_bend", "mkz_bywire")))
    assert result.data["exit"] == 1
    assert "lateral acceleration 45" in said[-1]
    assert result.data["sentence"] == "mkz_bywire cannot drive 1 of 1 scenarios: mad_bend"


def test_all_scenarios_are_listed(here: Path) -> None:
    said, result = lines(scenarios(ScenariosOptions()))
    names = [line.split()[0] for line in said]
    assert {"slow_bend", "mad_bend", "left_turn"} <= set(names) and names == sorted(names)
    assert result.data["exit"] == 0
    assert all(len(line) <= 80 for line in said)


def test_the_scenarios_of_the_project_suit_its_first_vehicle() -> None:
    _, result = lines(scenarios(ScenariosOptions(vehicle="mkz_bywire")))
    assert result.data["exit"] == 0, result.data["sentence"]


@pytest.fixture
def codec() -> Codec:
    return Codec(load_vehicle("mkz_bywire"))


def write_log(path: Path, codec: Codec, ticks: int = 100, leave_out: str = "") -> Path:
    rows = []
    for k in range(ticks):
        for message in (*codec.telemetry, *codec.commands):
            if k % message.period_ticks == 0 and message.name != leave_out:
                count = k // message.period_ticks
                signals = {message.counter: count % message.counter_modulus} if message.counter else {}
                data = codec.encode(message, {}, signals).hex().upper()
                rows.append(f"({k * 0.01:.6f}) can0 {message.can_id:03X}#{data}\n")
    path.write_text("".join(rows))
    return path


def test_a_whole_log(tmp_path: Path, codec: Codec) -> None:
    path = write_log(tmp_path / "a.log", codec)
    said, result = lines(log_check.check(LogCheckOptions(path, "mkz_bywire")))
    assert result.data["exit"] == 0
    assert result.data["sentence"].endswith("in 0.99 s: no faults")
    assert len(said) == 1 + len(codec.telemetry) + len(codec.commands)


def test_a_log_with_a_silent_message_and_a_cut_end(tmp_path: Path, codec: Codec) -> None:
    silent = codec.telemetry[0].name
    path = write_log(tmp_path / "a.log", codec, leave_out=silent)
    path.write_text(path.read_text()[:-4])
    said, result = lines(log_check.check(LogCheckOptions(path, "mkz_bywire")))
    assert result.data["exit"] == 1
    faults = [line for line in said if line.startswith("fault: ")]
    assert len(faults) >= 2
    assert "incomplete" in faults[0] and f"fault: {silent} was never received" in faults


def test_the_run_folder_knows_the_vehicle(tmp_path: Path, codec: Codec) -> None:
    bench = "schema = 'tunefree.bench/1'\nvehicle = 'mkz_bywire'\nmodel = 'mkz_nominal'\nscenarios = ['left_turn']\n"
    (tmp_path / "bench.toml").write_text(bench)
    folder = tmp_path / "episodes" / "0"
    folder.mkdir(parents=True)
    _, result = lines(log_check.check(LogCheckOptions(write_log(folder / "vehicle.log", codec))))
    assert Path(result.data["vehicle"]).name == "mkz_bywire"


def test_a_lone_log_needs_its_vehicle(tmp_path: Path, codec: Codec) -> None:
    with pytest.raises(InputError, match="vehicle is not known"):
        list(log_check.check(LogCheckOptions(write_log(tmp_path / "a.log", codec))))


def test_frames_are_decoded(tmp_path: Path, codec: Codec) -> None:
    report = next(message for message in codec.telemetry if message.fields)
    path = write_log(tmp_path / "a.log", codec, ticks=1)
    with path.open("a") as file:
        file.write("(0.020000) can0 7FF#0102\n")
    said, result = lines(log_show.show(LogShowOptions(path, "mkz_bywire")))
    assert said[-1] == "0.020000 can0 7FF (foreign) 0102"
    assert result.data["shown"] == result.data["frames"] == len(said)
    field = report.fields[0]
    assert any(f" {report.name} " in line and f"{field.group}.{field.name}=" in line for line in said)


def test_only_what_was_asked_for(tmp_path: Path, codec: Codec) -> None:
    path = write_log(tmp_path / "a.log", codec, ticks=3)
    said, result = lines(log_show.show(LogShowOptions(path, "mkz_bywire", ["throttle_frac"])))
    assert said and all("throttle_frac=" in line and "brake" not in line for line in said)
    assert result.data["shown"] == len(said) < result.data["frames"]


def test_a_signal_that_there_is_not(tmp_path: Path, codec: Codec) -> None:
    with pytest.raises(InputError) as caught:
        list(log_show.show(LogShowOptions(write_log(tmp_path / "a.log", codec), "mkz_bywire", ["trottle_frac"])))
    assert "throttle_frac" in caught.value.hint


def test_the_measured_drive(shared_data: Path) -> None:
    """One minute of a real car: the only fault is command frames that were logged in the wrong order."""
    path = shared_data / "comma2k19_rav4" / "drive.candump.log"
    if not path.is_file():
        pytest.skip("no comma2k19_rav4/drive.candump.log in ../shared/data")
    _, result = lines(log_check.check(LogCheckOptions(path, "rav4_2017")))
    assert result.data["problems"] == ["STEERING_LKA: 4 frames came out of order"]
    assert result.data["foreign"][0x343] == 600


def test_scenarios_export_the_reference_drive(tmp_path: Path) -> None:
    events = list(scenarios(ScenariosOptions("u_turn", "mkz_bywire", export=tmp_path)))
    spec = load_scenario("u_turn")
    path = tmp_path / f"{spec.hash[:12]}.csv"
    assert events[-1].kind == "result" and [one.name for one in tmp_path.iterdir()] == [path.name]
    names = path.read_text().splitlines()[0].split(",")
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    t_s, x_m, y_m, heading_rad, speed_mps = rows[:, :5].T
    assert names[:5] == ["t_s", "x_m", "y_m", "heading_rad", "speed_mps"] and np.isfinite(rows).all()
    assert np.allclose(np.diff(t_s), 0.01)
    # the points move at the planned speed, the way they head
    assert np.hypot(np.diff(x_m), np.diff(y_m)).sum() == pytest.approx(speed_mps[:-1].sum() * 0.01, rel=0.01)
    assert abs(heading_rad[-1] - heading_rad[0]) == pytest.approx(np.pi, abs=0.3)
