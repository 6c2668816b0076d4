"""Candidates over roads and cars with racing, on a stand-in for the batch: what is driven, scored and stored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import BenchError
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Driven, Job
from tunefree_hil.grade.requirements.judgement import measure_violation
from tunefree_hil.grade.score import ScenarioGrade
from tunefree_hil.jobs.tune.ensemble.cars import EnsembleCars
from tunefree_hil.jobs.tune.ensemble.evaluator import EnsembleEvaluator
from tunefree_hil.jobs.tune.evaluators import VectorCandidate
from tunefree_hil.tune.ensemble import CARS, nominal_drives
from tunefree_hil.tune.trial import Baseline, Evaluation

ROADS = ("calm", "sharp", "long", "last")
LIMITS = {"steer_oscillation_rad": 0.05}
N_BASELINES = 2


class Plant:
    """The grade is q1; 'sharp' is graded q1 squared. Above q1 = 0.5 the wheel swings on 'sharp', above 0.8 it fails.

    A heavier car is graded worse, and swings from q1 = 0.3 on, on 'long'.
    """

    def __init__(self, lost: bool = False) -> None:
        self.jobs: list[Job] = []
        self.lost = lost

    def drive(self, jobs: Sequence[Job]) -> list[Driven]:
        self.jobs += jobs
        return [self._driven(job) for job in jobs]

    def _driven(self, job: Job) -> Driven:
        if self.lost:
            return Driven(None, 3, "ins_missing")
        q1, road = job.values["lqr.q1"], job.scenario.name
        heavy = job.effects.get("payload", {}).get("mass_kg", 0.0) > 0.0
        swing = 0.2 if (road == "sharp" and q1 > 0.5) or (heavy and road == "long" and q1 > 0.3) else 0.01
        outcome = "left_lane" if road == "sharp" and q1 > 0.8 else "finished"
        score = (q1 * q1 if road == "sharp" else q1) + (0.5 if heavy else 0.0)
        values = {"steer_oscillation_rad": swing}
        return Driven(ScenarioGrade(road, score, {}, 0, outcome, 200, requirements=values), 200, "")


def make_bench(folder: Path, more: str = "") -> Bench:
    table = f"[ensemble]\ncars = 3\nmass = [1.0, 1.3]\n{more}\n"
    return load(write_bench(folder, scenarios=ROADS, more=table))


class Session:
    """An evaluator whose baselines are stored as they come."""

    def __init__(self, bench: Bench, plant: Plant) -> None:
        assert bench.spec.ensemble is not None
        self.plant = plant
        self.baselines: dict[str, Baseline] = {}
        self.cars = EnsembleCars(bench, bench.spec.ensemble, bench.spec.model, bench.spec.seed)
        self.evaluator = EnsembleEvaluator(
            plant, bench, self.cars, lambda: self.baselines, limits=LIMITS, first_trial=N_BASELINES
        )
        self.bench = bench
        for group, q1 in enumerate((0.2, 0.4)):
            (evaluation,) = self.evaluator.evaluate([self.candidate(group, q1)])
            self.baselines[f"set {group}"] = Baseline({}, evaluation.score, evaluation.scenarios)

    def candidate(self, group: int, q1: float) -> VectorCandidate:
        return VectorCandidate(group, parameters_of(self.bench, {"lqr.q1": q1}))

    def trials(self, *q1: float) -> list[Evaluation]:
        self.plant.jobs.clear()
        return self.evaluator.evaluate([self.candidate(N_BASELINES + i, one) for i, one in enumerate(q1)])


def violation(evaluation: Evaluation) -> float:
    return measure_violation(evaluation.scenarios, LIMITS)


def test_a_good_candidate_drives_every_road_with_every_car_once(tmp_path: Path) -> None:
    session = Session(make_bench(tmp_path), Plant())
    (good,) = session.trials(0.1)
    driven = [(job.scenario.name, str(job.effects), job.seed) for job in session.plant.jobs]
    assert len(driven) == len(set(driven)) == 12
    assert {name: drive[CARS]["drives"] for name, drive in good.scenarios.items()} == dict.fromkeys(ROADS, 3)
    assert [job.scenario.name for job in session.plant.jobs[:2]] == ["sharp", "calm"], "the discriminating road first"
    assert list(good.scenarios) == list(ROADS), "stored in the order of the bench file"


def test_a_bad_candidate_is_dropped_and_is_worse_than_one_that_is_not(tmp_path: Path) -> None:
    session = Session(make_bench(tmp_path), Plant())
    good, swinging, failing = session.trials(0.45, 0.6, 0.9)
    assert len(session.plant.jobs) == 12 + 2 + 2
    assert set(swinging.scenarios) == set(failing.scenarios) == {"sharp", "calm"}
    assert good.score < swinging.score <= failing.score + 1.0
    assert violation(good) == 0.0 < violation(swinging) <= violation(failing)
    pace = session.evaluator.pace
    assert pace["drives"] == 2 * 12 + 16 and pace["saved_drives"] == 2 * 10


def test_an_evaluation_depends_on_the_candidate_alone(tmp_path: Path) -> None:
    """Alone, with others, in another session: what a resumed study needs."""
    first, second = Session(make_bench(tmp_path), Plant()), Session(make_bench(tmp_path), Plant())
    together = first.trials(0.45, 0.6, 0.1)
    alone = [second.trials(q1)[0] for q1 in (0.45, 0.6, 0.1)]
    assert together == alone


def test_without_racing_all_is_driven(tmp_path: Path) -> None:
    session = Session(make_bench(tmp_path, "racing = 0"), Plant())
    session.trials(0.9)
    assert len(session.plant.jobs) == 12


@pytest.mark.parametrize(("judge", "beyond"), [("mean", 0.0), ("tail", 0.0), ("constraint", 3.0)])
def test_the_other_cars_count_as_score_or_as_constraint(tmp_path: Path, judge: str, beyond: float) -> None:
    session = Session(make_bench(tmp_path, f'judge = "{judge}"\ntail = 20\n'), Plant())
    (evaluation,) = session.trials(0.4)
    assert violation(evaluation) == pytest.approx(beyond)
    nominal = (3 * 0.4 + 0.16) / 4
    mean = nominal + 0.5 * 2 / 3
    expected = {"mean": mean, "tail": 0.5 * (mean + 0.9), "constraint": nominal}
    assert evaluation.score == pytest.approx(expected[judge])
    assert set(nominal_drives(evaluation.scenarios)) == set(ROADS)


def test_every_candidate_meets_the_same_cars_and_noise(tmp_path: Path) -> None:
    session = Session(make_bench(tmp_path), Plant())

    def met(q1: float) -> Mapping[tuple[str, str], tuple[int | None, dict[str, float]]]:
        session.trials(q1)
        return {(job.scenario.name, str(job.effects)): (job.seed, dict(job.scale)) for job in session.plant.jobs}

    assert met(0.1) == met(0.2)
    assert sum(seed is None for seed, _ in met(0.1).values()) == len(ROADS), "the model as it is has the roads' noise"


def test_a_failure_of_the_bench_is_none_of_the_candidate(tmp_path: Path) -> None:
    session = Session(make_bench(tmp_path), Plant())
    session.plant.lost = True
    with pytest.raises(BenchError) as caught:
        session.trials(0.1)
    assert caught.value.code == "ins_missing"


def test_objectives_are_combined_over_the_cars_as_scores_are(tmp_path: Path) -> None:
    """Every metric of the plant is its grade, so each objective is the score; a dropped candidate fails in both."""

    class Measured(Plant):
        def _driven(self, job: Job) -> Driven:
            driven = super()._driven(job)
            assert driven.grade is not None
            metrics: dict[str, float | None] = dict.fromkeys(session.bench.weights.metrics, driven.grade.score)
            return driven._replace(grade=driven.grade._replace(metrics=metrics))

    session = Session(make_bench(tmp_path, "racing = 2"), Plant())
    plant = Measured()
    evaluator = EnsembleEvaluator(
        plant,
        session.bench,
        session.cars,
        lambda: session.baselines,
        limits=LIMITS,
        first_trial=N_BASELINES,
        objectives=("tracking", "comfort"),
    )
    full, dropped = evaluator.evaluate([session.candidate(N_BASELINES, 0.3), session.candidate(N_BASELINES + 1, 0.9)])
    assert full.objectives == pytest.approx((full.score, full.score))
    assert dropped.objectives[0] > 5.0 and dropped.objectives == pytest.approx((dropped.score, dropped.score), rel=0.2)
    assert all(not evaluation.objectives for evaluation in session.trials(0.3))
