"""Drives pairs: the driver model and sets of gains on the same made roads, in the batch, road after road.

Every road's drives are one JSON file, written when they are complete: the same command continues after an interruption.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil import __version__
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, load
from tunefree_hil.bench.batch import Batch, Driven, Job
from tunefree_hil.config.dump import plain
from tunefree_hil.config.load import load_weights
from tunefree_hil.config.schema import ControllerSpec, ScenarioSpec, TuneSpec, WeightsSpec
from tunefree_hil.grade.score import GradeVehicle, ScenarioEnd, grade_drive, grade_vehicle_from_spec, weighted_mean
from tunefree_hil.grade.weight_regression.pairs import DrivePair, DriverKind, RankedDrive
from tunefree_hil.jobs.identity import compute_identity, data_sha256, file_sha256
from tunefree_hil.jobs.progress import count_data
from tunefree_hil.jobs.run_folder import read_json, write_json
from tunefree_hil.jobs.weights.gain_sets import make_driver_vectors, make_gain_sets
from tunefree_hil.jobs.weights.options import WeightsOptions
from tunefree_hil.roads.sets import road_set

DRIVER_FOLDER = Path(__file__).parent / "driver"
DRIVER_PARTS = {"lateral": DRIVER_FOLDER / "steering.py", "longitudinal": DRIVER_FOLDER / "pedals.py"}
COMPARED = ("paper",)  # weights that are compared on the same pairs, beside the base


class DrivingPlan(NamedTuple):
    """What is driven: benches of the gains and of the driver, their vectors by name, the roads, the model.

    identity: hash of everything that the drives depend on, without the roads.
    """

    bench: Bench
    driver_bench: Bench
    sets: Mapping[str, Mapping[str, float]]
    drivers: Mapping[str, Mapping[str, float]]
    roads: Sequence[ScenarioSpec]
    model: str
    compared: Mapping[str, WeightsSpec]
    identity: str


class RoadDrives(NamedTuple):
    """The drives of one road."""

    drivers: list[RankedDrive]
    generated: list[RankedDrive]


def drive_pairs(options: WeightsOptions, folder: Path) -> Generator[Event, None, list[DrivePair]]:
    """Drive the roads that are not in `folder` yet, with a progress event each, and pair the drives of all roads."""
    plan = make_plan(options)
    began, stored = time.monotonic(), {road.name: _read_road(folder, plan, road) for road in plan.roads}
    missing = [road for road in plan.roads if stored[road.name] is None]
    n_stored = len(plan.roads) - len(missing)
    if n_stored:
        yield Event("note", f"{n_stored} of {len(plan.roads)} roads were driven before")
    with ExitStack() as stack:
        if missing:
            drivers = stack.enter_context(Batch(plan.driver_bench, plan.model))
            generated = stack.enter_context(Batch(plan.bench, plan.model))
        for number, road in enumerate(missing):
            drives = RoadDrives(
                _drive(drivers, plan, plan.driver_bench, plan.drivers, road),
                _drive(generated, plan, plan.bench, plan.sets, road),
            )
            _write_road(folder, plan, road, drives)
            stored[road.name] = drives
            data = count_data("roads", number + 1, len(missing), began)
            yield Event("progress", f"{n_stored + number + 1} of {len(plan.roads)} roads: {road.name}", data)
    return [pair for road in plan.roads for pair in _pair(road, stored[road.name])]


def make_plan(options: WeightsOptions) -> DrivingPlan:
    """Everything that is driven. Raises InputError for a bench that cannot be used."""
    if options.bench is None:
        raise InputError("nothing to drive", code="usage", key="--bench", hint="name a bench file")
    base = load_weights(options.base)
    bench = replace(load(options.bench), weights=base)
    driver_bench = with_driver(bench)
    model = options.model or bench.spec.verify_model or bench.spec.model
    drivers = make_driver_vectors(driver_bench)
    sets = make_gain_sets(bench, options.sets, options.seed)
    compared = {name: load_weights(name) for name in COMPARED if name != base.name}
    roads = road_set(bench.vehicle, "families", options.roads, options.seed)
    code = {key: file_sha256(path) for key, path in DRIVER_PARTS.items()}
    vectors = {name: dict(values) for name, values in {**drivers, **sets}.items()}
    graded = [_without_path(base), *(_without_path(spec) for spec in compared.values())]
    identity = data_sha256([__version__, compute_identity(bench, model, [])["identity"], code, vectors, graded])
    return DrivingPlan(bench, driver_bench, sets, drivers, roads, model, compared, identity)


def with_driver(bench: Bench) -> Bench:
    """The bench with the driver model as its controller, which knows the vehicle by the bench's maps."""
    spec = bench.spec
    controller = ControllerSpec(
        lateral=f"{DRIVER_PARTS['lateral']}:CONTROLLER",
        longitudinal=f"{DRIVER_PARTS['longitudinal']}:CONTROLLER",
        calibration=spec.controller.calibration,
        steering_map=spec.controller.steering_map,
    )
    fields = {name: getattr(spec, name) for name in spec.__struct_fields__}
    return replace(bench, spec=type(spec)(**{**fields, "controller": controller, "tune": TuneSpec()}))


def task_of(scenario: ScenarioSpec) -> str:
    """Identity of a scenario as a task."""
    return f"{scenario.name}@{scenario.hash[:12]}"


def _drive(
    batch: Batch, plan: DrivingPlan, bench: Bench, vectors: Mapping[str, Mapping[str, float]], road: ScenarioSpec
) -> list[RankedDrive]:
    driven = batch.drive([Job(values, road) for values in vectors.values()], columns=True)
    car = grade_vehicle_from_spec(bench.vehicle)
    drives = [_measure(name, road, one, bench, plan, car) for name, one in zip(vectors, driven, strict=True)]
    return [drive for drive in drives if drive is not None]


def _measure(
    name: str, road: ScenarioSpec, driven: Driven, bench: Bench, plan: DrivingPlan, car: GradeVehicle
) -> RankedDrive | None:
    """The drive's metrics; None where the bench failed, which says nothing of the gains."""
    grade, recording = driven.grade, driven.recording
    if grade is None or recording is None:
        return None
    drive = RankedDrive(f"{name} on {road.name}", task_of(road), grade.metrics, grade.outcome, grade.replans)
    if not drive.is_decided_by_weights:
        return drive
    course, end = bench.course(road), ScenarioEnd(road.name, driven.error)
    scores = {
        other: weighted_mean(grade_drive(recording, course, spec, car, end).metrics, spec)
        for other, spec in plan.compared.items()
    }
    return drive._replace(other_scores=scores)


def _pair(road: ScenarioSpec, drives: RoadDrives | None) -> list[DrivePair]:
    if drives is None:
        return []
    return [
        DrivePair(human, generated, road.name, DriverKind.MODEL)
        for human in drives.drivers
        for generated in drives.generated
    ]


def _road_file(folder: Path, road: ScenarioSpec) -> Path:
    return folder / "drives" / f"{road.name}.json"


def _write_road(folder: Path, plan: DrivingPlan, road: ScenarioSpec, drives: RoadDrives) -> None:
    path = _road_file(folder, road)
    path.parent.mkdir(parents=True, exist_ok=True)
    data: dict[str, Any] = {"identity": plan.identity, "road": road.hash}
    data |= {side: [one._asdict() for one in getattr(drives, side)] for side in RoadDrives._fields}
    write_json(path, data)


def _read_road(folder: Path, plan: DrivingPlan, road: ScenarioSpec) -> RoadDrives | None:
    """The drives of a road as stored; None where they are missing or of something else."""
    path = _road_file(folder, road)
    if not path.is_file():
        return None
    data = read_json(path)
    if data.get("identity") != plan.identity or data.get("road") != road.hash:
        return None
    return RoadDrives(*([RankedDrive(**one) for one in data[side]] for side in RoadDrives._fields))


def _without_path(spec: WeightsSpec) -> dict[str, Any]:
    return {**plain(spec), "path": ""}
