"""The choice among near-equal trials: on held-out roads, and with other cars or a second plant.

The search adapts to its roads and its plant, so its best trials are nearly equal there by chance. They are driven once
more on roads by a seed that neither the search nor the verification has. `verify` then sees a winner that was chosen
without it.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack
from typing import NamedTuple

from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, parameters_of
from tunefree_hil.bench.batch import Batch
from tunefree_hil.bench.load import held_out_roads_of
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.config.tuning.ensemble_schema import EnsembleSpec
from tunefree_hil.grade.objectives import grades_by_objective
from tunefree_hil.grade.requirements.judgement import measure_violation
from tunefree_hil.grade.score import ScenarioGrade
from tunefree_hil.jobs.identity import data_sha256
from tunefree_hil.jobs.progress import count_data
from tunefree_hil.jobs.run_folder import RunFolder, read_json, write_json
from tunefree_hil.jobs.tune.ensemble.cars import EnsembleCars
from tunefree_hil.jobs.tune.evaluators import grade_of
from tunefree_hil.jobs.tune.margins import JobDriver
from tunefree_hil.tune.ensemble import (
    OTHER_CARS,
    HeldOutScore,
    Judgement,
    combine_ensemble,
    find_near_equal,
    worst_of_cars,
)
from tunefree_hil.tune.journal import Journal, slot_key
from tunefree_hil.tune.pareto import find_reference, measure_trade
from tunefree_hil.tune.trial import Trial

SCHEMA = "tunefree.selected/1"
FILE = "selected.json"
SELECT_SEEDS = 20_000  # the seed of the cars lies so much above that of the search


class HeldOutSet(NamedTuple):
    """Roads and cars that the search did not have. model: the plant that the cars are made from."""

    roads: tuple[ScenarioSpec, ...]
    cars: EnsembleCars
    model: str


def make_held_out_set(bench: Bench, spec: EnsembleSpec) -> HeldOutSet:
    """The held-out roads, and the second plant of the bench file or cars of another seed."""
    model = spec.select_model or bench.spec.model
    cars = EnsembleCars(bench, spec, model, bench.spec.seed + SELECT_SEEDS)
    return HeldOutSet(tuple(held_out_roads_of(bench, spec.select_roads)), cars, model)


def select_on_held_out(
    bench: Bench, run: RunFolder, journal: Journal, ranked: Sequence[Trial], batch: JobDriver | None = None
) -> Generator[Event, None, dict[str, HeldOutScore]]:
    """Drive the near-equal trials on held-out roads.

    The scores are stored in selected.json of the run, and read from there where they belong to the same trials.

    Args:
        bench: The bench of the search.
        run: Run folder of the tune.
        journal: The study.
        ranked: All trials, in their order on the search roads.
        batch: Batch of the model and the effects of the held-out set; None for a new one.

    Returns:
        Held-out scores by `slot_key`; empty where there is nothing to choose.
    """
    spec = bench.spec.ensemble
    near = find_near_equal(ranked)
    if spec is None or not spec.select_roads or len(near) < 2:
        return {}
    key = data_sha256(
        [journal.settings.as_data(), spec.select_roads, spec.select_model, [trial.slot for trial in near]]
    )
    stored = _read_scores(run, key)
    if stored is not None:
        return stored
    held_out = make_held_out_set(bench, spec)
    with ExitStack() as stack:
        driver = batch or stack.enter_context(Batch(bench, held_out.model, extra_effects=held_out.cars.effects))
        scores = yield from _drive_trials(driver, bench, held_out, near, journal)
    data = {name: score._asdict() for name, score in scores.items()}
    write_json(run.path / FILE, {"schema": SCHEMA, "of": key, "model": held_out.model, "scores": data})
    return scores


def selection_text(held_out: Mapping[str, HeldOutScore], spec: EnsembleSpec) -> str:
    """The end of a sentence: 'chosen among 4 near-equal trials on families:10 (held out)'; '' without a choice."""
    if not held_out:
        return ""
    plant = f" and {spec.select_model}" if spec.select_model else ""
    return f"chosen among {len(held_out)} near-equal trials on {spec.select_roads}{plant} (held out)"


def _drive_trials(
    batch: JobDriver, bench: Bench, held_out: HeldOutSet, trials: Sequence[Trial], journal: Journal
) -> Generator[Event, None, dict[str, HeldOutScore]]:
    drives = len(held_out.roads) * len(held_out.cars.cars)
    text = f"{len(trials)} near-equal trials are driven on {len(held_out.roads)} held-out roads, {drives} drives each"
    yield Event("note", f"{text}; plant {held_out.model}")
    scores, started = {}, time.monotonic()
    for done, trial in enumerate(trials, 1):
        name = slot_key(trial.slot)
        scores[name] = _score_held_out(batch, bench, held_out, trial, journal)
        data = count_data("selection, trial", done, len(trials), started)
        noun = "trade" if journal.settings.objectives else "score"
        yield Event("progress", f"{name} has a {noun} of {scores[name].score:.3f} on held-out roads", data)
    return scores


def _score_held_out(
    batch: JobDriver, bench: Bench, held_out: HeldOutSet, trial: Trial, journal: Journal
) -> HeldOutScore:
    """Score, or trade of several objectives, and violation over all held-out drives."""
    assert bench.spec.ensemble is not None
    values = parameters_of(bench, trial.parameters)
    pairs = [(road, car) for road in held_out.roads for car in held_out.cars.cars]
    drives = batch.drive([held_out.cars.job(values, road, car) for road, car in pairs])
    grades = [grade_of(drive, road) for drive, (road, _) in zip(drives, pairs, strict=True)]
    count = len(held_out.cars.cars)
    worst = [worst_of_cars(grades[i * count : (i + 1) * count]) for i in range(len(held_out.roads))]
    by_road = {entry["scenario"].removesuffix(OTHER_CARS): entry for entry in worst}
    judgement = Judgement("tail", 0.01 * bench.spec.ensemble.tail)
    violation = measure_violation(by_road, journal.settings.requirements)
    return HeldOutScore(violation, _measure_merit(bench, grades, judgement, journal))


def _measure_merit(bench: Bench, grades: Sequence[ScenarioGrade], judgement: Judgement, journal: Journal) -> float:
    """The score; in a study of several objectives their trade, against those of the best manual set in the search."""
    names = journal.settings.objectives
    if not names:
        return combine_ensemble(grades, judgement)
    parts = [grades_by_objective(grades, bench.weights, name) for name in names]
    objectives = tuple(combine_ensemble(part, judgement) for part in parts)
    return measure_trade(objectives, find_reference(journal.baselines()))


def _read_scores(run: RunFolder, key: str) -> dict[str, HeldOutScore] | None:
    path = run.path / FILE
    if not path.is_file():
        return None
    data = read_json(path)
    if data.get("of") != key:
        return None
    return {name: HeldOutScore(**score) for name, score in data["scores"].items()}
