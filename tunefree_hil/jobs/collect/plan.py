"""What a collection is asked for, its run folder, and the files that its drives are told by."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, load
from tunefree_hil.bench.load import whole_vehicle
from tunefree_hil.collect.cells import Target, fastest_mps
from tunefree_hil.collect.coverage import Coverage
from tunefree_hil.collect.envelope import Envelope, envelope_of, side_needed_m
from tunefree_hil.collect.plan import DrivePlan, as_dict, driven_targets
from tunefree_hil.config.dump import plain, to_toml
from tunefree_hil.config.find import available, find
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.jobs.preconditions import VEHICLE, require_model_of, require_number
from tunefree_hil.jobs.run_folder import SCHEMA, RunFolder, open_run, unfinished, versions, write_json, write_text

DRIVE_S = 110.0  # after so long a drive begins to stop, unless told otherwise
MOST = {"quota_s": 1e6, "area_m": 1e6, "top_mps": 1e3, "drive_s": 1e6}  # eleven days; more is a slip
SPARE_S = 60.0  # longest from there to standstill; the ECU's course ends then
FIRST = "drive-001"
HOLDS_A_DRIVE = 7  # the first hold of each drive is another one
DEFAULT_ROOT = Path("runs")


class Asked(NamedTuple):
    """The command line of `collect`. out: this collection's own folder, None for a new one under runs/."""

    bench: Path | None = None
    vehicle: str | None = None
    model: str | None = None
    bus: str = "auto"
    bench_bus: str = ""
    session: str = ""
    realtime: bool = False
    out: Path | None = None
    quota_s: float = 10.0
    area_m: float = 400.0
    top_mps: float | None = None
    seed: int = 1
    drive_s: float = DRIVE_S


class Start(NamedTuple):
    """Where a drive begins: pose of the rear axle's middle."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0


def drive_name(number: int) -> str:
    """drive-001, drive-002, ..."""
    return f"drive-{number:03d}"


def vehicle_and_model(asked: Asked) -> tuple[VehicleSpec, str, list[Any]]:
    """(vehicle, model as a path, effects of the bench file) that are to be driven. Raises InputError.

    A bench file stands for its verify_model, which is its vehicle; --model names another one.
    """
    if asked.bench is not None:
        if asked.vehicle is not None:
            raise InputError("a bench file and --vehicle are given", code="usage", key="--vehicle", hint="give one")
        bench = load(asked.bench)
        name = asked.model or bench.spec.verify_model or bench.spec.model
        effects = plain(bench.spec.effects)
        return bench.vehicle, str(find("model", name, bench.file).parent), effects
    if asked.vehicle is None:
        hint = "collect BENCH, or collect --vehicle DIR --model MODEL"
        raise InputError("nothing to drive is named", code="usage", key="BENCH", hint=hint)
    vehicle = whole_vehicle(asked.vehicle)
    if asked.model is None:
        known = [name for name in available("model") if load_model(name).vehicle == vehicle.name]
        raise InputError(
            "no model is named",
            code="usage",
            key="--model",
            hint=f"of {vehicle.name} there are {', '.join(known) or 'none'}",
        )
    return vehicle, str(find("model", asked.model).parent), []


def require_room(vehicle: VehicleSpec, asked: Asked) -> None:
    """Raise InputError where the area is too small for the speeds asked, or a number is none; it says how large."""
    for name, most in MOST.items():
        require_number("--" + name.replace("_", "-"), getattr(asked, name), most=most)
    envelope = envelope_of(vehicle)
    bands = some_driven(driven_targets(vehicle, asked.top_mps), envelope, asked.top_mps)
    speed = max(1.05 * one.low_mps for one in bands)
    needed = side_needed_m(envelope, speed)
    if asked.area_m < needed:
        slower = max(envelope_of(vehicle).speed_mps * 0.25, 1.0)
        raise InputError(
            f"{asked.area_m:g} m are too small for {speed:.3g} m/s: a square of {math.ceil(needed)} m is needed",
            code="area_too_small",
            key="--area-m",
            hint=f"--area-m {math.ceil(needed)}, or leave out the fast cells: --top-mps {slower:.3g} needs "
            f"{math.ceil(side_needed_m(envelope, slower))} m",
        )


def some_driven(targets: Sequence[Target], envelope: Envelope, top_mps: float | None) -> list[Target]:
    """Those that are driven. Raises InputError where --top-mps leaves none."""
    driven = [one for one in targets if not one.excluded]
    if not driven:
        top, hint = fastest_mps(envelope, top_mps), f"give at least {0.5 * fastest_mps(envelope):.3g}"
        raise InputError(f"no cell is driven at {top:.3g} m/s at most", code="too_slow", key="--top-mps", hint=hint)
    return driven


def record_of(vehicle: VehicleSpec, model: str, asked: Asked, effects: list[Any]) -> dict[str, Any]:
    """What run.json says, and what must agree for a collection to go on."""
    found = load_model(model)
    require_model_of(found, vehicle, hint="name a model of this vehicle", needed=VEHICLE)
    return {
        "command": "collect",
        "vehicle": vehicle.name,
        "model": Path(model).name,
        "realtime": asked.realtime,
        "quota_s": asked.quota_s,
        "area_m": asked.area_m,
        "top_mps": asked.top_mps,
        "seed": asked.seed,
        "drive_s": asked.drive_s,
        "effects": effects,
        "hashes": {"vehicle": vehicle.hash, "model": found.hash},
    }


def open_folder(vehicle: VehicleSpec, asked: Asked, record: dict[str, Any]) -> RunFolder:
    """The run folder: the one that is to go on, else a new one. Raises InputError where `out` holds another run."""
    name = f"collect-{vehicle.name}"
    if asked.out is None:
        return unfinished(DEFAULT_ROOT, name, record) or RunFolder.create(DEFAULT_ROOT, name, record)
    if (asked.out / "run.json").is_file():
        run = open_run(asked.out)
        other = sorted(key for key, value in record.items() if run.record.get(key) != value)
        if other:
            raise InputError(
                f"holds a run with another {', '.join(other)}",
                code="other_run",
                file=str(asked.out),
                hint="give another --out, or the same options as before",
            )
        return run
    if asked.out.is_dir() and any(asked.out.iterdir()):
        hint = "give a folder that is new, empty, or holds this collection"
        raise InputError("is not empty and holds no run", code="not_a_run", file=str(asked.out), hint=hint)
    asked.out.mkdir(parents=True, exist_ok=True)
    run = RunFolder(asked.out, {"schema": SCHEMA, "versions": versions(), "complete": False, **record})
    write_json(run.path / "run.json", run.record)
    return run


def prepare(run: RunFolder, vehicle: VehicleSpec, model: str, asked: Asked, effects: list[Any]) -> Bench:
    """Write the bench file that the nodes read, with its first scenario; what it holds, read."""
    scenarios = run.path / "scenarios"
    scenarios.mkdir(exist_ok=True)
    (run.path / "logs").mkdir(exist_ok=True)
    if not (scenarios / f"{FIRST}.toml").is_file():
        write_scenario(scenarios / f"{FIRST}.toml", 1, Start(), asked.seed, asked.drive_s)
    bench = {
        "schema": "tunefree.bench/1",
        "vehicle": vehicle.folder,
        "model": str(Path(model).resolve()),
        "scenarios": [FIRST],
        "weights": "default",
        "seed": asked.seed,
        "effects": effects,
    }
    write_text(run.path / "bench.toml", to_toml(bench))
    return load(run.path / "bench.toml")


def write_scenario(path: Path, number: int, start: Start, seed: int, drive_s: float) -> None:
    """The scenario of a drive: the ECU's side of it, a car that stands where the last drive ended, and time."""
    still = {"t_s": [0.0, drive_s + SPARE_S], "value": [0.0, 0.0]}
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


def write_plan(
    run: RunFolder,
    number: int,
    asked: Asked,
    start: Start,
    centre: tuple[float, float] | None,
    coverage: Coverage,
    stretches: tuple[int, int],
) -> Path:
    """Scenario and plan of a drive; the scenario's path. The same logs give the same files, byte for byte."""
    path = run.path / "scenarios" / f"{drive_name(number)}.toml"
    write_scenario(path, number, start, asked.seed, asked.drive_s)
    plan = DrivePlan(
        asked.quota_s,
        asked.area_m,
        asked.top_mps,
        centre,
        tuple(coverage.counter.have),
        HOLDS_A_DRIVE * (number - 1),
        asked.drive_s,
        stretches,
    )
    write_json(path.with_suffix(".json"), as_dict(plan))
    return path
