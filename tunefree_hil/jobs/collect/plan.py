"""Options of a collection, its run folder, and the files of its drives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, load
from tunefree_hil.bench.load import whole_vehicle
from tunefree_hil.collect.cells import TargetCell, max_planned_speed_mps
from tunefree_hil.collect.envelope import Envelope, area_side_for_speed_m, envelope_from_vehicle
from tunefree_hil.collect.plan import plannable_cells
from tunefree_hil.config.dump import plain, to_toml
from tunefree_hil.config.find import available, find
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.jobs.options.records import CollectOptions
from tunefree_hil.jobs.preconditions import VEHICLE_IS, ErrorPlace, require_model_of_vehicle, require_number
from tunefree_hil.jobs.run_folder import RunFolder, find_unfinished, open_run, write_text

MAX_VALUES = {"quota_s": 1e6, "area_m": 1e6, "top_mps": 1e3, "drive_s": 1e6}  # larger values are typing errors
STOP_MARGIN_S = 60.0  # longest time from there to standstill; then the ECU's course ends
FIRST_DRIVE = "drive-001"
DEFAULT_ROOT = Path("runs")


class StartPose(NamedTuple):
    """Start of a drive: pose of the middle of the rear axle."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0


def drive_name(number: int) -> str:
    """drive-001, drive-002, ..."""
    return f"drive-{number:03d}"


class CollectSetup(NamedTuple):
    """What is driven. model: path of the model folder. effects: of the bench file."""

    vehicle: VehicleSpec
    model: str
    effects: list[Any]


def resolve_setup(options: CollectOptions) -> CollectSetup:
    """Vehicle, model and effects to drive. Of a bench file its verify_model is used, unless --model is given.

    Raises InputError for a missing or contradictory option.
    """
    if options.bench is not None:
        if options.vehicle is not None:
            message = "a bench file and --vehicle are both given"
            raise InputError(message, code="usage", key="--vehicle", hint="give one of them")
        bench = load(options.bench)
        name = options.model or bench.spec.verify_model or bench.spec.model
        effects = plain(bench.spec.effects)
        return CollectSetup(bench.vehicle, str(find("model", name, bench.file).parent), effects)
    if options.vehicle is None:
        hint = "collect BENCH, or collect --vehicle DIR --model MODEL"
        raise InputError("no vehicle or bench file is given", code="usage", key="BENCH", hint=hint)
    vehicle = whole_vehicle(options.vehicle)
    if options.model is None:
        known = [name for name in available("model") if load_model(name).vehicle == vehicle.name]
        hint = f"models of {vehicle.name}: {', '.join(known) or 'none'}"
        raise InputError("no model is given", code="usage", key="--model", hint=hint)
    return CollectSetup(vehicle, str(find("model", options.model).parent), [])


def require_area(vehicle: VehicleSpec, options: CollectOptions) -> None:
    """Raise InputError where an option is out of range, or the area is too small for the speeds."""
    for name, maximum in MAX_VALUES.items():
        require_number("--" + name.replace("_", "-"), getattr(options, name), maximum=maximum)
    envelope = envelope_from_vehicle(vehicle)
    bands = require_driven_cells(plannable_cells(vehicle, options.top_mps), envelope, options.top_mps)
    speed = max(1.05 * one.low_mps for one in bands)
    needed = area_side_for_speed_m(envelope, speed)
    if options.area_m < needed:
        slower = max(envelope_from_vehicle(vehicle).speed_mps * 0.25, 1.0)
        raise InputError(
            f"{options.area_m:g} m is too small for {speed:.3g} m/s: a square of {math.ceil(needed)} m is needed",
            code="area_too_small",
            key="--area-m",
            hint=f"--area-m {math.ceil(needed)}, or leave out the fast cells: --top-mps {slower:.3g} needs "
            f"{math.ceil(area_side_for_speed_m(envelope, slower))} m",
        )


def require_driven_cells(targets: Sequence[TargetCell], envelope: Envelope, top_mps: float | None) -> list[TargetCell]:
    """The cells that are driven. Raises InputError where --top-mps leaves none."""
    driven = [one for one in targets if not one.excluded]
    if not driven:
        message = f"no cell can be driven with at most {max_planned_speed_mps(envelope, top_mps):.3g} m/s"
        hint = f"give at least {0.5 * max_planned_speed_mps(envelope):.3g}"
        raise InputError(message, code="too_slow", key="--top-mps", hint=hint)
    return driven


def run_record(setup: CollectSetup, options: CollectOptions) -> dict[str, Any]:
    """Record for run.json; it must agree for a collection to continue."""
    vehicle, model = setup.vehicle, load_model(setup.model)
    require_model_of_vehicle(model, vehicle, ErrorPlace("name a model of this vehicle"), VEHICLE_IS)
    return {
        "command": "collect",
        "vehicle": vehicle.name,
        "model": Path(setup.model).name,
        "realtime": options.realtime,
        "quota_s": options.quota_s,
        "area_m": options.area_m,
        "top_mps": options.top_mps,
        "seed": options.seed,
        "drive_s": options.drive_s,
        "effects": setup.effects,
        "hashes": {"vehicle": vehicle.hash, "model": model.hash},
    }


def open_folder(vehicle: VehicleSpec, options: CollectOptions, record: dict[str, Any]) -> RunFolder:
    """The run folder to continue, else a new one. Raises InputError where `out` contains another run."""
    name = f"collect-{vehicle.name}"
    if options.out is None:
        return find_unfinished(DEFAULT_ROOT, name, record) or RunFolder.create(DEFAULT_ROOT, name, record)
    if (options.out / "run.json").is_file():
        run = open_run(options.out)
        differing = sorted(key for key, value in record.items() if run.record.get(key) != value)
        if differing:
            message = f"contains a run with another {', '.join(differing)}"
            hint = "give another --out, or the same options as before"
            raise InputError(message, code="other_run", file=str(options.out), hint=hint)
        return run
    if options.out.is_dir() and any(options.out.iterdir()):
        hint = "give a folder that is new, empty, or contains this collection"
        raise InputError("is not empty and not a run folder", code="not_a_run", file=str(options.out), hint=hint)
    options.out.mkdir(parents=True, exist_ok=True)
    return RunFolder.begin(options.out, record)


def write_bench(run: RunFolder, setup: CollectSetup, options: CollectOptions) -> Bench:
    """Write and load the bench file of the nodes, with its first scenario."""
    scenarios = run.path / "scenarios"
    scenarios.mkdir(exist_ok=True)
    (run.path / "logs").mkdir(exist_ok=True)
    if not (scenarios / f"{FIRST_DRIVE}.toml").is_file():
        write_scenario(scenarios / f"{FIRST_DRIVE}.toml", 1, StartPose(), options.seed, options.drive_s)
    bench = {
        "schema": "tunefree.bench/1",
        "vehicle": setup.vehicle.folder,
        "model": str(Path(setup.model).resolve()),
        "scenarios": [FIRST_DRIVE],
        "weights": "default",
        "seed": options.seed,
        "effects": setup.effects,
    }
    write_text(run.path / "bench.toml", to_toml(bench))
    return load(run.path / "bench.toml")


def write_scenario(path: Path, number: int, start: StartPose, seed: int, drive_s: float) -> None:
    """Write the scenario of a drive for the ECU: a car at standstill where the last drive ended."""
    still = {"t_s": [0.0, drive_s + STOP_MARGIN_S], "value": [0.0, 0.0]}
    data = {
        "schema": "tunefree.scenario/1",
        "name": drive_name(number),
        "description": "A drive of a collection: from standstill to standstill, wherever coverage takes it",
        "noise_seed": (seed + number) % 65536,
        "start": {"along_m": start.x_m, "lateral_m": start.y_m, "heading_rad": start.heading_rad, "speed_mps": 0.0},
        "speed": still,
        "curvature": still,
    }
    write_text(path, to_toml(data))
