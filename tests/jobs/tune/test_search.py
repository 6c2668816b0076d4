"""Baselines of a tune: driven as many at once as the evaluator likes, again where the bench failed, not for ever."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import cast

import pytest

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import BenchError, PeerGone
from tunefree_hil.base.events import Event
from tunefree_hil.bench import load
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune.candidates import baseline_vectors
from tunefree_hil.jobs.tune.evaluators import Candidate, Evaluator
from tunefree_hil.jobs.tune.search import Search
from tunefree_hil.tune.journal import open_journal
from tunefree_hil.tune.space import resolve
from tunefree_hil.tune.store import Settings
from tunefree_hil.tune.trial import Evaluation
from tunefree_hil.tune.trial_loop import ASKED_AGAIN


class Flaky:
    """Fails the first `times` evaluations of each group in `bad`: raises with one candidate, says so with several."""

    over = "bus"
    pace: dict[str, float] = {}  # noqa: RUF012 - a stand-in

    def __init__(self, at_once: int, bad: Sequence[int], times: int) -> None:
        self.at_once = at_once
        self.left = dict.fromkeys(bad, times)
        self.asked: list[list[int]] = []

    def evaluate(self, candidates: Sequence[Candidate]) -> list[Evaluation]:
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
    settings = Settings(resolve("mrac", [], file=bench.file), 1, "random", "sha256:00", {}, in_flight=2)
    study = open_journal(folder / "trials.jsonl", settings)
    search = Search(bench, RunFolder(folder, {}), cast(Evaluator, flaky), study, baseline_vectors(bench), 4)
    said = list(search.baselines())
    return {name: one.score for name, one in study.baselines().items()}, said


@pytest.mark.parametrize("at_once", [1, 2, 5])
def test_a_baseline_that_the_bench_failed_is_driven_again(at_once: int, tmp_path: Path) -> None:
    flaky = Flaky(at_once, bad=[0, 1], times=ASKED_AGAIN)
    found, said = baselines(tmp_path, flaky)
    assert sorted(found.values()) == pytest.approx([0.1, 1.1, 2.1, 3.1, 4.1])
    warnings = [event.message for event in said if event.kind == "warning"]
    assert len(warnings) == 2 * ASKED_AGAIN and all("is driven again" in one for one in warnings)
    assert all(len(groups) <= at_once for groups in flaky.asked)


@pytest.mark.parametrize("at_once", [1, 2])
def test_a_bench_that_fails_for_good_ends_it(at_once: int, tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="ecu is gone"):
        baselines(tmp_path, Flaky(at_once, bad=[2], times=ASKED_AGAIN + 1))
