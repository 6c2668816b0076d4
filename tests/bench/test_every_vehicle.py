"""What every vehicle folder and every bench file of the project must be able to do, whichever there are.

A vehicle comes as folders and no Python (docs/reference/files.md): these tests find it by looking.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.bench.tiny import write_scenario
from tests.house import ROOT
from tests.jobs.command import new_session, no_orphans, tunefree
from tools.measures._in_process import InProcess
from tunefree_hil.bench import Bench, load, model_of, parameters_of, require_buildable
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.recording.log_check import check_frames
from tunefree_hil.config.load import load_bench, load_model, load_vehicle
from tunefree_hil.config.schema import FaultSpec
from tunefree_hil.control.parameters import BoxChoice
from tunefree_hil.episode.candump import read_candump
from tunefree_hil.jobs.doctor import check_bench_file, check_vehicle_folder
from tunefree_hil.jobs.machine import FAULT
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors
from tunefree_hil.tune.space import resolve_space

VEHICLES = sorted(path.parent.name for path in (ROOT / "dbc").glob("*/vehicle.toml"))
BENCHES = sorted((ROOT / "bench_configs").glob("*.toml"))
OURS = [path for path in BENCHES if not load_bench(path).controller.command]  # the others start somebody's program
IN_TESTS = ("mkz_bywire", "rav4_2017")  # the vehicles that tests and tools may take as their example


def first_benches() -> list[Path]:
    """One bench file a vehicle: the others drive the same models."""
    found: dict[str, Path] = {}
    for path in OURS:
        found.setdefault(load_bench(path).vehicle, path)
    return list(found.values())


def shortest(bench: Bench) -> str:
    """The file name of the scenario that is over first."""
    return min(bench.spec.scenarios, key=lambda name: bench.course(bench.scenarios[name]).ticks)


@pytest.mark.parametrize("name", VEHICLES)
def test_a_vehicle_loads_and_the_doctor_finds_nothing(name: str) -> None:
    assert [finding for finding in check_vehicle_folder(Path(name)) if finding.kind == FAULT] == []
    vehicle = load_vehicle(name)
    assert vehicle.name == name, "a bench file's models are found by it"
    assert len(Codec(vehicle).by_id) == len(Codec(vehicle).by_name)


@pytest.mark.parametrize("path", BENCHES, ids=lambda path: path.stem)
def test_a_bench_can_be_built_on_both_of_its_models(path: Path) -> None:
    assert [finding for finding in check_bench_file(path) if finding.kind == FAULT] == []
    bench = load(path)
    values = compute_baseline_vectors(bench)["rule_based"] if path in OURS else parameters_of(bench)
    scenarios = list(bench.scenarios.values())  # each is checked against the vehicle's limits
    for model in filter(None, (bench.spec.model, bench.spec.verify_model)):
        assert model_of(bench, model).vehicle == bench.vehicle.name
        require_buildable(bench, model, scenarios, values)


@pytest.mark.parametrize("path", first_benches(), ids=lambda path: path.stem)
def test_rules_work_on_a_model_with_actuators_of_its_own(path: Path) -> None:
    """Then the data sheet's latencies count; they differ from the nominal model's by rounding at most."""
    bench = load(path)
    other = replace(bench, spec=msgspec.structs.replace(bench.spec, model=bench.spec.verify_model))
    nominal, own = compute_baseline_vectors(bench)["rule_based"], compute_baseline_vectors(other)["rule_based"]
    assert own == pytest.approx(nominal, rel=0.05)


@pytest.mark.parametrize("path", OURS, ids=lambda path: path.stem)
def test_names_of_baselines_claim_nothing_that_was_not_shipped(path: Path) -> None:
    bench = load(path)
    shipped = [name for name in compute_baseline_vectors(bench) if name.startswith(("as_shipped", "mrac_on"))]
    assert bool(shipped) == (bench.vehicle.manual_gains == "as_shipped")


@pytest.mark.parametrize("path", OURS, ids=lambda path: path.stem)
def test_a_bench_drives_with_manual_gains_of_its_own_vehicle(path: Path) -> None:
    """What is not searched stays manual. Without shipped gains that is `rule_based`, in the wider box."""
    bench = load(path)
    if bench.vehicle.manual_gains == "as_shipped":
        return
    rule = resolve_space("complete", [], box=BoxChoice.DEFAULT).clip(compute_baseline_vectors(bench)["rule_based"])
    assert {name: parameters_of(bench)[name] for name in rule} == pytest.approx(rule, rel=0.02)


@pytest.mark.parametrize("name", sorted(set(VEHICLES) - set(IN_TESTS)))
def test_no_python_names_a_vehicle_that_came_later(name: str) -> None:
    """Nor its models, bench files and scenarios of its own."""
    folders = [path.parent for path in (ROOT / "bench_configs" / "models").glob("*/model.toml")]
    models = [path.name for path in folders if load_model(path).vehicle == name]
    specs = [load_bench(path) for path in BENCHES]
    scenarios: dict[bool, set[str]] = {True: set(), False: set()}
    for spec in specs:
        scenarios[spec.vehicle == name].update((*spec.scenarios, *spec.verify_scenarios))
    benches = [Path(spec.path).stem for spec in specs if spec.vehicle == name]
    own = sorted(scenarios[True] - scenarios[False])
    assert models and benches and own
    words = re.compile("|".join(map(re.escape, [name, *models, *benches, *own])))
    files = [path for place in ("tunefree_hil", "tools", "tests") for path in (ROOT / place).rglob("*.py")]
    assert len(files) > 100
    assert [str(path.relative_to(ROOT)) for path in files if words.search(path.read_text(encoding="utf-8"))] == []


@pytest.mark.slow
@pytest.mark.parametrize("path", first_benches(), ids=lambda path: path.stem)
def test_rule_based_gains_drive_the_verify_model(path: Path) -> None:
    """To the end and on the path, on the vehicle that shares nothing with the model that the gains are for."""
    bench = load(path)
    drives = InProcess(bench, bench.spec.verify_model)
    graded, _ = drives.grade(bench.scenarios[shortest(bench)], compute_baseline_vectors(bench)["rule_based"])
    assert (graded.outcome, graded.replans) == ("finished", 0)
    peak = graded.metrics["lateral_err_peak"]
    assert peak is not None and 0.5 * peak < 0.5, "metres"


@pytest.mark.parametrize("path", first_benches(), ids=lambda path: path.stem)
def test_a_command_whose_counter_stands_still_is_not_obeyed(path: Path) -> None:
    """By a plain counter or by E2E: the watchdog brakes and names the channel, and the controller gives up."""
    bench = load(path)
    drives, values, name = InProcess(bench), parameters_of(bench), shortest(bench)
    steered = [one for one in bench.codec.commands if one.counter and {"steer", "brake"} & set(one.bywire)]
    assert steered
    for message in steered:
        drives.script([FaultSpec(kind="counter_freeze", message=message.name, from_tick=150, to_tick=250)])
        drive = drives.drive(bench.scenarios[name], values, until=200)
        assert drive.error in ("bywire_fault", "not_enabled"), message.name
        tripped = [line for line in drive.said if "watchdog: " in line]
        assert len(tripped) == 1 and any(f"watchdog: {one}_" in tripped[0] for one in message.bywire), drive.said


def few_seconds(path: Path, folder: Path) -> Path:
    """A bench file of the same vehicle, model and gains in `folder`, with nothing but a gentle bend of 3 s."""
    write_scenario(folder, duration_s=3.0)
    keys = re.compile(r"^(scenarios|verify_scenarios) = .*$", re.MULTILINE)
    text, count = keys.subn(r'\1 = ["tiny"]', path.read_text(encoding="utf-8"))
    assert count == 2
    file = folder / path.name
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.slow
@pytest.mark.parametrize("path", first_benches(), ids=lambda path: path.stem)
def test_a_drive_over_the_bus(path: Path, tmp_path: Path) -> None:
    """Driven to its end by three processes, and the log is whole: no frame late, lost, short or with a wrong CRC."""
    file, session = few_seconds(path, tmp_path), new_session()
    bench = load(file)
    with no_orphans(session):
        ended = tunefree("drive", file, "--bus", "tfhub", "--session", session, "--out", tmp_path, "--json")
    assert ended.status == 0, ended.words
    log = next(Path(ended.data["run"]).glob("episodes/*/vehicle.log"))
    frames = [(one.time_s, one.channel, one.can_id, one.data, one.flags) for one in read_candump(log)]
    health = check_frames(frames, bench.codec)
    due = sum(300 // one.period_ticks for one in (*bench.codec.telemetry, *bench.codec.commands))
    assert health.problems == [] and due - 10 <= len(frames) <= due + 20, "and a frame more or less of each message"
    with np.load(log.with_name("columns.npz")) as columns:
        assert len(columns["t_s"]) >= 300 - 10
        assert np.nanmax(np.abs(columns["lateral_error_m"])) < 0.5
