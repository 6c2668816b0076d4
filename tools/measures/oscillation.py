"""Is the oscillation metric right? Random gain sets on both vehicles, judged again by a check that works otherwise."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from random import Random
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import binomtest

from tools.measures._ledger import ROOT
from tools.measures._summary import rounded
from tools.measures._swing_check import CHECKED, CheckedSwing, alternation, strongest_swing
from tools.measures.parity import bench_files
from tunefree_hil.base.contracts import Tunable
from tunefree_hil.base.course import Course
from tunefree_hil.bench import Bench, load
from tunefree_hil.bench.batch import Batch, Driven, Job
from tunefree_hil.control.parameters import SETS, BoxChoice, round32, study_values, tunable_in_box
from tunefree_hil.grade.metrics import samples_from_plan
from tunefree_hil.grade.oscillation.detection import MIN_DRIVE_S
from tunefree_hil.grade.oscillation.report import OscillationReport, oscillation_text
from tunefree_hil.grade.score import FINISHED
from tunefree_hil.roads.sets import road_set

Array = np.ndarray

VALUE = "drives of random gain sets that the metric judges otherwise than an independent spectral check, percent"
BORDER = 0.1  # of a limit, up or down: such drives are counted apart, too
DRIVES_AT_ONCE = 50  # whose recordings are in memory


class JudgedDrive(NamedTuple):
    """A drive and both judgements."""

    name: str
    report: OscillationReport
    check: CheckedSwing
    outcome: str
    replans: int

    @property
    def differs(self) -> bool:
        """Whether only one of the two calls it an oscillation."""
        return self.report.is_oscillating != (self.check.ratio > 1.0)

    @property
    def is_plain(self) -> bool:
        """Whether it was driven to its end without a re-plan."""
        return self.outcome == FINISHED and self.replans == 0

    @property
    def is_borderline(self) -> bool:
        """Whether one of the two amplitudes is at its limit, where both answers are right."""
        return any(abs(ratio - 1.0) <= BORDER for ratio in (self.report.worst_ratio, self.check.ratio))


def measure(sets: int = 200, seed: str = "", benches: str = "", model: str = "", roads: int = 1) -> dict[str, Any]:
    """`sets` gain sets in all, in turn of the published and the wider box, on the vehicles' verify models.

    Each drives `roads` roads of its own, of the generator's families. seed: any text; '' is the hash of the commit.
    benches: bench files with commas between; '' is one a vehicle. sets: fewer while developing, with another seed.
    """
    used_seed, paths = seed or _commit(), bench_files(benches)
    drives: list[JudgedDrive] = []
    for number, path in enumerate(paths):
        bench, share = load(path), sets // len(paths) + (number < sets % len(paths))
        drives += _judge_bench(bench, model or bench.spec.verify_model, DriveCounts(share, roads), used_seed)
    differing = [drive for drive in drives if drive.differs]
    plain = [drive for drive in drives if drive.is_plain]
    shaking = sum(drive.report.is_oscillating for drive in drives)
    interval = binomtest(len(differing), max(1, len(drives))).proportion_ci(method="wilson")
    detail = {
        "seed": used_seed,
        "gain_sets": sets,
        "oscillating_by_metric": shaking,
        "oscillating_by_check": sum(drive.check.ratio > 1.0 for drive in drives),
        "only_metric": sum(drive.report.is_oscillating for drive in differing),
        "only_check": sum(not drive.report.is_oscillating for drive in differing),
        "n_to_the_end_without_replans": len(plain),
        "differ_to_the_end_without_replans": sum(drive.differs for drive in plain),
        "differ_at_the_limit": sum(drive.is_borderline for drive in differing),
        "all_that_differ": [_description(drive) for drive in differing],
    }
    value = 100.0 * len(differing) / max(1, len(drives))
    low, high = 100.0 * interval.low, 100.0 * interval.high
    return {"value": value, "unit": "%", "n": len(drives), "low": low, "high": high, "detail": rounded(detail)}


class DriveCounts(NamedTuple):
    """Gain sets of a vehicle, and roads of each of them."""

    sets: int
    roads: int


def random_sets(sets: int, seed: str) -> Iterator[dict[str, float]]:
    """Vectors with all parameters of the complete set, drawn in turn from the wider and from the published box."""
    chance = Random(seed)
    for number in range(sets):
        box = BoxChoice.PAPER if number % 2 else BoxChoice.DEFAULT
        drawn = {name: round32(_drawn(tunable_in_box(name, box), chance)) for name in SETS["complete"]}
        yield {**study_values(), **drawn}


def _drawn(tunable: Tunable, chance: Random) -> float:
    if tunable.choices:
        return chance.choice(tunable.choices)
    if tunable.scale == "log":
        return tunable.low * (tunable.high / tunable.low) ** chance.random()
    return chance.uniform(tunable.low, tunable.high)


def _judge_bench(bench: Bench, model: str, counts: DriveCounts, seed: str) -> Iterator[JudgedDrive]:
    name = bench.vehicle.name
    drawn = [values for values in random_sets(counts.sets, f"{seed} {name}") for _ in range(counts.roads)]
    roads = road_set(bench.vehicle, "families", len(drawn), Random(f"{seed} {name} roads").randrange(10**6))
    with Batch(bench, model) as batch:
        for first in range(0, len(drawn), DRIVES_AT_ONCE):
            some = list(zip(drawn, roads, strict=True))[first : first + DRIVES_AT_ONCE]
            driven = batch.drive([Job(values, road) for values, road in some], columns=True)
            for number, ((_, road), one) in enumerate(zip(some, driven, strict=True), first):
                if one.grade is not None and one.recording is not None:
                    text = f"{name} set {number // counts.roads} {road.name}"
                    yield judge(text, one, bench.course(road), bench.vehicle.nominal.rest_pedal_frac)


def judge(name: str, driven: Driven, course: Course, rest_frac: float) -> JudgedDrive:
    """Both judgements of a drive. The check's reference is the plan by time, which no re-plan and no drive changes."""
    assert driven.grade is not None and driven.recording is not None
    dt_s, rows = driven.recording.dt_s, np.minimum(np.arange(driven.recording.ticks), course.ticks - 1)
    columns = {key: _bridged(column) for key, column in driven.recording.columns.items()}
    for key, plan in samples_from_plan(course)._asdict().items():
        columns |= {} if plan is None else {key: np.asarray(plan)[rows]}
    swings = [CheckedSwing()]
    if driven.recording.ticks * dt_s >= MIN_DRIVE_S:
        swings += [strongest_swing(columns, row, dt_s) for row in CHECKED if row.column in columns]
        swings.append(alternation(columns, rest_frac, dt_s))
    grade = driven.grade
    return JudgedDrive(name, grade.oscillation, max(swings), grade.outcome, grade.replans)


def _bridged(values: Array) -> Array:
    known = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(len(values)), known, values[known])


def _description(drive: JudgedDrive) -> dict[str, Any]:
    worst = drive.report.worst
    metric = {} if worst is None else {"metric": oscillation_text(worst), "metric_ratio": worst.ratio}
    how = {"outcome": drive.outcome, "replans": drive.replans}
    return {"drive": drive.name, **how, **metric, "check": drive.check._asdict()}


def _commit() -> str:
    words = ["git", "rev-parse", "HEAD"]
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
