"""Check a machine, a vehicle folder or a bench file, and name the command or change that fixes each fault."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.command_text import shell_command
from tunefree_hil.jobs.machine import FAULT, NOTE, OK, DoctorFinding, check_machine
from tunefree_hil.jobs.options.records import DoctorOptions, TuneOptions

if TYPE_CHECKING:
    from tunefree_hil.config.schema import BenchSpec, VehicleSpec

FALLBACK_SET = "mrac"  # for a bench file without parameters to tune, so that its other keys can be checked
FIRST_BENCH = Path("bench_configs/mkz_steer.toml")
T = TypeVar("T")


def doctor(options: DoctorOptions) -> Iterator[Event]:
    """One line a finding on stdout; exit 1 on a fault. With `options.schema` only the JSON Schema is printed."""
    vehicle, bench = options.vehicle, options.bench
    if options.schema is not None:
        yield from _print_schema(options.schema)
        return
    findings: list[DoctorFinding] = []
    if vehicle is not None:
        findings += check_vehicle_folder(vehicle)
    if bench is not None:
        findings += check_bench_file(bench)
    if vehicle is None and bench is None:
        findings += check_machine(options.bus)
    for finding in findings:
        yield Event("line", f"{finding.kind:<6}{finding.text}")
        if finding.remedy:
            yield Event("line", f"{'':6}  what to do: {finding.remedy}")
    faults = sum(finding.kind == FAULT for finding in findings)
    sentence = f"{faults} fault{'' if faults == 1 else 's'} found" if faults else "no fault found"
    drivable = bench or (FIRST_BENCH if vehicle is None and FIRST_BENCH.is_file() else None)
    following = [shell_command("drive", drivable)] if drivable and not faults else []
    data = {"findings": findings, "sentence": sentence, "exit": 1 if faults else 0, "next": following}
    yield Event("result", "", data)


def _print_schema(name: str) -> Iterator[Event]:
    from tunefree_hil.config.load import json_schema

    schema = json_schema(name)
    yield Event("line", json.dumps(schema, indent=2))
    yield Event("result", "", {"schema": schema, "sentence": f"the JSON Schema of {name} files"})


def check_vehicle_folder(folder: Path) -> list[DoctorFinding]:
    """All faults of a vehicle folder; absent and assumed values as notes."""
    from tunefree_hil.bus.dbc.check_vehicle import check_vehicle
    from tunefree_hil.config.check_vehicle import check_fields
    from tunefree_hil.config.find import find
    from tunefree_hil.config.load import load_vehicle

    find("vehicle", folder)  # a wrong name is raised: it is an error of the command line, not of a file
    findings: list[DoctorFinding] = []
    spec = _try_loading(findings, lambda: load_vehicle(folder, check=False))
    if spec is None:
        return findings
    findings += [_fault_from_error(error) for error in check_fields(spec)]
    problems = _try_loading(findings, lambda: check_vehicle(spec))
    known = {finding.text for finding in findings}
    findings += [one for one in map(_fault_from_error, problems or []) if one.text not in known]
    if not findings:
        findings.append(DoctorFinding(OK, _vehicle_summary(spec), ""))
    if spec.absent:
        findings.append(DoctorFinding(NOTE, f"signals that this vehicle does not have: {', '.join(spec.absent)}", ""))
    assumed = sorted(set(_assumed_keys(spec)))
    if assumed:
        findings.append(DoctorFinding(NOTE, f"assumed values without a source: {', '.join(assumed)}", ""))
    return findings


def _vehicle_summary(spec: VehicleSpec) -> str:
    counts = [f"{len(getattr(spec, group))} {group} fields" for group in ("command", "report", "ins")]
    return f"{spec.folder}: {spec.name}, {', '.join(counts)}, {spec.bitrate // 1000} kbit/s"


def _assumed_keys(spec: VehicleSpec) -> Iterator[str]:
    """Keys that the folder marks as assumed."""
    for group in ("command", "report", "ins", "latency", "state"):
        for name, table in getattr(spec, group).items():
            tables = table if isinstance(table, list) else [table]
            if any(one.assumed for one in tables):
                yield f"{group}.{name}"
    for name in ("nominal", "limits"):
        for key in getattr(spec, name).assumed:
            yield f"{name}.{key}"
    for name in ("ins_frame", "override"):
        if getattr(spec, name).assumed:
            yield name


def check_bench_file(file: Path) -> list[DoctorFinding]:
    """Faults of a bench file and its vehicle, models, weights and scenarios, and of what `drive` and `tune` build."""
    from tunefree_hil.config.find import find
    from tunefree_hil.config.load import load_bench, load_model, load_weights

    find("bench", file)
    findings: list[DoctorFinding] = []
    spec = _try_loading(findings, lambda: load_bench(file))
    if spec is None:
        return findings
    findings += [one for one in check_vehicle_of_bench(spec) if one.kind == FAULT]
    for name in filter(None, (spec.model, spec.verify_model)):
        _try_loading(findings, lambda name=name: load_model(name, spec.path))
    _try_loading(findings, lambda: load_weights(spec.weights, spec.path))
    findings += _check_scenarios(spec)
    findings += _check_start(file, findings)
    if not findings:
        count = len(spec.scenarios) + len(spec.verify_scenarios) + _count_roads(spec)
        findings.append(DoctorFinding(OK, f"{spec.path}: {spec.vehicle}, {spec.model}, {count} scenarios", ""))
    return findings


def _count_roads(spec: BenchSpec) -> int:
    from tunefree_hil.config.check import parse_road_set

    texts = (spec.roads.search, spec.roads.verify) if spec.roads else ()
    return sum(parse_road_set(text).count for text in texts if text)


def check_vehicle_of_bench(spec: BenchSpec) -> list[DoctorFinding]:
    """Findings of the vehicle of a bench file."""
    from tunefree_hil.config.check_drive import check_drive
    from tunefree_hil.config.find import find
    from tunefree_hil.config.load import load_vehicle

    findings: list[DoctorFinding] = []
    path = _try_loading(findings, lambda: find("vehicle", spec.vehicle, spec.path))
    if path is None:
        return findings
    vehicle = _try_loading([], lambda: load_vehicle(path.parent, check=False))  # the next line reports its errors
    return check_vehicle_folder(path.parent) + [
        _fault_from_error(error) for error in (check_drive(vehicle) if vehicle else [])
    ]


def _check_scenarios(spec: BenchSpec) -> list[DoctorFinding]:
    from tunefree_hil.config.load import load_scenario, load_vehicle
    from tunefree_hil.episode.feasible import limits_of, require_feasible
    from tunefree_hil.episode.scenario import build_course

    findings: list[DoctorFinding] = []
    vehicle = _try_loading([], lambda: load_vehicle(spec.vehicle, spec.path))  # faults: see above

    def drivable(name: str) -> None:
        scenario = load_scenario(name, spec.path)
        if vehicle is not None:
            require_feasible(scenario, build_course(scenario, vehicle.tick_ms * 1e-3), limits_of(vehicle))

    for name in dict.fromkeys([*spec.scenarios, *spec.verify_scenarios]):
        _try_loading(findings, lambda name=name: drivable(name))
    return findings


def _check_start(file: Path, known: Sequence[DoctorFinding]) -> list[DoctorFinding]:
    """Faults that `drive` and `tune` detect before they start a process, without the known ones; each once."""
    from tunefree_hil.bench import ControllerFor, load, parameters_of, require_buildable
    from tunefree_hil.jobs.tune.options import make_tune_plan

    findings: list[DoctorFinding] = []
    bench = _try_loading(findings, lambda: load(file))
    if bench is None:  # a known finding names the faulty file more precisely
        return [] if known else findings
    spec = bench.spec

    def controller() -> None:
        start = bytes.fromhex(bench.scenarios[spec.scenarios[0]].hash)[:6]
        made = ControllerFor(bench)
        made(start, made.indexed(parameters_of(bench)))

    def search() -> None:
        named = spec.tune.set or spec.tune.parameters
        make_tune_plan(
            TuneOptions(file, set_name=None if named else FALLBACK_SET, bus="tfhub")
        )  # independent of this machine's links

    for model in filter(None, (spec.model, spec.verify_model)):
        _try_loading(findings, lambda model=model: require_buildable(bench, model, [], {}))
    _try_loading(findings, controller)
    _try_loading(findings, search)
    known_texts = {finding.text for finding in known}
    by_text = {finding.text: finding for finding in findings}
    return [finding for text, finding in by_text.items() if text not in known_texts]


def _try_loading(findings: list[DoctorFinding], load: Callable[[], T]) -> T | None:
    """Result of `load`; on an InputError None, with the error added to the findings."""
    try:
        return load()
    except InputError as error:
        findings.append(_fault_from_error(error))
        return None


def _fault_from_error(error: InputError) -> DoctorFinding:
    where = error.file + (f", key {error.key}" if error.key else "")
    return DoctorFinding(FAULT, f"{where}: {error.message}" if where else error.message, error.hint)
