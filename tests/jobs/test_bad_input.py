"""At the command line: what does not fit gives one message with file, key and a way on, and nothing is left running."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench, write_scenario
from tests.house import ROOT
from tunefree_hil.cli.entry import run

BENCH = ROOT / "bench_configs" / "mkz_steer.toml"


@pytest.fixture(autouse=True)
def no_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every mistake here must be found before a process is started."""

    def start(*arguments: object, **options: object) -> None:
        raise AssertionError("a process was started")

    monkeypatch.setattr("tunefree_hil.jobs.running.processes.Processes.start", start)


@pytest.fixture
def said(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command line; its one error message. The exit status must be 2."""

    def said(*words: object, status: int = 2) -> str:
        ended = run([str(word) for word in words])
        text = capsys.readouterr().err
        assert "Traceback" not in text, text
        assert ended == status, text
        lines = [line for line in text.splitlines() if line.startswith("error:")]
        assert len(lines) == 1, text
        assert "what to do:" in text
        return text[text.index("error:") :]

    return said


def drive(tmp_path: Path, file: Path = BENCH) -> tuple[object, ...]:
    return ("drive", file, "--plain", "--out", tmp_path / "runs")


@pytest.mark.parametrize("command", ["drive", "tune"])
@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("seed = 1", "sead = 1", ["key sead", "did you mean seed"]),
        ('model = "mkz_nominal"\nverify_model', "verify_model", ["key model", "missing"]),
        ("seed = 1", 'seed = "1 m/s"', ["key seed", "expected a whole number"]),
        ("seed = 1", "seed = 1\n[controller]\nlook_ahead_m = nan", ["key controller.look_ahead_m", "finite"]),
        ('vehicle = "mkz_bywire"', 'vehicle = "mkz"', ["'mkz'", "mkz_bywire"]),
        ('\nmodel = "mkz_nominal"', '\nmodel = "mkz"', ["no model 'mkz'", "mkz_nominal"]),
        ('\nscenarios = ["tiny"]', '\nscenarios = ["tinny"]', ["no scenario 'tinny'", "tiny"]),
        ("seed = 1", 'seed = 1\nweights = "heavy"', ["no weights 'heavy'", "default"]),
        ("seed = 1", 'seed = 1\n[controller]\nlateral = "lqrr"', ["'lqrr'", "lqr"]),
        (
            "seed = 1",
            'seed = 1\n[[effects]]\nname = "steer_lagg"\nparams = {}',
            ["key effects[0]", "steer_lagg", "steer_lag"],
        ),
        (
            "seed = 1",
            'seed = 1\n[[effects]]\nname = "steer_lag"\nparams = { tau_ms = 1.0 }',
            ["key effects[0].params.tau_ms", "tau_s [s]"],
        ),
        (
            "seed = 1",
            'seed = 1\n[[faults]]\nchannel = "brake"\nkind = "lost"\nfrom_tick = 1\nto_tick = 2',
            ["key faults[0].kind", "driver_override"],
        ),
        (
            "seed = 1",
            'seed = 1\n[controller.parameters]\n"mrac.t_ref_s" = 0.0',
            ["key controller.parameters.mrac.t_ref_s", "outside its box", "0.01 to 0.5"],
        ),
    ],
)
def test_a_bench_file_that_does_not_fit(
    command: str, old: str, new: str, parts: list[str], tmp_path: Path, said: Callable[..., str]
) -> None:
    file = write_bench(tmp_path)
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    words = said(command, file, "--plain", "--out", tmp_path / "runs")
    for part in parts:
        assert part in words, words
    if "key" in words:
        assert str(tmp_path) in words, "the file must be named"
    assert not list((tmp_path / "runs").glob("*")), "no run folder for a run that never began"


@pytest.mark.parametrize(
    ("value", "parts"),
    [
        ("mrac.t_ref_s=0", ["mrac.t_ref_s = 0", "0.01 to 0.5 s"]),
        ("mrac.t_ref=0.1", ["unknown parameter 'mrac.t_ref'", "mrac.t_ref_s"]),
        ("lqr.q1=big", ["has no number", "lqr.q1=0.1"]),
        ("lqr.q1", ["has no number"]),
        ("lqr.q1=nan", ["lqr.q1 = nan"]),
        ("lqr.q1=1e999", ["lqr.q1 = inf"]),
    ],
)
def test_a_parameter_that_cannot_be(value: str, parts: list[str], tmp_path: Path, said: Callable[..., str]) -> None:
    words = said(*drive(tmp_path), "--parameter", value)
    assert all(part in words for part in parts), words


def test_a_shipped_value_outside_its_box_may_be_driven(tmp_path: Path, said: Callable[..., str]) -> None:
    """q2 = 0 passes; the next mistake is then the one that is said."""
    assert "no scenario 'nope'" in said(*drive(tmp_path), "--parameter", "lqr.q2=0", "--scenario", "nope")


def test_a_scenario_the_vehicle_cannot_drive(tmp_path: Path, said: Callable[..., str]) -> None:
    path = write_scenario(tmp_path, "hairpin", curvature=0.9)
    words = said(*drive(tmp_path), "--scenario", path)
    assert str(path) in words and "curvature" in words


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("t_s = [0.0, 2.0]", "t_s = [0.0, -2.0]", ["speed.t_s[1]"]),
        ("value = [5.0, 5.0]", "value = [5.0, nan]", ["speed.value[1]", "finite"]),
        ("value = [5.0, 5.0]", 'value = [5.0, "5 km/h"]', ["speed.value[1]", "expected a number"]),
        ("noise_seed = 3", "noise_seed = 70000", ["noise_seed"]),
    ],
)
def test_a_scenario_that_does_not_fit(
    old: str, new: str, parts: list[str], tmp_path: Path, said: Callable[..., str]
) -> None:
    path = write_scenario(tmp_path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    words = said(*drive(tmp_path), "--scenario", path)
    assert all(part in words for part in [str(path), *parts]), words


def own_vehicle(folder: Path, name: str, old: str, new: str) -> Path:
    """A bench file with a vehicle folder of its own, in which one file was changed."""
    shutil.copytree(ROOT / "dbc" / "mkz_bywire", folder / "dbc" / "mkz_bywire")
    file = folder / "dbc" / "mkz_bywire" / name
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    bench = write_bench(folder)
    bench.write_text(bench.read_text().replace('vehicle = "mkz_bywire"', 'vehicle = "dbc/mkz_bywire"'))
    return bench


@pytest.mark.parametrize(
    ("name", "old", "new", "parts"),
    [
        ("vehicle.dbc", "SG_ SCMD ", "SG_ SCNOT ", ["SCMD", "command.steer_rad"]),
        ("vehicle.toml", 'message = "GYRO"', 'message = "GYROO"', ["GYROO", "report.yaw_rate_radps"]),
        ("vehicle.toml", "period_ms = 10\ntimeout_ms", "period_ms = 0\ntimeout_ms", ["period_ms"]),
        ("vehicle.toml", 'counter = "COUNT"', 'counter = "CONT"', ["CONT", "COUNT"]),
        ("vehicle.toml", "tick_ms = 10", "tick_ms = 0", ["tick_ms"]),
        ("vehicle.toml", "scale = 0.017453292519943295", "scale = 0.0", ["scale"]),
        ("vehicle.toml", "mass_kg = 2080.0", "mass_kg = -1.0", ["nominal.mass_kg"]),
        ("vehicle.toml", "yaw_inertia_kgm2 = 4208.3", "", ["nominal.yaw_inertia_kgm2"]),
        ("vehicle.toml", "bitrate = 500_000", 'bitrate = "500 kbit/s"', ["bitrate", "whole number"]),
    ],
)
def test_a_vehicle_folder_that_does_not_fit(
    name: str, old: str, new: str, parts: list[str], tmp_path: Path, said: Callable[..., str]
) -> None:
    words = said(*drive(tmp_path, own_vehicle(tmp_path, name, old, new)))
    for part in [str(tmp_path / "dbc" / "mkz_bywire"), *parts]:
        assert part in words, words


LATENCY = "[latency.steer]\ndead_time_s = 0.1\nrise_time_s = 0.17\n"


@pytest.mark.parametrize("command", ["drive", "tune"])
def test_mrac_on_a_vehicle_that_states_no_steering_lag(command: str, tmp_path: Path, said: Callable[..., str]) -> None:
    bench = own_vehicle(tmp_path, "vehicle.toml", LATENCY, "")
    assert "[latency.steer]" in said(command, bench, "--plain", "--out", tmp_path / "runs")
    assert not (tmp_path / "runs").exists()


def test_without_mrac_such_a_vehicle_is_driven_and_not_tuned(tmp_path: Path, said: Callable[..., str]) -> None:
    """A tune's baselines have MRAC on. What passes comes to the next mistake, the bus."""
    bench = own_vehicle(tmp_path, "vehicle.toml", LATENCY, "")
    off = '[controller.parameters]\n"mrac.enable" = 0.0\n'
    bench.write_text(bench.read_text().replace("[tune]", off + "[tune]"))
    assert "no bus 'nonsense'" in said(*drive(tmp_path, bench), "--bus", "nonsense")
    assert "[latency.steer]" in said("tune", bench, "--bus", "nonsense")


@pytest.mark.parametrize(("searched", "asks"), [("mine.gain", "no bus"), ("mrac.p", "[latency.steer]")])
def test_a_controller_without_our_baselines_needs_it_where_mrac_is_searched(
    searched: str, asks: str, tmp_path: Path, said: Callable[..., str]
) -> None:
    bench = own_vehicle(tmp_path, "vehicle.toml", LATENCY, "")
    own = '[controller.parameters]\n"mrac.enable" = 0.0\n"mine.gain" = 0.5\n'
    boxes = f'parameters = [{{ name = "{searched}", low = 0.01, high = 0.1 }}]'
    bench.write_text(bench.read_text().replace("[tune]", own + "[tune]").replace('set = "mrac"', boxes))
    assert asks in said("tune", bench, "--bus", "nonsense")


def test_somebody_elses_controller_has_no_mrac_of_ours(tmp_path: Path, said: Callable[..., str]) -> None:
    bench = own_vehicle(tmp_path, "vehicle.toml", LATENCY, "")
    for command in ("drive", "tune"):
        assert "no bus 'nonsense'" in said(command, bench, "--controller", "./mine", "--bus", "nonsense")


def test_a_counter_of_no_bits(tmp_path: Path, said: Callable[..., str]) -> None:
    text = (ROOT / "dbc" / "mkz_bywire" / "vehicle.dbc").read_text()
    line = next(line for line in text.splitlines() if line.strip().startswith("SG_ COUNT "))
    place = line.split(": ")[1].split("@")[0]
    none = line.replace(place, place.split("|")[0] + "|0")
    words = said(*drive(tmp_path, own_vehicle(tmp_path, "vehicle.dbc", line, none)))
    assert str(tmp_path) in words and "COUNT" in words


@pytest.mark.parametrize(
    ("bus", "parts"),
    [
        ("nonsense", ["no bus 'nonsense'", "tfhub"]),
        ("pcan:PCAN_USBBUS1", ["safety gate"]),
        ("slcan:/dev/ttyACM0", ["safety gate"]),
        ("virtual", ["inside one process only", "--bus tfhub"]),
        ("tfhub:tcp:192.0.2.1:4000", ["192.0.2.1", "loopback"]),
    ],
)
def test_a_bus_that_may_not_be_used(bus: str, parts: list[str], tmp_path: Path, said: Callable[..., str]) -> None:
    words = said(*drive(tmp_path), "--bus", bus)
    assert all(part in words for part in parts), words
    assert not (tmp_path / "runs").exists(), "no run folder for a run that never began"


def test_socketcan_on_this_kernel(tmp_path: Path, said: Callable[..., str]) -> None:
    from tunefree_hil.bus.socketcan.kernel_link import kernel_has_can, link_state

    if kernel_has_can() and link_state("vcan0").exists:
        pytest.skip("this kernel has vcan0")
    words = said(*drive(tmp_path), "--bus", "socketcan:vcan0")
    assert ("no CAN" if not kernel_has_can() else "vcan0") in words and "modprobe vcan" in words


def test_transmit_is_refused_on_a_link_that_is_not_vcan(
    tmp_path: Path, said: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real adapter that is up: the kernel says 'can', or nothing; its name does not count."""
    from tunefree_hil.bus import open as module
    from tunefree_hil.bus.socketcan import kernel_link

    for kind in ("can", "", "slcan"):
        monkeypatch.setattr(module, "kernel_has_can", lambda: True)
        monkeypatch.setattr(module, "link_state", lambda name, kind=kind: kernel_link.KernelLinkState(True, True, kind))
        assert "safety gate" in said(*drive(tmp_path), "--bus", "socketcan:vcan0")


@pytest.mark.parametrize("command", [["drive"], ["tune"], ["ecu"], ["controller"]])
def test_a_bench_file_that_there_is_not(command: list[str], tmp_path: Path, said: Callable[..., str]) -> None:
    words = said(*command, tmp_path / "b.toml")
    assert str(tmp_path / "b.toml") in words and "mkz_steer" in words


def test_a_place_for_runs_that_cannot_be_made(tmp_path: Path, said: Callable[..., str]) -> None:
    (tmp_path / "runs").write_text("a file")
    words = said(*drive(tmp_path), "--scenario", "stop_from_12mps")
    assert str(tmp_path / "runs") in words and "--out" in words


LOGS = {
    "empty": ("", "the log is empty"),
    "foreign": ("Chronology of trains\n14:01 left\n", "not a candump log"),
    "binary": ("\x7fELF\x02\x01\x01\n", "not a candump log"),
}


@pytest.mark.parametrize("name", LOGS)
def test_a_log_that_is_none(name: str, tmp_path: Path, said: Callable[..., str]) -> None:
    path = tmp_path / "a.log"
    path.write_text(LOGS[name][0])
    words = said("log", "check", path, "--vehicle", "mkz_bywire")
    assert str(path) in words and LOGS[name][1] in words


def test_a_log_that_there_is_not(tmp_path: Path, said: Callable[..., str]) -> None:
    assert "nothing.log" in said("log", "check", tmp_path / "nothing.log", "--vehicle", "mkz_bywire")


@pytest.mark.parametrize("command", [["replay"], ["replay", "--verify"], ["verify"], ["tune", "--resume"]])
def test_a_folder_that_is_no_run(command: list[str], tmp_path: Path, said: Callable[..., str]) -> None:
    for place in (tmp_path, tmp_path / "nothing"):
        words = said(*command, place)
        assert str(place) in words
