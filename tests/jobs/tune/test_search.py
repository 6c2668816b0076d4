"""Baselines of a tune: up to the batch size of the evaluator in one call, repeated where the bench failed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import BenchError, PeerGone
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors
from tunefree_hil.jobs.tune.evaluators import Evaluator, Medium, VectorCandidate
from tunefree_hil.jobs.tune.options import TunePlan
from tunefree_hil.jobs.tune.search import TrialSearch
from tunefree_hil.tune.journal import open_journal
from tunefree_hil.tune.space import resolve_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.trial import Evaluation
from tunefree_hil.tune.trial_loop import MAX_RETRIES


class Flaky:
    """Fails the first `times` evaluations of each group in `bad`: raises with one candidate, says so with several."""

    medium = Medium.BUS
    pace: dict[str, float] = {}  # noqa: RUF012 - a stand-in

    def __init__(self, batch_size: int, bad: Sequence[int], times: int) -> None:
        self.batch_size = batch_size
        self.left = dict.fromkeys(bad, times)
        self.asked: list[list[int]] = []

    def evaluate(self, candidates: Sequence[VectorCandidate]) -> list[Evaluation]:
        self.asked.append([one.group for one in candidates])
        return [self._one(one.group, len(candidates) == 1) for one in candidates]

    def _one(self, group: int, alone: bool) -> Evaluation:
        if self.left.get(group, 0):
            self.left[group] -= 1
            if alone:
                raise PeerGone("ecu")
            return Evaluation(0.0, {}, error="node_lost: the ecu is gone")
        return Evaluation(0.1 + group, {"tiny": {"outcome": "finished", "replans": 0}})


def baselines(folder: Path, flaky: Flaky) -> tuple[dict[str, float], list[Event]]:
    """(score by baseline, what was said)."""
    bench = load(write_bench(folder))
    settings = StudySettings(resolve_space("mrac", [], file=bench.file), 1, "random", "sha256:00", {}, in_flight=2)
    study = open_journal(folder / "trials.jsonl", settings)
    plan = cast(TunePlan, SimpleNamespace(bench=bench, vectors=compute_baseline_vectors(bench), trials=4))
    search = TrialSearch(plan, RunFolder(folder, {}), cast(Evaluator, flaky), study)
    said = list(search.score_baselines())
    return {name: one.score for name, one in study.baselines().items()}, said


@pytest.mark.parametrize("batch_size", [1, 2, 5])
def test_a_baseline_that_the_bench_failed_is_driven_again(batch_size: int, tmp_path: Path) -> None:
    flaky = Flaky(batch_size, bad=[0, 1], times=MAX_RETRIES)
    found, said = baselines(tmp_path, flaky)
    assert sorted(found.values()) == pytest.approx([0.1, 1.1, 2.1, 3.1, 4.1])
    warnings = [event.message for event in said if event.kind == "warning"]
    assert len(warnings) == 2 * MAX_RETRIES and all("is driven again" in one for one in warnings)
    assert all(len(groups) <= batch_size for groups in flaky.asked)


@pytest.mark.parametrize("batch_size", [1, 2])
def test_a_bench_that_fails_for_good_ends_it(batch_size: int, tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="ecu is gone"):
        baselines(tmp_path, Flaky(batch_size, bad=[2], times=MAX_RETRIES + 1))
