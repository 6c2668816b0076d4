"""Drives that no learning has seen: a bench's scenarios on its verify model, other gains, other noise, and hills."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import tomli_w

from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.control.parameters import BY_NAME, box32
from tunefree_hil.jobs.drive import drive
from tunefree_hil.jobs.options.records import DriveOptions

GAINS = (1.0, 1.8, 0.6)  # factors on all tuned gains: drives that differ in more than their noise
GRADES_RAD = (0.03, -0.03)
SCALED = ("lqr.q1", "lqr.q3", "station.kp", "speed.kp_low", "speed.kp_high")
FIRST_SEED = 7001  # of the sensors' noise; no collection comes near it


def unseen_logs(
    bench: str, folder: Path, gains: int = len(GAINS), hills: int = len(GRADES_RAD)
) -> dict[str, list[Path]]:
    """'level' and 'hills': the vehicle logs of all drives; those that `folder` has are not driven again."""
    loaded = load(bench)
    names = [*loaded.spec.scenarios, *loaded.spec.verify_scenarios]
    level = [(f"gains-{i}", factor, 0.0) for i, factor in enumerate(GAINS[:gains])]
    slopes = [(f"hill-{i}", 1.0, grade) for i, grade in enumerate(GRADES_RAD[:hills])]
    found = {}
    for ground, some in (("level", level), ("hills", slopes)):
        logs: list[Path] = []
        for number, (name, factor, grade_rad) in enumerate(some):
            seed = FIRST_SEED + number + (100 if grade_rad else 0)
            logs += _driven(loaded, names, folder / name, factor, grade_rad, seed)
        found[ground] = logs
    return found


def _driven(bench: Bench, names: list[str], folder: Path, factor: float, grade_rad: float, seed: int) -> list[Path]:
    done = folder / "done.txt"
    if not done.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / "bench.toml"
        file.write_text(tomli_w.dumps(_bench(bench, names, grade_rad)), encoding="utf-8")
        words = [f"{name}={value:.9g}" for name, value in scaled(parameters_of(bench), factor).items()]
        result = ended(
            drive(
                DriveOptions(file, model=bench.spec.verify_model, bus="tfhub", seed=seed, out=folder, parameters=words)
            )
        )
        logs = sorted(str(path) for path in Path(result["run"]).glob("episodes/*/vehicle.log"))
        done.write_text("\n".join(logs), encoding="utf-8")
    return [Path(line) for line in done.read_text(encoding="utf-8").splitlines()]


def scaled(values: Mapping[str, float], factor: float) -> dict[str, float]:
    """The gains of SCALED times a factor, within their boxes."""
    found = {}
    for name in SCALED:
        if name in values:
            low, high = box32(BY_NAME[name].tunable.low, BY_NAME[name].tunable.high)
            found[name] = min(max(values[name] * factor, low), high)
    return found


def _bench(bench: Bench, names: list[str], grade_rad: float) -> dict[str, Any]:
    """A bench file of its own: the same vehicle and models, all scenarios, perhaps on a slope."""
    spec = bench.spec
    data: dict[str, Any] = {
        "schema": "tunefree.bench/1", "vehicle": spec.vehicle, "model": spec.model, "verify_model": spec.verify_model,
        "scenarios": names, "weights": spec.weights, "seed": spec.seed,
    }  # fmt: skip
    if grade_rad:
        data["effects"] = [{"name": "grade", "params": {"grade_rad": grade_rad}}]
    return data


def ended(job: Iterable[Event]) -> dict[str, Any]:
    """Run a job to its end, its words to stderr; the data of its result."""
    data: dict[str, Any] = {}
    for event in job:
        if event.kind == "result":
            data = event.data
        elif event.kind != "line" and event.message:
            more = "".join(f" {event.data[key]}" for key in ("done", "total") if key in event.data)
            print(f"{event.message}{more}", file=sys.stderr, flush=True)
    return data
