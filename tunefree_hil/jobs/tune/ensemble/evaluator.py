"""Scores candidates over roads and cars in the batch, in two rounds: the first roads alone, then all that is left."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from tunefree_hil.bench import Bench
from tunefree_hil.bench.batch import Batch
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.config.tuning.ensemble_schema import EnsembleSpec
from tunefree_hil.grade.objectives import grades_by_objective
from tunefree_hil.grade.requirements.judgement import measure_violation
from tunefree_hil.grade.score import ScenarioGrade
from tunefree_hil.jobs.tune.ensemble.cars import EnsembleCars
from tunefree_hil.jobs.tune.evaluators import Medium, VectorCandidate, grade_of
from tunefree_hil.jobs.tune.margins import JobDriver
from tunefree_hil.tune.ensemble import (
    CARS,
    RACING,
    EnsembleCar,
    HeldOutScore,
    Judgement,
    combine_ensemble,
    count_drives,
    has_failed,
    is_dropped,
    nominal_drives,
    order_roads,
    summarise_cars,
    worst_of_cars,
)
from tunefree_hil.tune.trial import Baseline, Evaluation, ScoredStudy

Violation = Callable[[Mapping[str, Mapping[str, Any]]], float]  # of drives as data, by road
Grades = dict[tuple[str, int], ScenarioGrade]  # by road and number of the car


class EnsembleEvaluator:
    """An Evaluator that drives every candidate over roads x cars, with racing.

    Baselines are driven in full and decide which roads come first, and how far beyond the requirements a candidate may
    be there. A dropped candidate has the failure score on each drive that it does not make, so it is worse than any
    that was driven in full with the same grades.
    """

    medium = Medium.BATCH

    def __init__(
        self,
        batch: JobDriver,
        bench: Bench,
        cars: EnsembleCars,
        baselines: Callable[[], Mapping[str, Baseline]],
        *,
        limits: Mapping[str, float],
        first_trial: int,
        objectives: Sequence[str] = (),
    ) -> None:
        """Make it.

        Args:
            batch: With the effects of `cars`.
            bench: With a table [ensemble].
            cars: Cars of the ensemble.
            baselines: The stored baselines; all of them once a trial is evaluated.
            limits: Requirements of the study.
            first_trial: Number of baselines, which is the group of the first trial.
            objectives: Names of the objectives of the study.
        """
        assert bench.spec.ensemble is not None
        self.batch, self.bench, self.cars, self.batch_size = batch, bench, cars, max(1, first_trial)
        self._first_trial, self._objectives = first_trial, tuple(objectives)
        self.scenarios = {name: bench.scenarios[name] for name in bench.spec.scenarios}
        self._spec: EnsembleSpec = bench.spec.ensemble
        self._judgement = Judgement(self._spec.judge, 0.01 * self._spec.tail)
        self._baselines = baselines
        self._violation: Violation = lambda drives: measure_violation(drives, limits)
        self._simulated_s = self._wall_s = 0.0
        self._made: list[Mapping[str, Mapping[str, Any]]] = []

    @property
    def drives_of_all(self) -> int:
        """Number of drives of a candidate that is not dropped."""
        return len(self.scenarios) * len(self.cars.cars)

    @property
    def pace(self) -> dict[str, float]:
        """Speed against real time, and the cost of the ensemble: drives, and those that racing saved."""
        cost = count_drives(self._made, self.drives_of_all)
        speed = {"speed_x": self._simulated_s / self._wall_s} if self._wall_s else {}
        return {**speed, "drives": cost.drives, "saved_drives": cost.saved}

    def evaluate(self, candidates: Sequence[VectorCandidate]) -> list[Evaluation]:
        """The evaluation of each candidate; it depends on the candidate and on the baselines alone."""
        grades: list[Grades] = [{} for _ in candidates]
        roads = list(self.scenarios)
        raced = [candidate for candidate in candidates if self._is_raced(candidate)]
        if raced:
            roads = self._road_order()
            first = roads[: self._spec.racing]
            self._drive(candidates, grades, [(road, self.cars.cars[0]) for road in first], raced)
            allowed = self._allowed_violation(first)
        dropped = [
            candidate in raced and self._is_dropped(made, allowed)
            for candidate, made in zip(candidates, grades, strict=True)
        ]
        running = [candidate for candidate, is_out in zip(candidates, dropped, strict=True) if not is_out]
        self._drive(candidates, grades, [(road, car) for car in self.cars.cars for road in roads], running)
        evaluations = [self._evaluation(made) for made in grades]
        self._made += [evaluation.scenarios for evaluation in evaluations]
        return evaluations

    def _is_raced(self, candidate: VectorCandidate) -> bool:
        return self._spec.racing > 0 and candidate.group >= self._first_trial > 0

    def _road_order(self) -> list[str]:
        """The roads, the most discriminating first; fixed once the baselines are stored."""
        manual = self._baselines().values()
        scores = {
            road: [baseline.scenarios[road]["score"] for baseline in manual if road in baseline.scenarios]
            for road in self.scenarios
        }
        return order_roads(list(self.scenarios), scores)

    def _allowed_violation(self, roads: Sequence[str]) -> float:
        """On these roads: so far beyond that of the best manual set which drives them to their ends."""
        drives = [
            {road: baseline.scenarios[road] for road in roads if road in baseline.scenarios}
            for baseline in self._baselines().values()
        ]
        finished = [self._violation(nominal_drives(one)) for one in drives if not has_failed(one)]
        return RACING.max_violation + min(finished, default=math.inf)

    def _is_dropped(self, made: Grades, allowed: float) -> bool:
        drives = {road: grade.as_data() for (road, _), grade in made.items()}
        return is_dropped(drives, self._violation(drives), allowed)

    def _drive(
        self,
        candidates: Sequence[VectorCandidate],
        grades: Sequence[Grades],
        pairs: Sequence[tuple[str, EnsembleCar]],
        running: Sequence[VectorCandidate],
    ) -> None:
        """Make the drives of `running` that are missing. All candidates of a road and a car follow one another, as the
        batch keeps the noise of a limited number of them.
        """
        wanted = [
            (made, candidate, road, car)
            for road, car in pairs
            for candidate, made in zip(candidates, grades, strict=True)
            if candidate in running and (road, car.number) not in made
        ]
        started = time.monotonic()
        jobs = [self.cars.job(candidate.values, self.scenarios[road], car) for _, candidate, road, car in wanted]
        drives = self.batch.drive(jobs)
        self._wall_s += time.monotonic() - started
        self._simulated_s += sum(drive.ticks for drive in drives) * self.bench.dt_s
        for (made, _, road, car), drive in zip(wanted, drives, strict=True):
            made[road, car.number] = grade_of(drive, self.scenarios[road])

    def _evaluation(self, made: Grades) -> Evaluation:
        """Score, and grades by road: of car 0 in full, of the others what they came to."""
        scenarios: dict[str, Any] = {}
        for road in self.scenarios:
            if (road, 0) not in made:
                continue
            others = [grade for (name, car), grade in made.items() if name == road and car != 0]
            scenarios[road] = made[road, 0].as_data() | {CARS: summarise_cars(others, 1 + len(others))}
            if others and self._judgement.judge == "constraint":
                worst = worst_of_cars(others)
                scenarios[worst["scenario"]] = worst
        scored = self._scored(made)
        parts = [grades_by_objective(scored, self.bench.weights, objective) for objective in self._objectives]
        objectives = tuple(combine_ensemble(part, self._judgement) for part in parts)
        return Evaluation(combine_ensemble(scored, self._judgement), scenarios, objectives=objectives)

    def _scored(self, made: Grades) -> list[ScenarioGrade]:
        """The grades that the score is made of; a drive that was not made has the failure score."""
        cars = self.cars.cars[:1] if self._judgement.judge == "constraint" else self.cars.cars
        return [
            made.get((road, car.number)) or self._not_driven(scenario)
            for road, scenario in self.scenarios.items()
            for car in cars
        ]

    def _not_driven(self, scenario: ScenarioSpec) -> ScenarioGrade:
        planned = self.bench.course(scenario).ticks
        return ScenarioGrade(scenario.name, self.bench.weights.failure_score, {}, 0, "dropped", planned)


@contextmanager
def open_batch(bench: Bench) -> Iterator[tuple[Batch, EnsembleCars | None]]:
    """The batch of a bench, and the cars of its ensemble; None without one."""
    cars = None
    if bench.spec.ensemble is not None:
        cars = EnsembleCars(bench, bench.spec.ensemble, bench.spec.model, bench.spec.seed)
    with Batch(bench, extra_effects=() if cars is None else cars.effects) as batch:
        yield batch, cars


def ensemble_data(bench: Bench, study: ScoredStudy, held_out: Mapping[str, HeldOutScore]) -> dict[str, Any]:
    """The value of "ensemble" in a result: what varied, what it cost, and what chose the winner."""
    spec = bench.spec.ensemble
    assert spec is not None
    evaluations = [scored.scenarios for scored in (*study.trials(), *study.baselines().values())]
    cost = count_drives(evaluations, spec.cars * len(bench.spec.scenarios))
    return {
        "cars": spec.cars,
        "judge": spec.judge,
        **cost.as_data(),
        "selected": {name: score._asdict() for name, score in held_out.items()},
    }
