"""Logs and learned plants of the reproduction: collected and trained once, used by every part that wants them."""

from __future__ import annotations

import os
import shutil
import tomllib
from collections.abc import Iterable, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

from tools.measures._ledger import ROOT, code_hash, meaning
from tools.measures._unseen import unseen_logs
from tools.measures.freerun import learned, unseen_tracks
from tools.reproduction.context import COMPLETE_BENCH, Context
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, load
from tunefree_hil.config.dump import to_toml
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.jobs.collect.collect import collect
from tunefree_hil.jobs.learn.calibration import calibrate_into, split_drives_for_fit
from tunefree_hil.jobs.options.records import CollectOptions
from tunefree_hil.learn.drives.read import read_drives
from tunefree_hil.learn.evaluation.motion import MotionTrack

KINDS = ("rule_based", "mlp", "lstm", "paper")  # the paper's three of Fig. 3b, and its Table I as printed
DEFAULT_PLANT = "mkz_learned"  # the shipped learned plant of the vehicle
LEARNING_CODE = ("collect", "learn", "jobs/learn", "jobs/collect")


class DataSize(NamedTuple):
    """How much is driven and trained.

    Attributes:
        quota_s: Seconds of driving in each cell of the collection.
        minutes: Training time of each net.
        gains: Sets of unseen drives, each over all scenarios of the bench file.
        every_s: Time between two starts of free runs.
    """

    quota_s: float
    minutes: float
    gains: int
    every_s: float


FULL = DataSize(5.0, 2.0, 1, 1.0)
QUICK = DataSize(1.0, 0.01, 1, 4.0)


def data_size(context: Context) -> DataSize:
    """Of this run."""
    return context.size(FULL, QUICK)


def load_bench_of_data() -> Bench:
    """The bench whose verify model (a simulated reference vehicle) is driven for data."""
    return load(ROOT / COMPLETE_BENCH)


def data_folder(context: Context) -> Path:
    """Where logs and models of this code and size lie."""
    package = ROOT / "tunefree_hil"
    paths = [path for name in LEARNING_CODE for path in sorted((package / name).rglob("*.py"))]
    code = code_hash() + "".join(meaning(path.read_text(encoding="utf-8")) for path in paths)
    key = sha256(f"{code}{data_size(context)}{context.seed}".encode()).hexdigest()[:12]
    return context.folders.work / f"data-{key}"


def collect_logs(context: Context) -> list[Path]:
    """Logs of a guided collection on the reference vehicle; one that was cut off goes on."""
    place = data_folder(context) / "collect"
    done = place / "collected.txt"
    if not done.is_file():
        place.parent.mkdir(parents=True, exist_ok=True)
        options = CollectOptions(
            ROOT / COMPLETE_BENCH, bus="tfhub", out=place, quota_s=data_size(context).quota_s, seed=context.seed
        )
        run_job(collect(options), context, "collection")
        done.write_text("all cells driven\n", encoding="utf-8")
    return sorted((place / "logs").glob("*.log"))


def run_job(job: Iterable[Event], context: Context, label: str) -> dict[str, Any]:
    """Run a job; its progress becomes that of the run. Returns: the data of its result."""
    data: dict[str, Any] = {}
    for event in job:
        if event.kind == "result":
            data = dict(event.data)
        elif event.kind == "progress":
            context.progress.tell(f"{label}: {event.message}")
    return data


def calibrated_physics(context: Context, bench: Bench) -> Path:
    """Fitted physics of the logs, without the search for further effects, which a kinematic plant cannot have."""
    folder = data_folder(context) / f"physics-{context.seed}"
    if (folder / "model.toml").is_file():
        return folder
    if context.is_quick:
        collect_logs(context)
        copy_physics(default_plant(), folder)
    else:
        drives = list(read_drives(collect_logs(context), bench.codec))
        split = _end_of(split_drives_for_fit(drives, bench.vehicle, context.seed), context)
        _end_of(calibrate_into(folder, bench.vehicle, drives, split, context.seed), context)
    return folder


def copy_physics(model: ModelSpec, folder: Path) -> None:
    """The physics of a learned plant as a folder of its own, without effects; a quick run has no time to fit."""
    part = folder.with_suffix(".part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    data = tomllib.loads((Path(model.folder) / "model.toml").read_text(encoding="utf-8"))
    data["plant"] = {key: value for key, value in data["plant"].items() if key != "file"} | {"kind": "physics"}
    data.pop("effects", None)
    (part / "model.toml").write_text(to_toml(data), encoding="utf-8")
    for name in ("calibration.npz", "card.json"):
        shutil.copy(Path(model.folder) / name, part / name)
    os.replace(part, folder)


def _end_of(steps: Any, context: Context) -> Any:
    """What a generator of events returns."""
    while True:
        try:
            event = next(steps)
        except StopIteration as end:
            return end.value
        if event.message:
            context.progress.tell(f"calibration: {event.message}")


def learned_plants(context: Context, bench: Bench) -> dict[str, ModelSpec]:
    """'physics' and KINDS, from the same logs and the same split."""
    logs = collect_logs(context)
    place = calibrated_physics(context, bench).parent
    return learned(bench, logs, place, KINDS, context.seed, data_size(context).minutes, 0.0)


def default_plant() -> ModelSpec:
    """The shipped plant of kind hybrid, learned from another collection on the same vehicle."""
    return load_model(DEFAULT_PLANT, ROOT / COMPLETE_BENCH)


def unseen_motion(context: Context, bench: Bench) -> list[MotionTrack]:
    """Drives on the reference vehicle that no training has seen: level ground, other noise."""
    logs = unseen_logs(str(ROOT / COMPLETE_BENCH), data_folder(context) / "unseen", data_size(context).gains, 0)
    return unseen_tracks(logs["level"], bench)


def minutes_driven(logs: Sequence[Path]) -> float:
    """Minutes of driving in candump logs, from their first and last time stamps."""
    return sum(_seconds_of(path) for path in logs) / 60.0


def _seconds_of(path: Path) -> float:
    with path.open("rb") as file:
        first = file.readline()
        file.seek(max(path.stat().st_size - 400, 0))
        last = file.readlines()[-1]
    return _stamp_s(last) - _stamp_s(first)


def _stamp_s(line: bytes) -> float:
    return float(line[1 : line.index(b")")])
