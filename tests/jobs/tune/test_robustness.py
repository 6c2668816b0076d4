"""The robustness check: which trials are driven in the slower car, what is stored, the winner, and the text."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from msgspec.structs import replace as with_fields

from tests.bench.tiny import write_bench
from tests.jobs.ended import ended
from tunefree_hil.base.errors import PeerGone
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Driven, Job
from tunefree_hil.config.schema import ControllerSpec
from tunefree_hil.config.tuning.require_schema import RequireSpec
from tunefree_hil.grade.score import ScenarioGrade, combine_scores
from tunefree_hil.jobs.commission import report as commission_report
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune import robustness as robustness_module
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors
from tunefree_hil.jobs.tune.robustness import (
    FILE,
    RobustnessResult,
    check_robustness,
    robustness_data,
    robustness_table,
    robustness_text,
)
from tunefree_hil.tune.journal import Journal, open_journal, slot_key
from tunefree_hil.tune.robust_winner import DriveTotals, is_robust
from tunefree_hil.tune.space import resolve_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.trial import Evaluation
from tunefree_hil.tune.trial_loop import run_generations

SCENARIOS = ("tiny", "other")
TRIALS = 8
EDGE = 0.004  # of mrac.p: above it the slower car re-plans, and the better is the grade


class Plant:
    """A batch on which more mrac.p is a better grade, until slower actuators make it re-plan."""

    def __init__(self, *, edge: float = EDGE, indifferent: bool = False, lost: bool = False) -> None:
        self.edge, self.indifferent, self.lost = edge, indifferent, lost
        self.jobs: list[Job] = []

    def drive(self, jobs: Sequence[Job]) -> list[Driven]:
        self.jobs += jobs
        if self.lost:
            raise PeerGone("batch")
        return [self._driven(job) for job in jobs]

    def _driven(self, job: Job) -> Driven:
        p, slow = job.values["mrac.p"], 0.0 if self.indifferent else job.scale["lag"] - 1.0
        upset = slow > 0.0 and p > self.edge
        score = 1.0 / (1.0 + 1000.0 * p) + 0.1 * slow + (3.0 if upset else 0.0)
        outcome = "left_lane" if upset and job.scenario.name == "other" else "finished"
        return Driven(ScenarioGrade(job.scenario.name, score, {}, 4 * upset, outcome, 200), 200, "")


def as_it_is(values: Mapping[str, float]) -> Evaluation:
    score = 1.0 / (1.0 + 1000.0 * values["mrac.p"])
    grades = [ScenarioGrade(name, score, {}, 0, "finished", 200) for name in SCENARIOS]
    return Evaluation(combine_scores(grades), {one.scenario: one.as_data() for one in grades})


def with_slower(bench: Bench, slower: float) -> Bench:
    return replace(bench, spec=with_fields(bench.spec, tune=with_fields(bench.spec.tune, slower=slower)))


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return with_slower(load(write_bench(tmp_path, scenarios=SCENARIOS)), 1.5)


@pytest.fixture
def journal(bench: Bench, tmp_path: Path) -> Journal:
    settings = StudySettings(resolve_space("mrac", [], file=bench.file), 1, "random", "sha256:00", {}, in_flight=4)
    made = open_journal(tmp_path / "trials.jsonl", settings)
    for name, values in compute_baseline_vectors(bench).items():
        made.add_baseline(name, values, as_it_is(values))
    list(run_generations(made, TRIALS, lambda points: [as_it_is(parameters_of(bench, p)) for p in points.values()]))
    edges = [trial.parameters["mrac.p"] > EDGE for trial in made.trials()]
    assert any(edges) and not all(edges), "the search must have gone beyond the edge, and not only"
    return made


def checked(bench: Bench, journal: Journal, plant: Plant, folder: Path) -> tuple[RobustnessResult, list[str]]:
    found, events = ended(
        check_robustness(bench, RunFolder(folder, {}), journal, compute_baseline_vectors(bench), plant)
    )
    return found, [f"{event.kind}: {event.message}" for event in events]


def test_the_winner_is_the_best_grade_that_the_slower_car_bears(bench: Bench, journal: Journal, tmp_path: Path) -> None:
    plant = Plant()
    result, _ = checked(bench, journal, plant, tmp_path)
    winner, best = result.rank_trials(journal.trials())[0], journal.best()
    assert best is not None and best.parameters["mrac.p"] > EDGE >= winner.parameters["mrac.p"]
    assert winner.parameters["mrac.p"] == max(
        one.parameters["mrac.p"] for one in journal.trials() if one.parameters["mrac.p"] <= EDGE
    )
    assert all(job.scale == {"dead_time": 1.5, "lag": 1.5} and not job.effects for job in plant.jobs)
    assert set(compute_baseline_vectors(bench)) <= set(result.totals)
    assert len(plant.jobs) == len(result.totals) * len(SCENARIOS), "nothing is driven twice"


def test_what_was_passed_over_is_named_with_the_reason(bench: Bench, journal: Journal, tmp_path: Path) -> None:
    result, _ = checked(bench, journal, Plant(), tmp_path)
    data = robustness_data(result, journal, journal.trials())
    best = journal.best()
    assert best is not None and data["winner"]["holds"] and not data["passed_over"][0]["holds"]
    words, table = robustness_text(data), "\n".join(robustness_table(data))
    passed = f"robustness check (delays and lags +50 %): {data['holding']} of {data['driven']} passed"
    assert words.startswith(f"{passed}; {slot_key(best.slot)} has a better score ({best.score:.3f}) but was rejected")
    assert "re-plans 8 times and fails in 1 scenario in the slower car" in words
    assert f"{data['winner']['key']}, the winner" in table and passed[1:] in table
    assert all(name in table for name in compute_baseline_vectors(bench))
    json.dumps(data, allow_nan=False)
    page = "\n".join(commission_report._section(tmp_path, "tune", {"sentence": words, "held": data}, []))
    assert "| gains | score | in a slower car |" in page and f"| {data['winner']['key']}, the winner | " in page


def test_it_is_kept_and_read_again_as_long_as_the_trials_are_those(
    bench: Bench, journal: Journal, tmp_path: Path
) -> None:
    result, _ = checked(bench, journal, Plant(), tmp_path)
    again = Plant()
    assert checked(bench, journal, again, tmp_path)[0] == result and not again.jobs
    other = with_slower(bench, 1.2)
    assert checked(other, journal, again, tmp_path)[0].factor == 1.2 and again.jobs
    again.jobs.clear()
    list(
        run_generations(
            journal, TRIALS + 4, lambda points: [as_it_is(parameters_of(bench, p)) for p in points.values()]
        )
    )
    checked(other, journal, again, tmp_path)
    assert again.jobs


def test_where_no_trial_holds_that_is_said_and_the_best_mean_wins(
    bench: Bench, journal: Journal, tmp_path: Path
) -> None:
    result, _ = checked(bench, journal, Plant(edge=0.0), tmp_path)
    trials = journal.trials()
    assert set(map(slot_key, range(TRIALS))) <= set(result.totals) and not any(
        is_robust(one, result.totals) for one in trials
    )
    data = robustness_data(result, journal, trials)
    assert result.rank_trials(trials)[0] == journal.best() and not data["passed_over"]
    assert robustness_text(data).endswith("the winner FAILED it: it re-plans 8 times and fails in 1 scenario")


@pytest.mark.parametrize(
    ("plant", "words"),
    [
        (Plant(indifferent=True), "no actuators that could be slower"),
        (Plant(lost=True), "batch is gone"),
    ],
)
def test_what_cannot_be_driven_slower_is_said_and_the_best_grade_wins(
    bench: Bench, journal: Journal, tmp_path: Path, plant: Plant, words: str
) -> None:
    result, said = checked(bench, journal, plant, tmp_path)
    assert result.totals == {} and words in result.reason and any(line.startswith("warning") for line in said)
    assert result.rank_trials(journal.trials())[0] == journal.best()
    assert words in robustness_text(robustness_data(result, journal, journal.trials()))
    assert not (tmp_path / FILE).exists(), "the next time it is tried again"


def test_somebody_elses_controller_is_chosen_by_grade(
    bench: Bench, journal: Journal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robustness_module, "Batch", lambda *_: pytest.fail("no batch knows it"))
    foreign = replace(bench, spec=with_fields(bench.spec, controller=ControllerSpec(command=["pursuit"])))
    result, _ = ended(check_robustness(foreign, RunFolder(tmp_path, {}), journal, compute_baseline_vectors(bench)))
    assert "only our controller" in result.reason and result.rank_trials(journal.trials())[0] == journal.best()


def test_a_joined_controller_is_chosen_by_grade_whatever_ours_would_have_borne(
    bench: Bench, journal: Journal, tmp_path: Path
) -> None:
    checked(bench, journal, Plant(), tmp_path)
    assert (tmp_path / FILE).exists(), "an earlier version drove ours and kept that"
    run, plant = RunFolder(tmp_path, {"joined": "pursuit"}), Plant()
    result, _ = ended(check_robustness(bench, run, journal, compute_baseline_vectors(bench), plant))
    assert (
        "not pursuit" in result.reason and not plant.jobs and result.rank_trials(journal.trials())[0] == journal.best()
    )


class Swinging(Plant):
    """In the slower car, beyond the edge, the wheel swings by 0.08 rad on one road, and nothing else happens."""

    def _driven(self, job: Job) -> Driven:
        p, slow = job.values["mrac.p"], job.scale["lag"] - 1.0
        is_swinging = slow > 0.0 and p > EDGE and job.scenario.name == "other"
        requirements = {"steer_oscillation_rad": 0.08 if is_swinging else 0.01}
        score = 1.0 / (1.0 + 1000.0 * p) + 0.1 * slow
        grade = ScenarioGrade(job.scenario.name, score, {}, 0, "finished", 200, requirements=requirements)
        return Driven(grade, 200, "")


def test_a_trial_that_oscillates_in_the_slower_car_does_not_pass(
    bench: Bench, journal: Journal, tmp_path: Path
) -> None:
    result, _ = checked(bench, journal, Swinging(), tmp_path)
    assert result.rank_trials(journal.trials())[0].parameters["mrac.p"] <= EDGE
    words = robustness_text(robustness_data(result, journal, journal.trials()))
    assert "oscillates in 1 scenario in the slower car" in words


def test_a_bench_file_may_allow_the_oscillation(bench: Bench, journal: Journal, tmp_path: Path) -> None:
    require = with_fields(bench.spec.require or RequireSpec(), steer_oscillation_rad=0.1)
    allowed = replace(bench, spec=with_fields(bench.spec, require=require))
    result, _ = checked(allowed, journal, Swinging(), tmp_path)
    assert result.rank_trials(journal.trials())[0].parameters["mrac.p"] > EDGE


def test_what_an_older_version_kept_is_driven_again(bench: Bench, journal: Journal, tmp_path: Path) -> None:
    checked(bench, journal, Plant(), tmp_path)
    kept = json.loads((tmp_path / FILE).read_text())
    (tmp_path / FILE).write_text(json.dumps({**kept, "schema": "tunefree.held/1"}))
    plant = Plant()
    checked(bench, journal, plant, tmp_path)
    assert plant.jobs


def test_one_or_one_trial_leaves_nothing_to_choose(bench: Bench, journal: Journal, tmp_path: Path) -> None:
    plant = Plant()
    assert checked(with_slower(bench, 1.0), journal, plant, tmp_path)[0] == RobustnessResult() and not plant.jobs
    assert robustness_text(robustness_data(RobustnessResult(), journal, journal.trials())) == ""
    assert robustness_table(robustness_data(RobustnessResult(), journal, journal.trials())) == []


def test_a_drive_that_the_bench_ended_does_not_hold(bench: Bench, journal: Journal, tmp_path: Path) -> None:
    class Losing(Plant):
        def _driven(self, job: Job) -> Driven:
            return super()._driven(job) if job.values["mrac.p"] < EDGE else Driven(None, 7, "node_lost")

    result, _ = checked(bench, journal, Losing(), tmp_path)
    worst = DriveTotals(bench.weights.failure_score, 0, len(SCENARIOS))
    assert worst in result.totals.values() and result.rank_trials(journal.trials())[0].parameters["mrac.p"] < EDGE
