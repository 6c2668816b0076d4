"""Does a compiled batch drive what the bus drives? Every value of every column at every tick, by its bits."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np

from tools.measures._ledger import FOLDER, ROOT, Ledger, key_of, meaning
from tools.measures._rig import standing
from tunefree_hil.base.errors import BenchError
from tunefree_hil.bench import Bench, is_heavy, load
from tunefree_hil.bench.batch import Batch, Driven, Job
from tunefree_hil.config.find import available
from tunefree_hil.config.load import load_bench, load_model
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.control.parameters import PARAMETERS, SETS, Parameter, round32, study_values
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.score import ScenarioGrade
from tunefree_hil.jobs.run_folder import RunFolder, delete_logs
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession
from tunefree_hil.jobs.running.trial_driver import DriveJob, TrialDriver
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors

VALUE = "values that differ in a bit between bus and batch: all columns, ticks, scenarios, vehicles (0 is right)"
SEARCHED = tuple(SETS["complete"])
LEARNED = ("hybrid", "lstm", "mlp", "rule_based", "paper")
Found = dict[str, Any]


class Part(NamedTuple):
    """A bench on one of its models."""

    bench: Bench
    model: str
    scenarios: tuple[ScenarioSpec, ...]
    depends: dict[str, Any]


def measure(
    sets: int = 20, scenarios: str = "", benches: str = "", models: str = "", minutes: float = 0.0, folder: str = FOLDER
) -> dict[str, Any]:
    """Drive `sets` parameter vectors over all scenarios on each model of each vehicle, over the bus and in a batch.

    The models are both of the bench file and every learned one there is; '' scenarios, benches, models: all, one bench
    file a vehicle; else names with commas between (of models also paths of folders). minutes: stop
    after them (0: do not), each model having its share; called again it goes on. n: drives compared. Baselines come
    first among the vectors, then points of the complete box, every third of them with all sixteen parameters drawn.
    """
    ledger = Ledger(Path(folder) / "parity")
    started = time.monotonic()
    parts = [part for path in bench_files(benches) for part in _parts(path, scenarios, models)]
    found: list[Found] = []
    for i, part in enumerate(parts, 1):
        share_s = 60.0 * minutes * i / len(parts) if minutes else float("inf")
        found += _compare_part(part, sets, ledger, started + share_s)
    wanted = sum(len(part.scenarios) for part in parts) * sets
    differing = [one for one in found if one["differing"]]
    detail = {
        "drives_wanted": wanted,
        "values_compared": sum(one["values"] for one in found),
        "replans": sum(one["replans"] for one in found),
        "failed_drives": sum(bool(one["error"]) for one in found),
        "drives_that_differ": len(differing),
        "first_that_differ": differing[:20],
    }
    value = sum(one["differing"] for one in found)
    return {"value": value, "unit": "values", "n": len(found), "low": None, "high": None, "detail": detail}


def parameter_sets(bench: Bench, count: int, seed: int = 1) -> dict[str, dict[str, float]]:
    """`count` complete vectors (binary32) by name: the vehicle's baselines, then seeded points of the box."""
    vectors: dict[str, dict[str, float]] = {}
    for name, values in list(compute_baseline_vectors(bench).items())[:count]:
        vectors[name] = dict(values)
    chance = Random(seed)
    for i in range(count - len(vectors)):
        rows = [row for row in PARAMETERS if i % 3 == 2 or row.tunable.name in SEARCHED]
        drawn = {row.tunable.name: _drawn(row, chance) for row in rows}
        vectors[f"drawn_{i}"] = {name: round32(value) for name, value in {**study_values(), **drawn}.items()}
    return vectors


def _drawn(row: Parameter, chance: Random) -> float:
    """Between the ends of the box, as a sampler draws."""
    tunable = row.tunable
    if tunable.choices:
        return chance.choice(tunable.choices)
    if tunable.scale == "log":
        return tunable.low * (tunable.high / tunable.low) ** chance.random()
    return chance.uniform(tunable.low, tunable.high)


def differing(bus: Recording, batch: Recording) -> dict[str, int]:
    """Column -> values that are not the same 64 bits (any NaN equals any NaN); absent ones and rows count in full."""
    found = {}
    for name in dict.fromkeys([*bus.columns, *batch.columns]):
        one, other = bus.get(name), batch.get(name)
        if one is None or other is None:
            found[name] = max(bus.ticks, batch.ticks)
            continue
        rows = min(len(one), len(other))
        same = (_bits(one[:rows]) == _bits(other[:rows])) | (np.isnan(one[:rows]) & np.isnan(other[:rows]))
        found[name] = int(np.count_nonzero(~same)) + abs(len(one) - len(other))
    return {name: count for name, count in found.items() if count}


def compared(bus: Recording, graded: ScenarioGrade, driven: Driven) -> Found:
    """What a drive over the bus and the same in a batch have that is not the same; `differing` is 0 where nothing."""
    assert driven.recording is not None
    columns = differing(bus, driven.recording)
    grades = 0 if driven.grade == graded else 1
    how = 0 if bus.instead == driven.recording.instead and bus.ticks == driven.ticks else 1
    values = bus.ticks * len(bus.columns)
    return {"differing": sum(columns.values()) + grades + how, "columns": columns, "grades": grades, "values": values,
            "replans": graded.replans, "error": driven.error, "ticks": [bus.ticks, driven.ticks]}  # fmt: skip


def _bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float64).view(np.uint64)


def bench_files(names: str) -> list[Path]:
    """The bench files named, else the first of each vehicle: the others drive the same models and scenarios."""
    if names:
        return [Path(name) for name in names.split(",")]
    found: dict[str, Path] = {}
    for path in sorted((ROOT / "bench_configs").glob("*.toml")):
        found.setdefault(load_bench(path).vehicle, path)
    return list(found.values())


def _parts(path: Path, scenarios: str, models: str) -> list[Part]:
    bench = load(path)
    chosen = tuple(one for one in bench.scenarios.values() if not scenarios or one.name in scenarios.split(","))
    own = dict.fromkeys(models.split(",") if models else _models_of(bench))
    code = {"batch": _code_of("batch"), "jobs": _code_of("jobs")}
    return [
        Part(bench, model, chosen, {**standing(bench, model, chosen), **code})
        for model in own
        if load_model(model, bench.file).vehicle == bench.vehicle.name
    ]


def _models_of(bench: Bench) -> list[str]:
    """Those of the bench file, then the vehicle's learned ones."""
    own = [name for name in (bench.spec.model, bench.spec.verify_model) if name]
    return own + [name for name in available("model", bench.file) if load_model(name, bench.file).plant.kind in LEARNED]


def _code_of(folder: str) -> str:
    """A hash over code that a score over the bus does not depend on."""
    paths = sorted((ROOT / "tunefree_hil" / folder).rglob("*.py"))
    return key_of({path.name: meaning(path.read_text(encoding="utf-8")) for path in paths})


def _compare_part(part: Part, sets: int, ledger: Ledger, limit_s: float) -> list[Found]:
    """The drives of a part that the ledger knows, and those that there is time for."""
    found = []
    with ExitStack() as stack:
        both: tuple[TrialDriver, Batch] | None = None
        for name, values in parameter_sets(part.bench, sets).items():
            depends = {one.name: {**part.depends, "scenario": one.hash, "values": values} for one in part.scenarios}
            todo = [one for one in part.scenarios if ledger.find(depends[one.name]) is None]
            if todo and time.monotonic() < limit_s:
                both = both or _start(part, ledger.folder, stack)
                for scenario, result in _compare(part.bench, *both, todo, values).items():
                    ledger.keep(depends[scenario], {"scenario": scenario, "set": name, "model": part.model, **result})
            found += [one for key in depends.values() if (one := ledger.find(key)) is not None]
    return found


def _start(part: Part, folder: Path, stack: ExitStack) -> tuple[TrialDriver, Batch]:
    """A bench over the bus with a lane a core, and a batch."""
    where = folder / f"bus-{os.getpid()}"
    stack.callback(shutil.rmtree, where, ignore_errors=True)
    run = RunFolder(where, {})
    heavy = is_heavy(part.bench, part.model)
    sessions = []
    for lane in range(min(2, len(os.sched_getaffinity(0)))):
        name = f"parity-{os.getpid()}-{Path(part.model).name}-{lane}"
        words = run.node_output() / str(lane)
        one = BenchSession(
            Path(part.bench.file), words, BenchLaunch(session=name, model=part.model, bus="tfhub", jitted_ecu=heavy)
        )
        sessions.append(stack.enter_context(one))
    track = TrialDriver(sessions, part.bench, run)
    stack.callback(track.close)
    return track, stack.enter_context(Batch(part.bench, part.model))


def _compare(
    bench: Bench, track: TrialDriver, batch: Batch, scenarios: Sequence[ScenarioSpec], values: Mapping[str, float]
) -> dict[str, Found]:
    """Scenario -> what differs. Raises the error of a bench that failed: that is no question of parity."""
    driven = batch.drive([Job(values, scenario) for scenario in scenarios], columns=True)
    episodes = track.drive_jobs([DriveJob(k, scenario, values) for k, scenario in enumerate(scenarios)])
    found = {}
    for k, (scenario, one) in enumerate(zip(scenarios, driven, strict=True)):
        episode = episodes[k]
        if isinstance(episode, BenchError):
            raise episode
        found[scenario.name] = compared(episode.recording, episode.grade, one)
        delete_logs(track.run.episode(k))
    return found
