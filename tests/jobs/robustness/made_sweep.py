"""A finished tune as a folder, the plan of a sweep of it, and a stand-in for the batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tests.bench.tiny import write_bench
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Driven, Job
from tunefree_hil.config.dump import to_toml
from tunefree_hil.config.tuning.require_schema import REQUIREMENTS
from tunefree_hil.episode.recording import make_recording
from tunefree_hil.grade.score import ScenarioGrade
from tunefree_hil.jobs.identity import resolved_toml
from tunefree_hil.jobs.robustness.plan import SWEEP_SEEDS, RoadSetOrder, SweepOrder, SweepPlan, make_plan
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors

Answer = Callable[[Job], ScenarioGrade | str]  # the grade of a drive, or the name of an error of the bench


def write_tune(folder: Path, more: str = "") -> Path:
    """A complete tune of the tiny bench whose winner is the manual set with MRAC; `more`: lines of its bench file."""
    bench = load(write_bench(folder, more=more))
    run = RunFolder.create(folder / "runs", "tune-tiny", {"command": "tune", "bench": str(bench.file)})
    (run.path / "bench.toml").write_text(resolved_toml(bench))
    vectors = compute_baseline_vectors(bench)
    (run.path / "best.toml").write_text(to_toml({"parameters": {**vectors["mrac_on"], "station.kp": 0.25}}))
    run.finish()
    return run.path


def make_order(bench: Bench, roads: int = 20, *, cars: int = 5, seed: int = 1, sets: int = 2) -> SweepOrder:
    """Roads of the families; `sets` sets of gains, tuned first, told apart by station.kp."""
    vectors = {name: {**parameters_of(bench), "station.kp": 0.25 + 0.25 * i} for i, name in enumerate("abcdef"[:sets])}
    road_sets = (RoadSetOrder("families", roads, SWEEP_SEEDS + seed),)
    return SweepOrder(bench.spec.model, road_sets, cars, SWEEP_SEEDS + seed, vectors)


def plan_of(folder: Path, roads: int = 20, *, cars: int = 5, seed: int = 1, sets: int = 2) -> SweepPlan:
    """A plan of the tiny bench."""
    bench = load(write_bench(folder))
    return make_plan(bench, make_order(bench, roads, cars=cars, seed=seed, sets=sets))


def grade(job: Job, outcome: str = "finished", **values: float) -> ScenarioGrade:
    """A grade with all requirements at 0 but `values`; `replans` counts as both."""
    known = {**dict.fromkeys(REQUIREMENTS, 0.0), **values}
    score = 10.0 if outcome != "finished" else 0.2
    return ScenarioGrade(job.scenario.name, score, {}, int(known["replans"]), outcome, 100, requirements=known)


class StandIn:
    """Answers jobs as a Batch does. drives: how many; end_after: interrupts as Ctrl-C does when so many are made."""

    def __init__(self, answer: Answer = grade, end_after: int | None = None) -> None:
        self.answer, self.end_after, self.drives = answer, end_after, 0

    def drive(self, jobs: Sequence[Job], *, columns: bool = False) -> list[Driven]:
        if self.end_after is not None and self.drives >= self.end_after:
            raise KeyboardInterrupt
        self.drives += len(jobs)
        return [self._driven(job, columns) for job in jobs]

    def _driven(self, job: Job, columns: bool) -> Driven:
        recording = make_recording({"speed_mps": np.ones(5), "lateral_error_m": np.zeros(5)}, 0.01) if columns else None
        answer = self.answer(job)
        if isinstance(answer, str):
            return Driven(None, 5, answer, recording)
        return Driven(answer, 100, "" if answer.outcome == "finished" else answer.outcome, recording)

    def __enter__(self) -> StandIn:
        return self

    def __exit__(self, *_: object) -> None:
        pass
