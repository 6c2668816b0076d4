"""An ensemble of cars for a search: which cars, what a candidate scores over them, and when it is dropped.

Pure functions. The cars follow from ranges, number and seed alone, and drive with the same noise for every candidate
(common random numbers), so that a difference between two candidates is one of their parameters. A candidate that fails
or is far beyond the requirements on the first roads is dropped (racing, as of irace: Lopez-Ibanez et al. 2016, Oper.
Res. Perspect. 3, 43-58); that depends on the candidate and on fixed limits, so trials can be repeated and resumed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.grade.margins import NOMINAL, CarVariant
from tunefree_hil.grade.score import FINISHED, ScenarioGrade, combine_scores
from tunefree_hil.tune.journal import slot_key
from tunefree_hil.tune.trial import Trial

CARS = "cars"  # key of a road's grade as data: what the other cars did on it
OTHER_CARS = " (other cars)"  # end of the name of an entry that has the worst of the other cars on a road
MAX_SEED = 2**32


class FactorRange(NamedTuple):
    """The interval of a factor on a number of the model."""

    low: float
    high: float


class CarRanges(NamedTuple):
    """What differs from car to car, as factors on the model.

    variant: By field of a CarVariant. numbers: Single numbers of the model, by their names of bench/scaling.py.
    """

    variant: Mapping[str, FactorRange] = {}
    numbers: Mapping[str, FactorRange] = {}


class EnsembleCar(NamedTuple):
    """A car of the ensemble. Number 0 is the model as it is. numbers: Factors on single numbers of the model."""

    number: int
    variant: CarVariant = NOMINAL
    numbers: Mapping[str, float] = {}


class RacingCriteria(NamedTuple):
    """When a candidate is dropped."""

    max_violation: float = 0.5  # of the requirements, beyond the best manual set's on the same roads


RACING = RacingCriteria()


class HeldOutCriteria(NamedTuple):
    """Which trials are compared on held-out roads."""

    near_equal_share: float = 0.05  # of the best trial's score in the model as it is; nearer is chance (issue 44)
    max_trials: int = 16  # the best ones of these


HELD_OUT = HeldOutCriteria()


class Judgement(NamedTuple):
    """How drives become a score. judge: as in [ensemble]; tail_share: of the drives that are the worst ones."""

    judge: str
    tail_share: float


def draw_cars(ranges: CarRanges, count: int, seed: int) -> list[EnsembleCar]:
    """The model as it is, and `count` - 1 cars by a Latin hypercube over the ranges."""
    spans = [*ranges.variant.values(), *ranges.numbers.values()]
    cars = [EnsembleCar(0)]
    for number, row in enumerate(_latin_hypercube(count - 1, len(spans), seed), 1):
        factors = [span.low + float(share) * (span.high - span.low) for span, share in zip(spans, row, strict=True)]
        variant = NOMINAL._replace(**dict(zip(ranges.variant, factors, strict=False)))
        cars.append(
            EnsembleCar(number, variant, dict(zip(ranges.numbers, factors[len(ranges.variant) :], strict=True)))
        )
    return cars


def noise_seed(scenario_seed: int, car: EnsembleCar) -> int:
    """The seed of the noise of a car on a road: the road's own for car 0, another one for each other car."""
    if car.number == 0:
        return scenario_seed
    return int(np.random.SeedSequence([scenario_seed, car.number]).generate_state(1)[0]) % MAX_SEED


def combine_ensemble(grades: Sequence[ScenarioGrade], judgement: Judgement) -> float:
    """The score over the drives of all cars, lower is better; for "constraint" give the drives of car 0 alone."""
    mean = combine_scores(grades)
    if judgement.judge != "tail":
        return mean
    return 0.5 * (mean + tail_mean([grade.score for grade in grades], judgement.tail_share))


def tail_mean(scores: Sequence[float], share: float) -> float:
    """Mean of the worst `share` of the scores, at least one of them (conditional value at risk)."""
    count = max(1, math.ceil(share * len(scores) - 1e-9))
    return float(np.mean(sorted(scores, reverse=True)[:count]))


def order_roads(names: Sequence[str], scores: Mapping[str, Sequence[float]]) -> list[str]:
    """The roads, the most discriminating first: by the spread of the manual sets' scores over their mean.

    Args:
        names: Roads in the order of the bench file, which decides between equals.
        scores: Scores of the manual sets by road; of a road without two the spread counts as 0.
    """

    def spread(name: str) -> float:
        values = scores.get(name, ())
        return float(np.std(values) / max(np.mean(values), 1e-9)) if len(values) > 1 else 0.0

    return sorted(names, key=lambda name: -spread(name))


def is_dropped(drives: Mapping[str, Mapping[str, Any]], violation: float, allowed: float) -> bool:
    """Whether a candidate is dropped after its first roads: a drive failed, or its violation is above `allowed`."""
    return has_failed(drives) or violation > allowed


def has_failed(drives: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether a drive was not finished."""
    return any(drive["outcome"] != FINISHED for drive in drives.values())


def summarise_cars(grades: Sequence[ScenarioGrade], drives: int) -> dict[str, Any]:
    """What the other cars did on a road, for its entry. drives: made on this road, car 0 included."""
    scores = [grade.score for grade in grades]
    return {"drives": drives, "mean": float(np.mean(scores)) if scores else None, "worst": max(scores, default=None)}


def worst_of_cars(grades: Sequence[ScenarioGrade]) -> dict[str, Any]:
    """The entry of a road with the worst of the other cars: it is judged like a drive, and has no share in a score."""
    failed = [grade.outcome for grade in grades if grade.outcome != FINISHED]
    names = {name for grade in grades for name in grade.requirements}
    values = {name: [v for grade in grades if (v := grade.requirements.get(name)) is not None] for name in names}
    return {
        "scenario": grades[0].scenario + OTHER_CARS,
        "score": max(grade.score for grade in grades),
        "metrics": {},
        "replans": max(grade.replans for grade in grades),
        "outcome": failed[0] if failed else FINISHED,
        "planned_samples": 0,
        "dropped": (),
        "requirements": {name: max(known) if known else None for name, known in sorted(values.items())},
    }


def nominal_drives(scenarios: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The drives of car 0 alone, as without an ensemble."""
    return {
        name: {key: value for key, value in drive.items() if key != CARS}
        for name, drive in scenarios.items()
        if not name.endswith(OTHER_CARS)
    }


def has_ensemble(scenarios: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether these are the drives of several cars."""
    return any(CARS in drive for drive in scenarios.values())


def with_drives_over_bus(
    batch: Mapping[str, Mapping[str, Any]], bus: Mapping[str, Mapping[str, Any]]
) -> dict[str, dict[str, Any]]:
    """The drives of an ensemble with those of car 0 as driven over the bus; the bus has no other cars."""
    scenarios = {name: dict(drive) for name, drive in batch.items()}
    for name, drive in bus.items():
        cars = {CARS: scenarios[name][CARS]} if CARS in scenarios.get(name, {}) else {}
        scenarios[name] = {**drive, **cars}
    return scenarios


def nominal_score(score: float, scenarios: Mapping[str, Mapping[str, Any]]) -> float:
    """The score of car 0 alone; that of the evaluation where it had no ensemble."""
    if not has_ensemble(scenarios):
        return score
    drives = nominal_drives(scenarios).values()
    samples = sum(drive["planned_samples"] for drive in drives)
    return sum(drive["score"] * drive["planned_samples"] for drive in drives) / samples


def find_near_equal(ranked: Sequence[Trial], criteria: HeldOutCriteria = HELD_OUT) -> list[Trial]:
    """The first trial of a ranking, and those whose merit is nearly as good and whose violation is no larger."""
    if not ranked:
        return []
    best = ranked[0]
    # A share of the nominal score: a car that every set fails with adds the same large number to all ensemble scores.
    unit = nominal_score(best.score, best.scenarios) if best.trade is None else best.trade
    limit = best.merit + criteria.near_equal_share * unit
    near = [trial for trial in ranked if trial.merit <= limit and trial.violation <= best.violation]
    return near[: criteria.max_trials]


class HeldOutScore(NamedTuple):
    """What a trial came to on held-out roads; smaller is better. Stored under its field names.

    score: In a study of several objectives their trade.
    """

    violation: float
    score: float


def rank_by_held_out(ranked: Sequence[Trial], held_out: Mapping[str, HeldOutScore]) -> list[Trial]:
    """The trials with a held-out score first, the best of them in front; the others keep their order.

    Args:
        ranked: Trials in their order on the search roads.
        held_out: By `slot_key` of a trial.
    """
    chosen = [trial for trial in ranked if slot_key(trial.slot) in held_out]
    others = [trial for trial in ranked if slot_key(trial.slot) not in held_out]
    return sorted(chosen, key=lambda trial: held_out[slot_key(trial.slot)]) + others


class EnsembleCost(NamedTuple):
    """Drives of a study. saved: those that racing left out. dropped: candidates that it dropped."""

    drives: int
    saved: int
    dropped: int

    def as_data(self) -> dict[str, int]:
        """Plain data for JSON and for progress events."""
        return self._asdict()


def count_drives(evaluations: Sequence[Mapping[str, Mapping[str, Any]]], drives_of_all: int) -> EnsembleCost:
    """The drives of evaluations, from their scenarios as stored.

    Args:
        evaluations: Scenarios of each candidate.
        drives_of_all: Number of drives of a candidate that is not dropped.
    """
    made = [sum(drive.get(CARS, {}).get("drives", 0) for drive in scenarios.values()) for scenarios in evaluations]
    return EnsembleCost(
        drives=sum(made),
        saved=sum(drives_of_all - number for number in made),
        dropped=sum(number < drives_of_all for number in made),
    )


def _latin_hypercube(rows: int, columns: int, seed: int) -> np.ndarray:
    """Shares in [0, 1), shape (rows, columns): each column has one value in each of `rows` equal parts."""
    chance = np.random.default_rng(np.random.SeedSequence([seed, rows, columns]))
    strata = np.array([chance.permutation(rows) for _ in range(columns)]).reshape(columns, rows).T
    return (strata + chance.random((rows, columns))) / max(rows, 1)
