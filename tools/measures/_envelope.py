"""What the measures over the whole envelope share: benches, fresh roads, gain sets on the vehicle, and their ratios.

The vehicle is the verify model of a bench file. Everything is driven in the compiled batch, which gives the numbers of
the bus bit for bit (`parity`). What was driven is kept in the measure's folder and found again by all that it depends
on, so a measure that was cut off goes on.
"""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace as with_values

from tools.measures._ledger import ROOT, Ledger
from tools.measures._rig import Rig, failed, replans
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, model_of
from tunefree_hil.bench.load import held_out_roads_of
from tunefree_hil.config.schema import ControllerSpec, RoadsSpec, ScenarioSpec, with_scenarios
from tunefree_hil.grade.metrics import METRICS, LaterRmsMetric
from tunefree_hil.grade.requirements.judgement import RequirementJudgement, judge_drives, violation_text
from tunefree_hil.grade.requirements.limits import RequirementLimits, requirement_limits
from tunefree_hil.roads.sets import HELD_OUT_SEEDS

PATTERN = "*_envelope.toml"
ERRORS = {"lateral_m": "lateral_rms_after_start", "station_m": "station_rms_after_start",
          "speed_mps": "speed_rms_after_start"}  # fmt: skip
Vectors = Mapping[str, Mapping[str, float]]  # complete parameter vectors by name
LINE_S = 10.0  # between two lines about the same step
VEHICLE_COST = 3.0  # time of a drive on the vehicle over that of a drive on a learned model (measured: 67 and 200 /s)


class DriveErrors(NamedTuple):
    """RMS errors after the first 3 s, mean over the roads."""

    lateral_m: float
    station_m: float
    speed_mps: float

    @property
    def geometric_mean(self) -> float:
        """Of the three, in mixed units: for comparisons only."""
        return geometric_mean(self)


class VehicleDrives(NamedTuple):
    """A gain set on the vehicle over some roads.

    judgement: By the requirements of the bench file, without the reserve of a search.
    n_oscillating: Drives with an oscillation beyond its limit.
    drives: Grades as plain data, by road.
    """

    score: float
    errors: DriveErrors
    judgement: RequirementJudgement
    n_oscillating: int
    replans: int
    failed: tuple[str, ...]
    drives: Mapping[str, Mapping[str, Any]]

    def as_data(self) -> dict[str, Any]:
        """Plain data for a detail, without the drives."""
        return {
            "score": self.score,
            "errors": self.errors._asdict(),
            "met": self.judgement.is_met,
            "binds": violation_text(self.judgement),
            "oscillating_drives": self.n_oscillating,
            "replans": self.replans,
            "failed": list(self.failed),
        }


class BestSet(NamedTuple):
    """The best of several gain sets; is_met: whether it meets the requirements, else none of them does."""

    name: str
    is_met: bool


class Progress:
    """Lines on stderr: what was done, the share of all work, and the time that the rest takes at the pace so far.

    total: In units of work, such as drives on a learned model.
    """

    def __init__(self, name: str, total: float) -> None:
        self.name, self.total = name, max(total, 1.0)
        self._done = self._fresh = self._within = 0.0
        self._started = self._line = time.monotonic()

    def finish(self, units: float, text: str, *, is_known: bool = False) -> None:
        """A step is done; `is_known`: it was found in the folder, so it says nothing about the pace."""
        self._done += units
        self._fresh += 0.0 if is_known else units
        self._within = 0.0
        self._say(f"{text}{' (known)' if is_known else ''}")

    def update(self, units: float, text: str) -> None:
        """`units` of the present step are done; at most one line in LINE_S."""
        self._within = units
        if time.monotonic() - self._line >= LINE_S:
            self._say(text)

    def _say(self, text: str) -> None:
        self._line = time.monotonic()
        done, fresh = self._done + self._within, self._fresh + self._within
        left = (self.total - done) * (self._line - self._started) / fresh if fresh else math.nan
        eta = f", {max(left, 0.0) / 60.0:.0f} min left" if math.isfinite(left) else ""
        print(f"{self.name} {100.0 * done / self.total:.0f} %{eta}: {text}", file=sys.stderr, flush=True)


def envelope_files(text: str = "") -> list[str]:
    """The bench files between commas; '' for all of the whole envelope, one a vehicle."""
    return text.split(",") if text else sorted(str(path) for path in (ROOT / "bench_configs").glob(PATTERN))


def head_commit() -> str:
    """The commit that is checked out. Raises InputError outside a clone."""
    done = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        hint = "give --road-seed"
        raise InputError("this is no clone, so there is no commit to draw roads by", code="no_commit", hint=hint)
    return done.stdout.strip()


def changed_files() -> int:
    """Number of tracked files that differ from the commit: 0 where a figure is of the commit."""
    words = ["git", "status", "--porcelain", "--untracked-files=no"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    return len(done.stdout.splitlines())


def seed_of_commit(commit: str) -> int:
    """The seed of roads that nobody could choose: it follows from the commit."""
    return int(commit[:8], 16)


def unseen_roads(bench: Bench, count: int, seed: int) -> list[ScenarioSpec]:
    """Roads of the families over the whole envelope, as a bench file has them, by a seed of their own."""
    roads = with_values(bench.spec.roads or RoadsSpec(), seed=seed - HELD_OUT_SEEDS)
    return held_out_roads_of(replace(bench, spec=with_values(bench.spec, roads=roads)), f"families:{count}")


def on_roads(bench: Bench, roads: Sequence[ScenarioSpec]) -> Bench:
    """The bench with these roads as its only scenarios."""
    names = [road.name for road in roads]
    return replace(bench, spec=with_scenarios(bench.spec, names, []), scenarios={road.name: road for road in roads})


def with_controller(bench: Bench, **keys: Any) -> Bench:
    """The bench with other keys of [controller]."""
    return replace(bench, spec=with_values(bench.spec, controller=with_values(bench.spec.controller, **keys)))


def with_plain_controller(bench: Bench) -> Bench:
    """The bench with the paper's controller: the parts of a bench file that names none, and nothing of other parts to
    search. Its map stays the same."""
    plain = ControllerSpec()
    changed = with_controller(bench, lateral=plain.lateral, longitudinal=plain.longitudinal, inner=plain.inner)
    return replace(changed, spec=with_values(changed.spec, tune=with_values(changed.spec.tune, parameters=[])))


def limits_on_vehicle(bench: Bench) -> RequirementLimits:
    """The requirements of the bench file, without the reserve that a search keeps."""
    return requirement_limits(bench.vehicle.limits, bench.spec.require)


def open_vehicle(bench: Bench, ledger: Ledger) -> Rig:
    """The vehicle of the bench over the bench's scenarios, in the batch; the controller keeps what the bench's model
    says of the vehicle.
    """
    rig = Rig(bench, bench.spec.verify_model, bench.spec.scenarios, ledger, over_bus=False)
    rig.depends["identified"] = model_of(bench, bench.spec.model).hash
    return rig


def drive_sets(bench: Bench, vectors: Vectors, ledger: Ledger, progress: Progress) -> dict[str, VehicleDrives]:
    """Each gain set on the vehicle over the bench's scenarios."""
    found, limits, units = {}, limits_on_vehicle(bench), vehicle_units(bench)
    with open_vehicle(bench, ledger) as rig:
        for name, values in vectors.items():
            started = time.monotonic()
            scored = rig.evaluate(values)
            is_known = scored["seconds"] > time.monotonic() - started  # no drive is faster than itself
            found[name] = judge_set(scored, limits)
            text = f"{Path(bench.file).stem}, {name} on the vehicle scores {found[name].score:.3f}"
            progress.finish(units, text, is_known=is_known)
    return found


def vehicle_units(bench: Bench) -> float:
    """Work of one gain set on the vehicle, in drives on a learned model."""
    return VEHICLE_COST * len(bench.spec.scenarios)


def judge_set(scored: Mapping[str, Any], limits: RequirementLimits) -> VehicleDrives:
    """A gain set from {score, scenarios: grades by road}."""
    drives = scored["scenarios"]
    return VehicleDrives(
        score=float(scored["score"]),
        errors=mean_errors(drives),
        judgement=judge_drives(drives, limits),
        n_oscillating=sum(bool(drive.get("oscillation")) for drive in drives.values()),
        replans=replans(drives),
        failed=tuple(failed(drives)),
        drives=drives,
    )


def mean_errors(drives: Mapping[str, Mapping[str, Any]]) -> DriveErrors:
    """Means over the roads; roads that ended before the first 3 s were over have none."""
    return DriveErrors(*(float(np.mean(errors or [math.nan])) for errors in _known_errors(drives)))


def _known_errors(drives: Mapping[str, Mapping[str, Any]]) -> list[list[float]]:
    every = [drive_errors(drive) for drive in drives.values()]
    return [[errors[name] for errors in every if math.isfinite(errors[name])] for name in ERRORS]


def drive_errors(drive: Mapping[str, Any]) -> dict[str, float]:
    """The errors of one drive in their units, NaN where it has none; metrics are shares of their scales."""
    found = {}
    for name, metric in ERRORS.items():
        formula, share = METRICS[metric], drive["metrics"].get(metric)
        assert isinstance(formula, LaterRmsMetric)
        found[name] = math.nan if share is None else formula.scale * float(share)
    return found


def geometric_mean(values: Sequence[float]) -> float:
    """Of positive numbers; 0 where one of them is."""
    return math.exp(sum(map(math.log, values)) / len(values)) if min(values) > 0.0 else 0.0 * sum(values)


def best_set(sets: Mapping[str, VehicleDrives]) -> BestSet:
    """The lowest geometric mean of the errors of the sets that meet the requirements.

    Where none does: of those that drive every road to its end, else of all.
    """
    met = [name for name, one in sets.items() if one.judgement.is_met]
    finished = [name for name, one in sets.items() if not one.failed]
    return BestSet(min(met or finished or sets, key=lambda name: sets[name].errors.geometric_mean), bool(met))


def error_ratios(one: DriveErrors, other: DriveErrors) -> dict[str, float]:
    """The three errors of one set over those of another, and their geometric mean."""
    ratios = {name: getattr(one, name) / getattr(other, name) for name in ERRORS}
    return {**ratios, "geometric_mean": geometric_mean(list(ratios.values()))}


def spread(vectors: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    """[least, median, most] of each parameter over several vectors."""
    return {
        name: [float(part) for part in np.quantile([values[name] for values in vectors], [0.0, 0.5, 1.0])]
        for name in vectors[0]
    }


def write_text(path: Path, text: str) -> str:
    """Write a file at once; its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)
    return str(path)
