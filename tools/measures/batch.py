"""How long a search in the compiled batch takes: all of it, the drives and their grades alone, and the compiler."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tools.measures._summary import machine, rounded, summary
from tools.measures.parity import parameter_sets
from tunefree_hil.base.kernel_cache import FOLDER_VARIABLE
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Batch, Job
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors, select_first_vector
from tunefree_hil.jobs.tune.evaluators import BatchEvaluator, VectorCandidate
from tunefree_hil.tune.baselines import make_first_trial
from tunefree_hil.tune.journal import open_journal
from tunefree_hil.tune.space import resolve_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.trial import Evaluation
from tunefree_hil.tune.trial_loop import run_generations

VALUE = "seconds to search the complete set in the batch, 800 trials of 7 scenarios with the sampler; compiled before"
CHUNK = 8  # trials asked for together, as in a search


def measure(
    trials: int = 800, runs: int = 1, in_flight: int = 8, bench: str = "bench_configs/mkz_complete.toml"
) -> dict[str, Any]:
    """`runs` searches with study seeds 1, 2, ... on the bench file's model and scenarios, nothing driven over the bus.

    detail: the same number of drives with their grades without a sampler (points of the box), and how long the first
    drive takes with an empty cache of compiled kernels (`compile_s`) and with a full one (`start_s`).
    """
    before, loaded = machine(), load(bench)
    scenarios = [loaded.scenarios[name] for name in loaded.spec.scenarios]
    with _empty_cache():
        compile_s, start_s = _first_drive_s(loaded, scenarios[0]), _first_drive_s(loaded, scenarios[0])
        with Batch(loaded) as batch:
            batch.drive([Job(parameters_of(loaded), scenario) for scenario in scenarios])
            searches = [_search_s(loaded, batch, scenarios, trials, in_flight, seed) for seed in range(1, runs + 1)]
            alone_s = _alone_s(loaded, batch, scenarios, trials)
    drives = trials * len(scenarios)
    detail = {
        "machine": before,
        "trials": trials,
        "scenarios": [scenario.name for scenario in scenarios],
        "drives": drives,
        "drives_and_grades_s": alone_s,
        "drives_and_grades_ms_each": 1e3 * alone_s / drives,
        "compile_s": compile_s,
        "start_s": start_s,
        "best": float(np.min([best for _, best in searches])),
    }
    return summary([seconds for seconds, _ in searches], "s", rounded(detail))


@contextmanager
def _empty_cache() -> Iterator[None]:
    """Compiled kernels go to a folder of their own meanwhile."""
    kept = os.environ.get(FOLDER_VARIABLE)
    with tempfile.TemporaryDirectory() as folder:
        os.environ[FOLDER_VARIABLE] = folder
        try:
            yield
        finally:
            if kept is None:
                del os.environ[FOLDER_VARIABLE]
            else:
                os.environ[FOLDER_VARIABLE] = kept


def _first_drive_s(bench: Bench, scenario: ScenarioSpec) -> float:
    started = time.perf_counter()
    with Batch(bench) as batch:
        batch.drive([Job(parameters_of(bench), scenario)])
        return time.perf_counter() - started


def _search_s(
    bench: Bench, batch: Batch, scenarios: Sequence[ScenarioSpec], trials: int, in_flight: int, seed: int
) -> tuple[float, float]:
    """(seconds, best score) of a search as `tune --backend batch` makes it."""
    asked = bench.spec.tune
    space = resolve_space(asked.set, asked.parameters, file=bench.file)
    first = make_first_trial(space, select_first_vector(compute_baseline_vectors(bench)))
    settings = StudySettings(space, seed, asked.sampler, "measured", first, in_flight)
    evaluator = BatchEvaluator(batch, bench, scenarios, batch_size=in_flight)

    def evaluate(points: Mapping[int, dict[str, float]]) -> list[Evaluation]:
        return evaluator.evaluate([VectorCandidate(slot, parameters_of(bench, one)) for slot, one in points.items()])

    with tempfile.TemporaryDirectory() as folder:
        journal = open_journal(Path(folder) / "trials.jsonl", settings)
        started = time.perf_counter()
        scores = [trial.score for trial in run_generations(journal, trials, evaluate)]
        return time.perf_counter() - started, min(score for score in scores if score is not None)


def _alone_s(bench: Bench, batch: Batch, scenarios: Sequence[ScenarioSpec], trials: int) -> float:
    """Seconds for the drives and grades of as many points of the box."""
    vectors = list(parameter_sets(bench, trials).values())
    started = time.perf_counter()
    for i in range(0, len(vectors), CHUNK):
        batch.drive([Job(values, scenario) for values in vectors[i : i + CHUNK] for scenario in scenarios])
    return time.perf_counter() - started
