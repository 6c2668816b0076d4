"""The choice among near-equal trials: which roads and cars, what is driven, stored, and read again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.ended import ended
from tunefree_hil.bench import Bench, load
from tunefree_hil.bench.batch import Driven, Job
from tunefree_hil.bench.load import held_out_roads_of
from tunefree_hil.grade.score import ScenarioGrade
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune.ensemble.cars import EnsembleCars
from tunefree_hil.jobs.tune.ensemble.selection import make_held_out_set, select_on_held_out, selection_text
from tunefree_hil.jobs.tune.robustness import RobustnessResult
from tunefree_hil.tune.journal import Journal, open_journal, slot_key
from tunefree_hil.tune.space import resolve_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.trial import Evaluation
from tunefree_hil.tune.trial_loop import run_generations

TRIALS = 4
TABLE = '[ensemble]\ncars = 2\nselect_roads = "families:3"\n'
ROADS = 'roads = { search = "families:3", verify = "families:3", seed = 5 }\n'


class Plant:
    """On held-out roads the grade is 1 - 9 p of MRAC; the wheel swings above p = `limit`."""

    def __init__(self, limit: float = 1.0) -> None:
        self.limit = limit
        self.jobs: list[Job] = []

    def drive(self, jobs: Sequence[Job]) -> list[Driven]:
        self.jobs += jobs
        return [self._driven(job) for job in jobs]

    def _driven(self, job: Job) -> Driven:
        p = job.values["mrac.p"]
        values = {"steer_oscillation_rad": 0.2 if p > self.limit else 0.01}
        return Driven(ScenarioGrade(job.scenario.name, 1 - 9 * p, {}, 0, "finished", 200, requirements=values), 200, "")


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return load(write_bench(tmp_path, more=ROADS + TABLE))


@pytest.fixture
def journal(bench: Bench, tmp_path: Path) -> Journal:
    """Trials that are equal on the searched roads."""
    space, limits = resolve_space("mrac", [], file=bench.file), {"steer_oscillation_rad": 0.05}
    settings = StudySettings(space, 1, "random", "sha256:00", {}, in_flight=4, requirements=limits)
    made = open_journal(tmp_path / "trials.jsonl", settings)
    list(run_generations(made, TRIALS, lambda points: [Evaluation(0.5, {}) for _ in points]))
    return made


def test_the_roads_and_the_cars_are_of_seeds_that_nothing_else_has(bench: Bench) -> None:
    spec = bench.spec.ensemble
    assert spec is not None
    held_out = make_held_out_set(bench, spec)
    known = {scenario.hash for scenario in bench.scenarios.values()}
    assert len(held_out.roads) == 3 and not known & {road.hash for road in held_out.roads}
    assert held_out.roads == tuple(held_out_roads_of(bench, "families:3"))
    searched = EnsembleCars(bench, spec, bench.spec.model, bench.spec.seed)
    assert held_out.cars.cars[1:] != searched.cars[1:]


def test_the_best_on_held_out_roads_wins(bench: Bench, journal: Journal, tmp_path: Path) -> None:
    plant, run = Plant(), RunFolder(tmp_path, {})
    ranked = RobustnessResult().rank_trials(journal.trials())
    held_out, events = ended(select_on_held_out(bench, run, journal, ranked, plant))
    assert len(plant.jobs) == TRIALS * 3 * 2 and len(held_out) == TRIALS
    winner = RobustnessResult(held_out=held_out).rank_trials(journal.trials())[0]
    assert winner.parameters["mrac.p"] == max(trial.parameters["mrac.p"] for trial in journal.trials())
    assert [event.kind for event in events] == ["note", *["progress"] * TRIALS]
    assert bench.spec.ensemble is not None
    assert selection_text(held_out, bench.spec.ensemble).startswith("chosen among 4 near-equal trials on families:3")

    again, events = ended(select_on_held_out(bench, run, journal, ranked, plant))
    assert again == held_out and not events and len(plant.jobs) == TRIALS * 3 * 2, "read from the run folder"
    other, _ = ended(select_on_held_out(bench, run, journal, ranked[1:], plant))
    assert set(other) == {slot_key(trial.slot) for trial in ranked[1:]}, "of other trials it is driven again"


def test_requirements_come_before_the_score(bench: Bench, journal: Journal, tmp_path: Path) -> None:
    values = sorted(trial.parameters["mrac.p"] for trial in journal.trials())
    plant = Plant(limit=values[1])
    ranked = journal.trials()
    held_out, _ = ended(select_on_held_out(bench, RunFolder(tmp_path, {}), journal, ranked, plant))
    winner = RobustnessResult(held_out=held_out).rank_trials(ranked)[0]
    assert winner.parameters["mrac.p"] == values[1]


def test_nothing_is_driven_where_there_is_no_choice(bench: Bench, journal: Journal, tmp_path: Path) -> None:
    plant, run = Plant(), RunFolder(tmp_path, {})
    assert ended(select_on_held_out(bench, run, journal, journal.trials()[:1], plant)) == ({}, [])
    plain = load(write_bench(tmp_path / "plain"))
    assert ended(select_on_held_out(plain, run, journal, journal.trials(), plant)) == ({}, [])
    assert not plant.jobs


def test_a_study_of_two_objectives_is_chosen_by_the_trade_on_held_out_roads(bench: Bench, tmp_path: Path) -> None:
    class Measured(Plant):
        """A large p tracks well and costs comfort, which the manual set has little to spare of."""

        def _driven(self, job: Job) -> Driven:
            p = job.values["mrac.p"]
            metrics: dict[str, float | None] = {"lateral_rms_after_start": 1.0 - p, "steer_rate_rms": 1.0 + 50.0 * p}
            return Driven(ScenarioGrade(job.scenario.name, 1 - 9 * p, metrics, 0, "finished", 200), 200, "")

    space = resolve_space("mrac", [], file=bench.file)
    names = ("tracking", "comfort")
    journal = open_journal(
        tmp_path / "both.jsonl", StudySettings(space, 1, "random", "sha256:00", {}, in_flight=4, objectives=names)
    )
    journal.add_baseline("manual", {}, Evaluation(1.0, {}, objectives=(1.0, 1.0)))
    list(run_generations(journal, TRIALS, lambda points: [Evaluation(0.5, {}, objectives=(0.5, 0.5)) for _ in points]))
    held_out, events = ended(select_on_held_out(bench, RunFolder(tmp_path, {}), journal, journal.trials(), Measured()))
    winner = RobustnessResult(held_out=held_out).rank_trials(journal.trials())[0]
    assert winner.parameters["mrac.p"] == min(trial.parameters["mrac.p"] for trial in journal.trials())
    assert held_out[slot_key(winner.slot)].score == pytest.approx(1.0 + 50.0 * winner.parameters["mrac.p"], rel=1e-4)
    assert any("has a trade of" in event.message for event in events)
