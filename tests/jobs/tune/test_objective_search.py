"""A tune of two objectives: its options, what ranks and rejects, what `explain` draws, and a whole run in the batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.ended import ended
from tests.jobs.made_runs import made_tune
from tests.jobs.tune.test_batch import BatchTune
from tests.jobs.tune.test_options import resumed
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, load
from tunefree_hil.bench.batch import Driven, Job
from tunefree_hil.grade.objectives import OBJECTIVES, measure_objectives
from tunefree_hil.grade.score import ScenarioGrade, combine_scores
from tunefree_hil.jobs.options.records import ExplainOptions, TuneOptions
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune import explain as explain_job
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors
from tunefree_hil.jobs.tune.evaluators import with_objectives
from tunefree_hil.jobs.tune.folder import open_run_folder
from tunefree_hil.jobs.tune.options import make_tune_plan
from tunefree_hil.jobs.tune.robustness import check_robustness, robustness_data, robustness_table, robustness_text
from tunefree_hil.tune.journal import Journal, open_journal, slot_key
from tunefree_hil.tune.space import resolve_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.study import open_study, read_study
from tunefree_hil.tune.trial import Evaluation
from tunefree_hil.tune.trial_loop import run_generations

NAMES = tuple(OBJECTIVES)
BOTH = "tracking,comfort"
KEY = 'objectives = ["tracking", "comfort"]\n'


def bench_with_key(folder: Path) -> Path:
    bench = write_bench(folder)
    bench.write_text(bench.read_text() + KEY)
    return bench


def test_the_command_comes_before_the_bench_file_and_a_resume_keeps_it(tmp_path: Path) -> None:
    plain = write_bench(tmp_path / "plain")
    assert make_tune_plan(TuneOptions(plain)).settings.objectives == ()
    plan = make_tune_plan(TuneOptions(plain, out=tmp_path / "runs", objectives=BOTH))
    with open_run_folder(plan) as (run, _):
        pass
    again = resumed(run.path)
    assert plan.settings.objectives == again.settings.objectives == NAMES
    assert "--objectives tracking,comfort" in again.command
    file = bench_with_key(tmp_path / "file")
    assert make_tune_plan(TuneOptions(file)).settings.objectives == NAMES
    assert make_tune_plan(TuneOptions(file, objectives="score")).settings.objectives == ()


def test_weights_without_comfort_are_refused_before_there_is_a_run(tmp_path: Path) -> None:
    bench = write_bench(tmp_path, more='weights = "paper"\n')
    with pytest.raises(InputError, match="no metric of comfort or effort"):
        make_tune_plan(TuneOptions(bench, out=tmp_path / "runs", objectives=BOTH))
    assert not (tmp_path / "runs").exists()


def grade_of(name: str, tracking: float, comfort: float, replans: int = 0) -> ScenarioGrade:
    metrics: dict[str, float | None] = {"lateral_rms_after_start": tracking, "steer_rate_rms": comfort}
    return ScenarioGrade(name, 0.5 * (tracking + comfort), metrics, replans, "finished", 200)


def split(p: float) -> tuple[float, float]:
    """A large p tracks well and is uncomfortable."""
    return 0.05 + 0.1 / (1.0 + 300.0 * p), 0.1 + p


class Plant:
    """The slower car: it tracks worse by 0.02, and above `edge` it re-plans."""

    def __init__(self, edge: float) -> None:
        self.edge = edge

    def drive(self, jobs: Sequence[Job]) -> list[Driven]:
        return [self._driven(job) for job in jobs]

    def _driven(self, job: Job) -> Driven:
        tracking, comfort = split(job.values["mrac.p"])
        replans = 2 if job.values["mrac.p"] > self.edge else 0
        return Driven(grade_of(job.scenario.name, tracking + 0.02, comfort, replans), 200, "")


def make_journal(bench: Bench, folder: Path) -> Journal:
    """A study of 12 random trials; the manual set is worse than most of them in both objectives."""
    space = resolve_space("mrac", [], file=bench.file)
    journal = open_journal(
        folder / "trials.jsonl", StudySettings(space, 1, "random", "sha256:00", {}, in_flight=4, objectives=NAMES)
    )

    def evaluate(objectives: tuple[float, float]) -> Evaluation:
        grade = grade_of("tiny", *objectives)
        return with_objectives(Evaluation(combine_scores([grade]), {"tiny": grade.as_data()}), bench, NAMES)

    for name, values in compute_baseline_vectors(bench).items():
        journal.add_baseline(name, values, evaluate((0.16, 0.25)))
    list(run_generations(journal, 12, lambda points: [evaluate(split(p["mrac.p"])) for p in points.values()]))
    return journal


def with_slower(folder: Path) -> Bench:
    bench = write_bench(folder)
    bench.write_text(bench.read_text().replace("slower = 1.0", "slower = 1.5"))
    return load(bench)


def test_the_robustness_check_ranks_by_the_trade_of_both_cars(tmp_path: Path) -> None:
    bench = with_slower(tmp_path)
    journal = make_journal(bench, tmp_path)
    best = journal.best()
    assert best is not None and best.trade == min(trial.merit for trial in journal.trials())
    run = RunFolder(tmp_path, {})
    result, _ = ended(
        check_robustness(bench, run, journal, compute_baseline_vectors(bench), Plant(best.parameters["mrac.p"] * 0.999))
    )
    winner = result.rank_trials(journal.trials())[0]
    assert winner.parameters["mrac.p"] < best.parameters["mrac.p"]
    slower = result.totals[slot_key(winner.slot)]
    assert slower.trade is not None and winner.trade is not None and slower.trade > winner.trade
    data = robustness_data(result, journal, journal.trials())
    assert data["winner"]["mean"] == 0.5 * (winner.trade + slower.trade)
    assert f"has a better trade ({best.trade:.3f}) but was rejected" in robustness_text(data)
    assert "trade of the objectives" in robustness_table(data)[0]
    again, _ = ended(check_robustness(bench, run, journal, compute_baseline_vectors(bench), Plant(0.0)))
    assert again == result, "read from held.json"


class FakeBatch:
    def __init__(self, bench: Bench, model: str) -> None:
        self.bench = bench

    def __enter__(self) -> FakeBatch:
        return self

    def __exit__(self, *error: object) -> None:
        return None

    def drive(self, jobs: Sequence[Any]) -> list[Driven]:
        return [Driven(grade_of(job.scenario.name, *split(job.values["mrac.p"])), 200, "") for job in jobs]


class ObjectiveRun(NamedTuple):
    path: Path
    objectives: Mapping[int, tuple[float, ...]]


@pytest.fixture(scope="module")
def by_score(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tune by the score over a scenario long enough for every metric."""
    folder = tmp_path_factory.mktemp("scored")
    return made_tune(write_bench(folder, duration_s=4.0), folder / "runs", 21)


@pytest.fixture
def by_both(by_score: Path) -> ObjectiveRun:
    """The same tune with two objectives."""
    bench, path = load(by_score / "bench.toml"), by_score / "study.db"
    with read_study(path) as study:
        settings, trials, baselines = study.settings._replace(objectives=NAMES), study.trials(), study.baselines()
    path.rename(path.with_suffix(".old"))
    with open_study(path, settings) as study:
        for name, base in baselines.items():
            parts = measure_objectives(base.scenarios, bench.weights, NAMES)
            study.add_baseline(name, base.parameters, Evaluation(base.score, base.scenarios, objectives=parts))
        scored = {trial.slot: split(trial.parameters["mrac.p"]) for trial in trials}
        known = {trial.slot: trial for trial in trials}
        list(
            run_generations(
                study,
                len(trials),
                lambda points: [Evaluation(known[k].score, known[k].scenarios, objectives=scored[k]) for k in points],
            )
        )
    return ObjectiveRun(by_score, scored)


def test_a_search_by_score_is_explained_with_its_parts(by_score: Path) -> None:
    *events, last = explain_job.explain(ExplainOptions(by_score, points=3, slices=False))
    figures = {Path(figure).name for figure in last.data["figures"]}
    assert figures == {"difference.png", "importance.png", "pareto.png"}
    assert set(last.data["trade"]["names"]) == set(NAMES) and "objective_importance" not in last.data
    assert "the trade" not in last.message, "nothing was traded in this search"
    assert any("on the front of tracking and comfort" in event.message for event in events)


def test_importance_and_slices_of_each_objective(by_both: ObjectiveRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(explain_job, "Batch", FakeBatch)
    *_, last = explain_job.explain(ExplainOptions(by_both.path, points=3))
    figures = {Path(figure).name for figure in last.data["figures"]}
    assert {f"{kind}_{name}.png" for kind in ("importance", "slices") for name in NAMES} | {"pareto.png"} <= figures
    ranks = {name: last.data["objective_importance"][name]["mrac.p"]["rank"] for name in NAMES}
    assert ranks == pytest.approx({"tracking": -1.0, "comfort": 1.0})
    curve = last.data["slices"]["mrac.p"]
    for i, name in enumerate(NAMES):
        assert curve["objectives"][name] == pytest.approx([split(value)[i] for value in curve["values"]])
    assert "the trade: tracking cost" in last.message


@pytest.mark.compiled
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_whole_run_in_the_batch_survives_a_kill(tmp_path: Path) -> None:
    runs = []
    for folder in ("calm", "killed"):
        (tmp_path / folder).mkdir()
        tune = BatchTune(tmp_path / folder, "--objectives", BOTH, "--sampler", "tpe_relative", duration_s=4.0)
        if folder == "killed":
            tune.killed_after(8)
        runs.append((tune, tune.end()))
    (calm, done), (killed, again) = runs
    assert done.status == again.status == 0, (done.words, again.words)
    assert killed.trials() == calm.trials() and all(len(trial["objectives"]) == 2 for trial in calm.trials())
    assert again.data["trade"] == done.data["trade"] and again.data["best"] == done.data["best"]
    slots = [point["slot"] for point in done.data["trade"]["front"]]
    assert slots and done.data["trade"]["winner"]["slot"] == done.data["best"]["slot"]
    assert "the trade: tracking cost" in done.data["sentence"] and (calm.run / "figures" / "pareto.png").is_file()
    objectives = {slot_key(trial["slot"]): trial["objectives"] for trial in calm.trials()}
    confirmed = {line["confirmed"]: line["objectives"] for line in calm.lines() if "confirmed" in line}
    assert all(confirmed[key] == objectives[key] for key in confirmed if key in objectives), "batch and bus are equal"
    assert len(confirmed) == 3
