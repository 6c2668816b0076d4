"""Real cars: `log import`, `calibrate`, `learn`, free run on recordings in which nothing was planted, and nobody knows.

RAV4: one minute of one drive, each guarded block of it held out in its turn. DART, a 1:10 scale car: three sets of
drives (steps of throttle; of steering; with motion capture), whole drives held out. Rows: fitted physics, hybrid (where
torch is), and a car that keeps its speed and yaw rate, from the same starts. What an earlier call has left is used.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tools.imports import rav4_csv
from tools.measures._ledger import FIGURES, FOLDER, ROOT
from tools.measures._summary import rounded
from tools.measures._unseen import ended
from tools.measures.figures.velocity_free_run import VelocityRun, draw_runs
from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.config.load import load_model, load_vehicle
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.figures.style import save
from tunefree_hil.jobs.learn.calibrate import calibrate
from tunefree_hil.jobs.learn.learn import learn
from tunefree_hil.jobs.learn.options import CalibrateOptions, LearnOptions
from tunefree_hil.jobs.log.csv_import import import_csv
from tunefree_hil.jobs.log.options import LogImportOptions
from tunefree_hil.learn.compiled_process import CompiledProcess
from tunefree_hil.learn.drives.drive import Drive, DriveSplit
from tunefree_hil.learn.drives.read import read_drives
from tunefree_hil.learn.drives.split import split_drives
from tunefree_hil.learn.evaluation.free_run import mean_interval
from tunefree_hil.learn.evaluation.motion import make_motion_tracks
from tunefree_hil.learn.evaluation.velocity_free_run import VelocityErrors, evaluate_velocities

VALUE = "m/s that fitted physics misses the RAV4's speed by after 10 s of free run, mean, guarded held-out blocks"
NAME = "realcars"
DATA = ROOT.parent / "shared" / "data"
MAPS = ROOT / "tools" / "imports"
# Of DART: mapping and folders. Each set is another day on another floor: one throttle gives other speeds in each.
SETS = {
    "dart_throttle": ("dart_10hz", ("10_step_input_data_rubbery_floor", "20_step_input_data_rubbery_floor")),
    "dart_steering": ("dart_10hz", ("30_step_steering_data",)),
    "dart_mocap": ("dart_100hz", ("steering_identification_25_sept_2024",)),
}
MOST_SEEDS = 40  # tried, until every block of a single drive has been held out
AT_S = 10.0


class Car(NamedTuple):
    """A vehicle's recordings as imported. refused: files that `log import` did not take, with the reason."""

    name: str
    logs: tuple[Path, ...]
    files: int
    doubles: int
    refused: Mapping[str, str]
    truth: str


class Fold(NamedTuple):
    """One split of a car's drives: what was learned, and how it ran on what was held out (None: no start there)."""

    seed: int
    words: str
    blocks: int
    ahead: VelocityErrors | None


def measure(
    seed: int = 1,
    minutes: float = 2.0,
    every_s: float = 0.5,
    data: str = str(DATA),
    folder: str = FOLDER,
    figures: str = FIGURES,
) -> dict[str, Any]:
    """minutes: of training a hybrid; 0 (or without torch): the rows are physics and naive alone.

    n: starts of free runs of 10 s on the RAV4's held-out blocks. low, high: least and most of the blocks' means.
    """
    place = Path(folder) / NAME
    with_hybrid = minutes > 0.0 and importlib.util.find_spec("torch") is not None
    cars = [rav4(Path(data), place), *(dart(name, Path(data), place) for name in SETS)]
    found = {car.name: folds_of(car, place, seed, minutes if with_hybrid else 0.0, every_s) for car in cars}
    rav = found["rav4"]
    errors, blocks = errors_at(rav, "physics", AT_S)
    low, high = mean_interval(errors, blocks, seed)
    detail = {
        "cars": {car.name: {**said(car), **rows(found[car.name], seed)} for car in cars},
        "hybrid": "trained; what was held out also chose when to stop, so its rows flatter it"
        if with_hybrid
        else "left out",
        "figures": [
            str(save(draw_runs(shown(found), "Real cars: measured and free run"), Path(figures) / "realcars.png"))
        ],
    }
    return {
        "value": float(errors.mean()), "unit": "m/s", "n": len(errors), "low": low, "high": high,
        "detail": rounded(detail),
    }  # fmt: skip


def rav4(data: Path, place: Path) -> Car:
    """The RAV4 minute, decoded into a CSV and imported. Raises InputError where the data are not there."""
    source = data / "comma2k19_rav4"
    needed(source)
    found = list(rav4_csv.rows(source / "drive.candump.log", source / "rav4.dbc"))
    path = place / "rav4.csv"
    place.mkdir(parents=True, exist_ok=True)
    rav4_csv.write(path, found)
    log = imported(path, MAPS / "rav4.toml", place / "imported")
    return Car("rav4", (log,), 1, 0, {}, "no yaw rate sensor: from the rear wheels; what is a hill is not known")


def dart(name: str, data: Path, place: Path) -> Car:
    """A set of DART files, each content once."""
    logs, refused, seen, files = [], {}, set(), 0
    mapping, parts = SETS[name]
    for part in parts:
        needed(data / "dart" / part)
        for path in sorted((data / "dart" / part).glob("*.csv")):
            files += 1
            content = hashlib.sha256(path.read_bytes()).hexdigest()
            if content in seen:
                continue
            seen.add(content)
            try:
                logs.append(imported(path, MAPS / f"{mapping}.toml", place / "imported"))
            except InputError as error:
                refused[f"{part}/{path.name}"] = error.message
    truth = "motion capture of the pose" if mapping == "dart_100hz" else "speed and yaw rate by the car's own sensors"
    return Car(name, tuple(logs), files, files - len(seen), refused, truth)


def needed(source: Path) -> None:
    """InputError where recordings are not there."""
    if not source.is_dir():
        raise InputError("the recordings are not there", code="no_data", file=str(source), hint="give them with --data")


def imported(path: Path, mapping: Path, place: Path) -> Path:
    """The log that `log import` makes of a CSV; one of an earlier call with the same mapping and CSV is taken."""
    digest = hashlib.sha256(path.read_bytes() + mapping.read_bytes()).hexdigest()[:12]
    out = place / f"{mapping.stem}-{path.stem}-{digest}"
    if not out.is_dir():
        ended(import_csv(LogImportOptions(path, mapping, out)))
    return out / "drive.log"


def folds_of(car: Car, place: Path, seed: int, minutes: float, every_s: float) -> list[Fold]:
    """One fold a block where there is one drive, else one; models of an earlier call are taken."""
    vehicle = load_vehicle(car.logs[0].parent)
    drives = read_drives(list(car.logs), Codec(vehicle))
    folds = []
    for chosen, split in splits_of(drives, seed):
        key = hashlib.sha256("".join(map(str, car.logs)).encode()).hexdigest()[:8]
        models = learned(car, place / f"{car.name}-{key}-{chosen}", chosen, minutes)
        tracks = make_motion_tracks(split.held_out, vehicle)
        try:
            with CompiledProcess() as worker:
                ahead = worker.wait_for_result(evaluate_velocities, models, vehicle, tracks, every_s)
        except InputError as error:
            print(f"{car.name}, {split.description}: {error.message}", file=sys.stderr)
            ahead = None
        folds.append(Fold(chosen, split.description, len(split.held_out), ahead))
    return folds


def splits_of(drives: Sequence[Drive], seed: int) -> list[tuple[int, DriveSplit]]:
    """(seed, split): of a single drive until each block was held out once, or MOST_SEEDS were tried."""
    found: dict[tuple[Any, ...], tuple[int, DriveSplit]] = {}
    for chosen in range(seed, seed + (MOST_SEEDS if len(drives) == 1 else 1)):
        split = split_drives(drives, seed=chosen)
        found.setdefault(tuple((part.drive.name, part.begin) for part in split.held_out), (chosen, split))
    return list(found.values())


def learned(car: Car, place: Path, seed: int, minutes: float) -> dict[str, ModelSpec]:
    """'physics', and 'hybrid' where minutes is above 0, by the commands that anybody has."""
    vehicle, physics = str(car.logs[0].parent), place / "physics"
    if not physics.is_dir():
        ended(calibrate(CalibrateOptions(list(car.logs), vehicle, physics, seed)))
    models = {"physics": load_model(physics)}
    if minutes <= 0.0:
        return models
    hybrid, without = place / f"hybrid-{minutes:g}", place / f"hybrid-{minutes:g}.json"
    if not hybrid.is_dir() and not without.is_file():
        try:
            ended(learn(LearnOptions(list(car.logs), vehicle, hybrid, "hybrid", seed, minutes, physics)))
        except InputError as error:  # too little to learn from is an answer
            without.write_text(json.dumps({"refused": error.message}) + "\n", encoding="utf-8")
    return models | ({"hybrid": load_model(hybrid)} if hybrid.is_dir() else {})


def errors_at(folds: Sequence[Fold], name: str, seconds: float, of: str = "speed_mps") -> tuple[Any, Any]:
    """(absolute errors, the block or drive each is from) of a model after some seconds, all folds together."""
    errors, blocks = [np.zeros(0)], [np.zeros(0, dtype="<U1")]
    for fold in folds:
        if fold.ahead is None or name not in getattr(fold.ahead, of):
            continue
        values = getattr(fold.ahead, of)[name][:, fold.ahead.horizons_s.index(seconds)]
        known = np.isfinite(values)
        errors.append(values[known])
        blocks.append(np.array([f"{fold.seed}: {drive}" for drive in fold.ahead.drive_names])[known])
    return np.concatenate(errors), np.concatenate(blocks)


def rows(folds: Sequence[Fold], seed: int) -> dict[str, Any]:
    """By model and horizon: mean speed and yaw rate error with intervals, n of starts and of blocks or drives."""
    run = [fold.ahead for fold in folds if fold.ahead is not None]
    names = dict.fromkeys(name for ahead in run for name in ahead.speed_mps)
    found: dict[str, Any] = {}
    for name in names:
        for seconds in run[0].horizons_s:
            row = found.setdefault(name, {}).setdefault(f"{seconds:g}", {})
            for of in ("speed_mps", "yaw_rate_radps"):
                errors, blocks = errors_at(folds, name, seconds, of)
                row["starts"], row["blocks"] = len(errors), len(set(blocks.tolist()))
                if len(errors):
                    low, high = mean_interval(errors, blocks, seed)
                    row[of] = {"mean": float(errors.mean()), "low": low, "high": high}
    without = [fold.words for fold in folds if fold.ahead is None]
    return {"free_run": found, "splits": [fold.words for fold in folds], "without_a_start": without}


def said(car: Car) -> dict[str, Any]:
    """What these recordings are."""
    return {
        "files": car.files,
        "byte_equal_doubles": car.doubles,
        "drives": len(car.logs),
        "refused": dict(car.refused),
        "truth": car.truth,
    }


def shown(found: Mapping[str, Sequence[Fold]]) -> list[VelocityRun]:
    """The longest free run of each car, of those the one whose speed changes most."""
    runs = []
    for name, folds in found.items():
        traces = [trace for fold in folds if fold.ahead is not None for trace in fold.ahead.traces]
        if traces:
            one = max(traces, key=lambda trace: (round(trace.time_s[-1]), float(np.ptp(trace.speed_mps))))
            runs.append(VelocityRun(name, one.time_s, one.speed_mps, one.yaw_rate_radps, one.speeds, one.yaw_rates))
    return runs
