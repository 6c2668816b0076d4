"""doctor finds what is planted, says how to mend it, and finds nothing in what ships with the project."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from tests import other_vehicle
from tests.bench.tiny import write_bench, write_scenario
from tests.house import ROOT
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bus.socketcan import kernel_link
from tunefree_hil.bus.socketcan.kernel_link import KernelLinkState
from tunefree_hil.jobs import machine
from tunefree_hil.jobs.doctor import check_bench_file, check_vehicle_folder, doctor
from tunefree_hil.jobs.machine import FAULT, NOTE, OK
from tunefree_hil.jobs.options.records import DoctorOptions


def run(**options: Any) -> tuple[list[str], Event]:
    found: Iterable[Event] = list(doctor(DoctorOptions(**{"bus": "tfhub", **options})))
    *rest, result = found
    return [event.message for event in rest], result


@pytest.mark.parametrize("name", sorted(path.parent.name for path in (ROOT / "dbc").glob("*/vehicle.toml")))
def test_the_vehicles_of_the_project_have_no_fault(name: str) -> None:
    assert [finding for finding in check_vehicle_folder(Path(name)) if finding.kind == FAULT] == []


@pytest.mark.parametrize("path", sorted((ROOT / "bench_configs").glob("*.toml")), ids=lambda path: path.stem)
def test_the_bench_files_of_the_project_have_no_fault(path: Path) -> None:
    assert [finding for finding in check_bench_file(path) if finding.kind == FAULT] == []


def test_all_faults_of_a_folder_at_once(tmp_path: Path) -> None:
    folder = tmp_path / "mkz"
    shutil.copytree(ROOT / "dbc" / "mkz_bywire", folder)
    file = folder / "vehicle.toml"
    text = file.read_text()
    text = text.replace('signal = "SCMD"', 'signal = "SCMMD"').replace("tick_ms = 10", "tick_ms = 7")
    file.write_text(text.replace("bitrate = 500_000", "bitrate = -1"))
    said, result = run(vehicle=folder)
    assert result.data["exit"] == 1
    words = "\n".join(said)
    assert "SCMMD" in words and "did you mean SCMD?" in words and "tick_ms" in words and "bitrate" in words
    assert str(file) in words


def test_a_file_that_is_no_toml_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "vehicle.toml").write_text("schema = [")
    _, result = run(vehicle=tmp_path)
    assert (result.data["exit"], len(result.data["findings"])) == (1, 1)


def test_a_wrong_name_is_the_users() -> None:
    with pytest.raises(InputError):
        run(vehicle=Path("no_such_car"))
    with pytest.raises(InputError):
        run(bench=Path("no_such_bench.toml"))


def test_a_bench_file_is_followed(tmp_path: Path) -> None:
    file = tmp_path / "b.toml"
    names = 'vehicle = "mkz_bywire"\nmodel = "no_model"\nscenarios = ["left_trun"]\nweights = "heavy"\n'
    file.write_text(f'schema = "tunefree.bench/1"\n{names}')
    found = [finding for finding in check_bench_file(file) if finding.kind == FAULT]
    assert len(found) == 3
    assert all(finding.remedy for finding in found)
    assert any("left_turn" in finding.text + finding.remedy for finding in found)


EFFECT = '[[effects]]\nname = "no_effect"\nparams = {}\n'
FAULT_OF = '[[faults]]\nkind = "drop"\nmessage = "NO_MESSAGE"\nfrom_tick = 1\nto_tick = 3\n'


@pytest.mark.parametrize(
    ("old", "new", "where", "words"),
    [
        ('model = "mkz_nominal"', f'model = "{other_vehicle.NOMINAL}"', "key vehicle", f"of {other_vehicle.NAME!r}"),
        ('verify_model = "mkz_nominal"', f'verify_model = "{other_vehicle.NOMINAL}"', "key vehicle",
         f"of {other_vehicle.NAME!r}"),
        ("[tune]", '[controller]\nlateral = "no_part"\n[tune]', "", "no 'no_part' in tunefree_hil.control.lateral"),
        ("[tune]", '[controller]\ncalibration = "missing.npz"\n[tune]', "missing.npz", "no such file"),
        ("[tune]", '[controller.parameters]\n"lqr.q1" = 55.0\n[tune]', "key controller.parameters.lqr.q1", "outside"),
        ("[tune]", EFFECT + "[tune]", "key effects[0]", "no 'no_effect'"),
        ("[tune]", FAULT_OF + "[tune]", "key faults[0].message", "NO_MESSAGE"),
        ("slower = 1.0", "slower = 99", "key tune.slower", "99 is not allowed"),
        ('set = "mrac"\n', "", "", ""),
        ('set = "mrac"\n', 'parameters = [{ name = "lqr.q1" }]\n', "", ""),
        ('set = "mrac"\ntrials = 3\nsampler = "random"\nslower = 1.0', "slower = 99", "key tune.slower", "99"),
        ("", "", "", ""),
    ],
)  # fmt: skip
def test_what_drive_or_tune_would_refuse_is_a_fault(tmp_path: Path, old: str, new: str, where: str, words: str) -> None:
    file = write_bench(tmp_path)
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    found = [finding for finding in check_bench_file(file) if finding.kind == FAULT]
    assert len(found) == bool(words), found
    assert all(where in finding.text and words in finding.text and finding.remedy for finding in found)


def test_faults_of_several_kinds_are_each_told_once(tmp_path: Path) -> None:
    """What the file names, what drive builds and what tune asks: all in one list, nothing in two wordings."""
    write_scenario(tmp_path, "mad_bend", curvature=0.9)
    file = write_bench(tmp_path, more=EFFECT + FAULT_OF + '[controller]\ncalibration = "missing.npz"\n')
    text = file.read_text().replace("slower = 1.0", "slower = 99").replace('["tiny"]', '["tiny", "mad_bend"]')
    file.write_text(text)
    found = [finding.text for finding in check_bench_file(file) if finding.kind == FAULT]
    marks = ("'mad_bend' cannot be driven", "no_effect", "missing.npz", "tune.slower")
    assert [sum(mark in text for text in found) for mark in marks] == [1, 1, 1, 1]
    assert len(found) == 4, found  # of the effects and the faults of the model's node the first that is met


@pytest.mark.parametrize("name", ["vehicle", "model", "scenario", "weights", "bench"])
def test_a_schema_is_json(name: str) -> None:
    said, result = run(schema=name)
    assert json.loads(said[0]) == result.data["schema"]
    assert "$defs" in result.data["schema"]


def test_this_machine() -> None:
    said, result = run()
    bench = "bench_configs/mkz_steer.toml"
    assert result.data["next"] == [f"tunefree-hil drive {bench}"] * (result.data["exit"] == 0 and Path(bench).is_file())
    kinds = {finding.kind for finding in result.data["findings"]}
    assert kinds <= {OK, NOTE, FAULT}
    assert any("python-can 4" in line for line in said)
    assert any("tfhub" in line for line in said)
    assert result.data["exit"] == (FAULT in kinds)


def test_an_old_python_is_a_fault() -> None:
    assert machine.check_python((3, 10, 1)).kind == FAULT
    assert machine.check_python((3, 12, 0)).kind == OK


def test_a_missing_package_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    real = machine.installed_version
    monkeypatch.setattr(machine, "installed_version", lambda name: "" if name in ("cantools", "torch") else real(name))
    found = {finding.text: finding.kind for finding in machine.check_packages()}
    assert found["cantools is missing"] == FAULT
    assert found["torch is not installed (only needed for the extra 'learn')"] == NOTE


def test_a_missing_entry_point_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    assert machine.check_entry_point().kind == OK
    monkeypatch.setattr(machine.metadata, "entry_points", lambda group: ())
    assert machine.check_entry_point().kind == FAULT


@pytest.mark.parametrize(
    ("state", "kind", "text", "remedy"),
    [
        (KernelLinkState(False, False, ""), NOTE, "there is no vcan0", "sudo ip link add dev vcan0 type vcan"),
        (KernelLinkState(True, False, "vcan"), NOTE, "vcan0 is down", "sudo ip link set up vcan0"),
        (KernelLinkState(True, True, "", 16, 10), NOTE, "hardware, mtu 16", "sudo ip link set vcan0 txqueuelen 1000"),
        (KernelLinkState(True, True, "", 72, 1000), NOTE, "never transmit", ""),
        (KernelLinkState(True, True, "vcan", 16, 1000), NOTE, "classic CAN only", "sudo ip link set vcan0 mtu 72"),
        (
            KernelLinkState(True, True, "vcan", 72, 1000),
            OK,
            "vcan, mtu 72 (classic CAN and CAN FD), txqueuelen 1000",
            "",
        ),
    ],
)
def test_a_can_link(state: KernelLinkState, kind: str, text: str, remedy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_link, "link_state", lambda name: state)
    found = machine.check_can_link("vcan0")
    assert found.kind == kind and text in found.text
    assert remedy in found.remedy and bool(remedy) == bool(found.remedy)


def test_can_links(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without CAN one note with the commands that make both links; with it every link there is."""
    monkeypatch.setattr(kernel_link, "kernel_has_can", lambda: False)
    (found,) = machine.check_can_links()
    assert found.kind == NOTE and "no CAN" in found.text
    for command in ("modprobe vcan", "ip link add dev vcan0 type vcan", "ip link set dev vcan1 mtu 72 up"):
        assert command in found.remedy
    monkeypatch.setattr(kernel_link, "kernel_has_can", lambda: True)
    monkeypatch.setattr(kernel_link, "can_names", lambda: ["can0", "vcan0"])
    monkeypatch.setattr(
        kernel_link, "link_state", lambda name: KernelLinkState(name != "vcan1", True, "vcan"[: 4 * (name > "v")])
    )
    told = {finding.text.split()[0]: finding.kind for finding in machine.check_can_links()}
    assert told == {"vcan0": OK, "the": NOTE, "can0": NOTE}


def test_a_bus_that_there_is_not() -> None:
    assert machine.check_bus("nonsense").kind == FAULT
    assert machine.check_bus("tfhub").kind == OK


def test_a_full_disk_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert machine.check_disk(tmp_path).kind == OK
    monkeypatch.setattr(machine, "MIN_FREE_GB", 1e9)
    assert machine.check_disk(tmp_path).kind == FAULT
