"""The search of `tune`: baselines, then slots, for every evaluator and every kind of study."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from tunefree_hil.base.errors import BenchError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import parameters_of
from tunefree_hil.grade.requirements.limits import CRITERIA
from tunefree_hil.jobs.run_folder import RunFolder, delete_logs
from tunefree_hil.jobs.tune.evaluators import Evaluator, Medium, VectorCandidate, with_objectives
from tunefree_hil.jobs.tune.options import TunePlan
from tunefree_hil.tune.compare import find_best_baseline
from tunefree_hil.tune.journal import Journal
from tunefree_hil.tune.shared.shared_study import SharedStudy
from tunefree_hil.tune.study import Study
from tunefree_hil.tune.trial import Evaluation, Trial
from tunefree_hil.tune.trial_loop import MAX_RETRIES, run_generations

AnyStudy = Study | Journal | SharedStudy


class TrialSearch:
    """Baselines and trials of one session."""

    def __init__(self, plan: TunePlan, run: RunFolder, evaluator: Evaluator, study: AnyStudy) -> None:
        self.bench = plan.bench
        self.vectors = plan.vectors
        self.total = plan.trials
        self.run = run
        self.evaluator = evaluator
        self.study = study
        best = study.best()
        self._best_slot = best.slot if best else None
        self._start_s, self._done_at_start = time.monotonic(), 0

    def score_baselines(self, order: list[str] | None = None) -> Iterator[Event]:
        """Score the missing baselines, up to the batch size of the evaluator in one call.

        A baseline that the bench failed is driven again; after three failures BenchError is raised.

        Args:
            order: Names in the order to score them; None for that of the plan.
        """
        self._start_stage(len(self.study.baselines()))
        failed: Counter[str] = Counter()
        while missing := [name for name in order or self.vectors if name not in self.study.baselines()]:
            outcomes = self._evaluate_baselines(missing[: self.evaluator.batch_size])
            texts = []
            for name, outcome in outcomes.items():
                if isinstance(outcome, BenchError):
                    failed[name] += 1
                    if failed[name] > MAX_RETRIES:
                        raise outcome
                    yield Event("warning", f"baseline {name} failed and is driven again: {outcome.message}")
                else:
                    yield from self._store_baseline(name, outcome)
                    texts.append(f"{name} scores {outcome.score:.3f}")
            if texts:
                done = len(self.study.baselines())
                yield self._progress(", ".join(texts), "baseline", done, len(self.vectors))

    def run_trials(self) -> Iterator[Event]:
        """Fill the free slots; the logs of the best trial are kept, the others are deleted."""
        self._start_stage(len(self.study.trials()))
        if isinstance(self.study, SharedStudy):
            results = self.study.run_trials(self.total, self._evaluate)
        else:
            results = run_generations(self.study, self.total, self._evaluate)
        for result in results:
            if isinstance(result, str):
                yield Event("warning", result)
            else:
                yield from self._report_trial(result)

    def _evaluate(self, points: Mapping[int, dict[str, float]]) -> list[Evaluation]:
        first = len(self.vectors)
        return self._evaluate_candidates(
            [VectorCandidate(first + slot, parameters_of(self.bench, tuned)) for slot, tuned in points.items()]
        )

    def _evaluate_candidates(self, candidates: list[VectorCandidate]) -> list[Evaluation]:
        """The evaluations, with the objectives of the study."""
        objectives = self.study.settings.objectives
        return [with_objectives(one, self.bench, objectives) for one in self.evaluator.evaluate(candidates)]

    def _evaluate_baselines(self, names: list[str]) -> dict[str, Evaluation | BenchError]:
        """The evaluation of each baseline, or the error of the bench."""
        order = list(self.vectors)
        candidates = [VectorCandidate(order.index(name), self.vectors[name]) for name in names]
        try:
            evaluations = self._evaluate_candidates(candidates)
        except BenchError as error:
            return dict.fromkeys(names, error)
        return {
            name: BenchError(evaluation.error, code="evaluation_failed") if evaluation.error else evaluation
            for name, evaluation in zip(names, evaluations, strict=True)
        }

    def _store_baseline(self, name: str, evaluation: Evaluation) -> Iterator[Event]:
        if isinstance(self.study, SharedStudy):
            for message in self.study.store_baseline(name, self.vectors[name], evaluation):
                yield Event("warning", message)
        else:
            self.study.add_baseline(name, self.vectors[name], evaluation)

    def _report_trial(self, trial: Trial) -> Iterator[Event]:
        if trial.error:
            yield Event("warning", f"trial {trial.slot + 1} failed and is repeated: {trial.error}")
            return
        self._delete_old_logs(trial.slot)
        done = len(self.study.trials())
        size = max(1, self.study.settings.in_flight)
        if (trial.slot + 1) % size == 0 or trial.slot + 1 == self.total:  # one line for a generation
            values = ", ".join(f"{name} {value:.4g}" for name, value in trial.parameters.items())
            scored = f"{trial.score:.3f}{_objectives_text(trial, self.study.settings.objectives)}{_beyond_text(trial)}"
            yield self._progress(f"{scored} at {values}", "trial", done, self.total)

    def _delete_old_logs(self, slot: int) -> None:
        """Delete the logs of this slot, or those of the former best trial where this slot is the best now."""
        best = self.study.best()
        if best is None or self.evaluator.medium is Medium.BATCH:
            return
        obsolete_slot = self._best_slot if best.slot == slot else slot
        self._best_slot = best.slot
        if obsolete_slot is not None and obsolete_slot != best.slot:
            for k in episode_numbers(len(self.vectors) + obsolete_slot, len(self.bench.spec.scenarios)):
                delete_logs(self.run.episode(k))

    def _start_stage(self, done: int) -> None:
        self._start_s, self._done_at_start = time.monotonic(), done

    def _progress(self, message: str, label: str, done: int, total: int) -> Event:
        """A progress event; the remaining time follows from the rate of this stage, of all workers together."""
        each_s = (time.monotonic() - self._start_s) / max(1, done - self._done_at_start)
        n_left = total - done + (self.total - len(self.study.trials()) if label == "baseline" else 0)
        best, manual = self.study.best(), self.study.baselines()
        is_batch = self.evaluator.medium is Medium.BATCH
        data: dict[str, Any] = {"label": f"{label} in the batch" if is_batch else label, "done": done, "total": total}
        data["over"] = self.evaluator.medium.value
        if label == "trial" or not is_batch:  # the batch compiles during its baselines
            data["eta_s"] = each_s * max(0, n_left)
        data |= self.evaluator.pace
        if data.get("discarded"):
            message += f"; drives not in real time, repeated so far: {data['discarded']:.0f}"
        if "saved_drives" in data:
            message += f"; {data['drives']:.0f} drives, {data['saved_drives']:.0f} saved by racing"
        if best is not None:
            data["best"] = best.score
            data |= dict(zip(self.study.settings.objectives, best.objectives, strict=True))
            data |= {"violation": best.violation} if best.violation else {}
        if manual:
            data["manual"] = find_best_baseline(manual).score
        return Event("progress", message, data)


def _objectives_text(trial: Trial, objectives: Sequence[str]) -> str:
    """' (tracking 0.283, comfort 0.133)'; '' in a search by the score."""
    parts = [f"{name} {value:.3f}" for name, value in zip(objectives, trial.objectives, strict=True)]
    return f" ({', '.join(parts)})" if parts else ""


def _beyond_text(trial: Trial) -> str:
    """By how much a trial violates the requirements; '' where it meets them."""
    if not trial.violation:
        return ""
    if trial.violation >= CRITERIA.failed_violation:
        return " (a drive failed)"
    return f" (requirements violated by {100.0 * trial.violation:.0f} %)"


def episode_numbers(group: int, scenarios: int) -> range:
    """Episode numbers of one candidate: baselines come first, then the slots."""
    return range(group * scenarios, (group + 1) * scenarios)
