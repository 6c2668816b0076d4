"""Says what a machine, a vehicle folder or a bench file lacks, and the command that mends it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.command_text import pasted
from tunefree_hil.jobs.machine import FAULT, NOTE, OK, Finding, machine

if TYPE_CHECKING:
    from tunefree_hil.config.schema import BenchSpec, VehicleSpec

SOME_SET = "mrac"  # searched where a bench file leaves it to `tune --set`: its other keys are checked all the same
FIRST_BENCH = Path("bench_configs/mkz_steer.toml")
T = TypeVar("T")


def doctor(*, vehicle: Path | None, schema: str | None, bus: str, bench: Path | None) -> Iterator[Event]:
    """One line a finding on stdout; exit 1 when one is a fault. With `schema` only the JSON Schema."""
    if schema is not None:
        yield from _schema(schema)
        return
    findings: list[Finding] = []
    if vehicle is not None:
        findings += vehicle_findings(vehicle)
    if bench is not None:
        findings += bench_findings(bench)
    if vehicle is None and bench is None:
        findings += machine(bus)
    for finding in findings:
        yield Event("line", f"{finding.kind:<6}{finding.text}")
        if finding.remedy:
            yield Event("line", f"{'':6}  what to do: {finding.remedy}")
    faults = sum(finding.kind == FAULT for finding in findings)
    sentence = f"{faults} fault{'' if faults == 1 else 's'} found" if faults else "no fault found"
    drivable = bench or (FIRST_BENCH if vehicle is None and FIRST_BENCH.is_file() else None)
    following = [pasted("drive", drivable)] if drivable and not faults else []
    data = {"findings": findings, "sentence": sentence, "exit": 1 if faults else 0, "next": following}
    yield Event("result", "", data)


def _schema(name: str) -> Iterator[Event]:
    from tunefree_hil.config.load import json_schema

    schema = json_schema(name)
    yield Event("line", json.dumps(schema, indent=2))
    yield Event("result", "", {"schema": schema, "sentence": f"the JSON Schema of {name} files"})


def vehicle_findings(folder: Path) -> list[Finding]:
    """Everything that is wrong with a vehicle folder, at once; what it lacks and assumes as notes."""
    from tunefree_hil.bus.dbc.check_vehicle import check_vehicle
    from tunefree_hil.config.check_vehicle import check_fields
    from tunefree_hil.config.find import find
    from tunefree_hil.config.load import load_vehicle

    find("vehicle", folder)  # a name that is wrong is the user's, not a fault of a file: it is raised
    findings: list[Finding] = []
    spec = _try(findings, lambda: load_vehicle(folder, check=False))
    if spec is None:
        return findings
    findings += [_fault(error) for error in check_fields(spec)]
    problems = _try(findings, lambda: check_vehicle(spec))
    known = {finding.text for finding in findings}
    findings += [one for one in map(_fault, problems or []) if one.text not in known]
    if not findings:
        findings.append(Finding(OK, _of_vehicle(spec), ""))
    if spec.absent:
        findings.append(Finding(NOTE, f"it does not have {', '.join(spec.absent)}", ""))
    assumed = sorted(set(_assumed(spec)))
    if assumed:
        findings.append(Finding(NOTE, f"assumed, not stated by a source: {', '.join(assumed)}", ""))
    return findings


def _of_vehicle(spec: VehicleSpec) -> str:
    counts = [f"{len(getattr(spec, group))} {group} fields" for group in ("command", "report", "ins")]
    return f"{spec.folder}: {spec.name}, {', '.join(counts)}, {spec.bitrate // 1000} kbit/s"


def _assumed(spec: VehicleSpec) -> Iterator[str]:
    """The keys of whatever the folder marks as assumed."""
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


def bench_findings(file: Path) -> list[Finding]:
    """A bench file and all it names: vehicle, models, weights, scenarios, and what `drive` and `tune` build of them."""
    from tunefree_hil.config.find import find
    from tunefree_hil.config.load import load_bench, load_model, load_weights

    find("bench", file)
    findings: list[Finding] = []
    spec = _try(findings, lambda: load_bench(file))
    if spec is None:
        return findings
    findings += [one for one in vehicle_findings_of(spec) if one.kind == FAULT]
    for name in filter(None, (spec.model, spec.verify_model)):
        _try(findings, lambda name=name: load_model(name, spec.path))
    _try(findings, lambda: load_weights(spec.weights, spec.path))
    findings += _scenario_findings(spec)
    findings += _start_findings(file, findings)
    if not findings:
        count = len(spec.scenarios) + len(spec.verify_scenarios)
        findings.append(Finding(OK, f"{spec.path}: {spec.vehicle}, {spec.model}, {count} scenarios", ""))
    return findings


def vehicle_findings_of(spec: BenchSpec) -> list[Finding]:
    """The findings of the vehicle that a bench file names."""
    from tunefree_hil.config.check_drive import check_drive
    from tunefree_hil.config.find import find
    from tunefree_hil.config.load import load_vehicle

    findings: list[Finding] = []
    path = _try(findings, lambda: find("vehicle", spec.vehicle, spec.path))
    if path is None:
        return findings
    vehicle = _try([], lambda: load_vehicle(path.parent, check=False))  # what cannot be read is told by the next line
    return vehicle_findings(path.parent) + [_fault(error) for error in (check_drive(vehicle) if vehicle else [])]


def _scenario_findings(spec: BenchSpec) -> list[Finding]:
    from tunefree_hil.config.load import load_scenario, load_vehicle
    from tunefree_hil.episode.feasible import limits_of, require_feasible
    from tunefree_hil.episode.scenario import build_course

    findings: list[Finding] = []
    vehicle = _try([], lambda: load_vehicle(spec.vehicle, spec.path))  # its own faults are told elsewhere

    def drivable(name: str) -> None:
        scenario = load_scenario(name, spec.path)
        if vehicle is not None:
            require_feasible(scenario, build_course(scenario, vehicle.tick_ms * 1e-3), limits_of(vehicle))

    for name in dict.fromkeys([*spec.scenarios, *spec.verify_scenarios]):
        _try(findings, lambda name=name: drivable(name))
    return findings


def _start_findings(file: Path, told: Sequence[Finding]) -> list[Finding]:
    """What `drive` and `tune` refuse before they start a process, beyond what is told; each fault once."""
    from tunefree_hil.bench import ControllerFor, load, parameters_of, require_buildable
    from tunefree_hil.control.parameters import NAMES
    from tunefree_hil.jobs.tune.options import Asked, resolve_wish

    findings: list[Finding] = []
    bench = _try(findings, lambda: load(file))
    if bench is None:  # where something is told, it is told of the file that has the fault
        return [] if told else findings
    spec = bench.spec

    def controller() -> None:
        values = parameters_of(bench)
        start = bytes.fromhex(bench.scenarios[spec.scenarios[0]].hash)[:6]
        ControllerFor(bench)(start, {index: values[name] for index, name in enumerate(NAMES)})

    def search() -> None:
        named = spec.tune.set or spec.tune.parameters
        resolve_wish(Asked(file, set_name=None if named else SOME_SET, bus="tfhub"))  # whatever links are up here

    for model in filter(None, (spec.model, spec.verify_model)):
        _try(findings, lambda model=model: require_buildable(bench, model, [], {}))
    _try(findings, controller)
    _try(findings, search)
    known = {finding.text for finding in told}
    return [one for text, one in {one.text: one for one in findings}.items() if text not in known]


def _try(findings: list[Finding], load: Callable[[], T]) -> T | None:
    """What `load` gives, or None and its mistake among the findings."""
    try:
        return load()
    except InputError as error:
        findings.append(_fault(error))
        return None


def _fault(error: InputError) -> Finding:
    where = error.file + (f", key {error.key}" if error.key else "")
    return Finding(FAULT, f"{where}: {error.message}" if where else error.message, error.hint)
