"""The search of `tune`: baselines, then slots, whatever evaluates them and wherever the study is kept."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from tunefree_hil.base.errors import BenchError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, parameters_of
from tunefree_hil.jobs.run_folder import RunFolder, drop_bulk
from tunefree_hil.jobs.tune.evaluators import Candidate, Evaluator
from tunefree_hil.tune.compare import best_baseline
from tunefree_hil.tune.journal import Journal
from tunefree_hil.tune.shared.shared_study import SharedStudy
from tunefree_hil.tune.study import Study
from tunefree_hil.tune.trial import Evaluation, Trial
from tunefree_hil.tune.trial_loop import ASKED_AGAIN

Vectors = Mapping[str, dict[str, float]]
Kept = Study | Journal | SharedStudy


class Search:
    """Baselines and trials of one session. `vectors`: the baselines, complete, by name."""

    def __init__(
        self, bench: Bench, run: RunFolder, evaluator: Evaluator, study: Kept, vectors: Vectors, trials: int
    ) -> None:
        self.bench = bench
        self.run = run
        self.evaluator = evaluator
        self.study = study
        self.vectors = vectors
        self.total = trials
        best = study.best()
        self._best_slot = best.slot if best else None
        self._began_s, self._began_with = time.monotonic(), 0

    def baselines(self, order: list[str] | None = None) -> Iterator[Event]:
        """Score the baselines that the study does not have yet, as many at once as the evaluator likes.

        One that the bench failed is driven again. Raises BenchError when that happened three times.
        """
        self._begin(len(self.study.baselines()))
        failed: Counter[str] = Counter()
        while missing := [name for name in order or self.vectors if name not in self.study.baselines()]:
            answers = self._baseline(missing[: self.evaluator.at_once])
            scores = []
            for name, answer in answers.items():
                if isinstance(answer, BenchError):
                    failed[name] += 1
                    if failed[name] > ASKED_AGAIN:
                        raise answer
                    yield Event("warning", f"baseline {name} failed and is driven again: {answer.message}")
                else:
                    yield from self._keep_baseline(name, answer)
                    scores.append(f"{name} scores {answer.score:.3f}")
            if scores:
                done = len(self.study.baselines())
                yield self._progress(", ".join(scores), "baseline", done, len(self.vectors))

    def trials(self) -> Iterator[Event]:
        """Fill the slots that are free; the logs of the best are kept, the others' dropped."""
        self._begin(len(self.study.trials()))
        for told in self.study.run_all(self.total, self._evaluate):
            if isinstance(told, str):
                yield Event("warning", told)
            else:
                yield from self._told(told)

    def _evaluate(self, points: Mapping[int, dict[str, float]]) -> list[Evaluation]:
        first = len(self.vectors)
        return self.evaluator.evaluate(
            [Candidate(first + slot, parameters_of(self.bench, searched)) for slot, searched in points.items()]
        )

    def _baseline(self, names: list[str]) -> dict[str, Evaluation | BenchError]:
        """What became of each: its evaluation, or how the bench failed it."""
        order = list(self.vectors)
        try:
            found = self.evaluator.evaluate([Candidate(order.index(name), self.vectors[name]) for name in names])
        except BenchError as error:
            return dict.fromkeys(names, error)
        return {
            name: BenchError(one.error, code="evaluation_failed") if one.error else one
            for name, one in zip(names, found, strict=True)
        }

    def _keep_baseline(self, name: str, evaluation: Evaluation) -> Iterator[Event]:
        if isinstance(self.study, SharedStudy):
            for words in self.study.keep_baseline(name, self.vectors[name], evaluation):
                yield Event("warning", words)
        else:
            self.study.add_baseline(name, self.vectors[name], evaluation)

    def _told(self, trial: Trial) -> Iterator[Event]:
        if trial.error:
            yield Event("warning", f"trial {trial.slot + 1} failed and is asked again: {trial.error}")
            return
        self._keep_best(trial.slot)
        done = len(self.study.trials())
        size = max(1, self.study.settings.in_flight)
        if (trial.slot + 1) % size == 0 or trial.slot + 1 == self.total:  # a generation is one line
            words = ", ".join(f"{name} {value:.4g}" for name, value in trial.parameters.items())
            yield self._progress(f"{trial.score:.3f} at {words}", "trial", done, self.total)

    def _keep_best(self, slot: int) -> None:
        """Drop the logs of whichever is no longer the best: this slot, or the one that it beat."""
        best = self.study.best()
        if best is None or self.evaluator.over == "batch":
            return
        loser = self._best_slot if best.slot == slot else slot
        self._best_slot = best.slot
        if loser is not None and loser != best.slot:
            for k in episodes_of(len(self.vectors) + loser, len(self.bench.spec.scenarios)):
                drop_bulk(self.run.episode(k))

    def _begin(self, done: int) -> None:
        self._began_s, self._began_with = time.monotonic(), done

    def _progress(self, message: str, label: str, done: int, total: int) -> Event:
        """Time left: the rate of this stage, all workers of a shared study together."""
        each_s = (time.monotonic() - self._began_s) / max(1, done - self._began_with)
        rest = total - done + (self.total - len(self.study.trials()) if label == "baseline" else 0)
        best, manual = self.study.best(), self.study.baselines()
        shown = f"{label} in the batch" if self.evaluator.over == "batch" else label
        data: dict[str, Any] = {"label": shown, "done": done, "total": total, "over": self.evaluator.over}
        if label == "trial" or self.evaluator.over != "batch":  # a batch compiles during its baselines
            data["eta_s"] = each_s * max(0, rest)
        data |= self.evaluator.pace
        if data.get("discarded"):
            message += f"; not real time and driven again so far: {data['discarded']:.0f}"
        if best is not None:
            data["best"] = best.score
        if manual:
            data["manual"] = best_baseline(manual).score
        return Event("progress", message, data)


def episodes_of(group: int, scenarios: int) -> range:
    """Numbers of the episodes of one set of parameters: baselines come first, then the slots."""
    return range(group * scenarios, (group + 1) * scenarios)
