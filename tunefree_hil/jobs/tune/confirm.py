"""Confirmation: the best trials of a batch and its best baseline are driven over the bus, whose scores decide."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, parameters_of
from tunefree_hil.grade.requirements.judgement import measure_violation
from tunefree_hil.jobs.progress import count_data
from tunefree_hil.jobs.tune.evaluators import BusEvaluator, VectorCandidate, with_objectives
from tunefree_hil.jobs.tune.margins import Vectors
from tunefree_hil.jobs.tune.robustness import RobustnessResult
from tunefree_hil.tune.compare import find_best_baseline
from tunefree_hil.tune.ensemble import has_ensemble, nominal_drives, nominal_score, with_drives_over_bus
from tunefree_hil.tune.journal import Journal, slot_key
from tunefree_hil.tune.pareto import with_trades
from tunefree_hil.tune.trial import Baseline, Trial, find_best_trial

MAX_NAMED_DIFFERENCES = 3  # in one line
# The batch has no frames; trials of an earlier version have neither requirements nor oscillation.
OPTIONAL_KEYS = ("frame_hash", "requirements", "oscillation")


class ConfirmedScore(NamedTuple):
    """The score of a candidate in the batch and over the bus. Stored under its field names.

    different: 'scenario: metric' of each grade that is not equal.
    """

    batch: float
    bus: float
    different: tuple[str, ...]

    @property
    def is_equal(self) -> bool:
        """Whether score, metrics, re-plans and outcome of every scenario are equal, bit for bit."""
        return self.batch == self.bus and not self.different

    @property
    def verdict(self) -> str:
        """'equal', or the first differences."""
        if self.is_equal:
            return "equal"
        more = ", ..." if len(self.different) > MAX_NAMED_DIFFERENCES else ""
        return f"DIFFERENT ({', '.join(self.different[:MAX_NAMED_DIFFERENCES]) or 'score'}{more})"


class ConfirmedStudy:
    """The study as confirmed: what was driven over the bus has the scores of the bus, the rest those of the batch."""

    def __init__(self, journal: Journal) -> None:
        self.settings = journal.settings
        self._journal = journal
        self._over_bus = journal.confirmations()

    def trials(self) -> list[Trial]:
        """All trials; the confirmed ones with their scores over the bus."""
        return [self._confirmed(trial) or trial for trial in self._journal.trials()]

    def confirmed_trials(self) -> list[Trial]:
        """The confirmed trials with their scores over the bus."""
        return [confirmed for trial in self._journal.trials() if (confirmed := self._confirmed(trial)) is not None]

    def best(self) -> Trial | None:
        """The best of the confirmed trials (`find_best_trial`) over the bus."""
        return find_best_trial(self.confirmed_trials())

    def baselines(self) -> dict[str, Baseline]:
        """The baselines; the confirmed ones with their scores over the bus."""
        return {
            name: baseline._replace(**self._values_over_bus(name, baseline)) if name in self._over_bus else baseline
            for name, baseline in self._journal.baselines().items()
        }

    def scores(self) -> dict[str, ConfirmedScore]:
        """Scores in the batch and over the bus, by `slot_key` of a trial or name of a baseline."""
        batch: dict[str, Trial | Baseline] = {slot_key(trial.slot): trial for trial in self._journal.trials()}
        batch |= self._journal.baselines()
        return {
            key: ConfirmedScore(
                nominal_score(batch[key].score, batch[key].scenarios),
                bus.score,
                find_differences(nominal_drives(batch[key].scenarios), bus.scenarios),
            )
            for key, bus in self._over_bus.items()
        }

    def _confirmed(self, trial: Trial) -> Trial | None:
        key = slot_key(trial.slot)
        if key not in self._over_bus:
            return None
        confirmed = trial._replace(**self._values_over_bus(key, trial))
        return with_trades([confirmed], self.baselines())[0] if self.settings.objectives else confirmed

    def _values_over_bus(self, key: str, batch: Trial | Baseline) -> dict[str, Any]:
        """Score, objectives, scenarios and violation. Only the batch drives the other cars of an ensemble."""
        bus = self._over_bus[key]
        if has_ensemble(batch.scenarios):
            scenarios = with_drives_over_bus(batch.scenarios, bus.scenarios)
            return {"scenarios": scenarios, "violation": measure_violation(scenarios, self.settings.requirements)}
        violation = measure_violation(bus.scenarios, self.settings.requirements)
        scored = {"score": bus.score, "objectives": bus.objectives}
        return {**scored, "scenarios": bus.scenarios, "violation": violation}


def find_differences(batch: Mapping[str, Any], bus: Mapping[str, Any]) -> tuple[str, ...]:
    """'scenario: key' of all grades that differ; OPTIONAL_KEYS are compared only where both have them."""
    different = []
    for name in {**batch, **bus}:
        drives = batch.get(name, {}), bus.get(name, {})
        skipped = [key for key in OPTIONAL_KEYS if any(key not in drive for drive in drives)]
        first, second = (_flat({key: drive[key] for key in drive if key not in skipped}) for drive in drives)
        keys = [key for key in {**first, **second} if first.get(key, "none") != second.get(key, "none")]
        different += [f"{name}: {key}" for key in keys]
    return tuple(different)


def _flat(drive: Mapping[str, Any]) -> dict[str, Any]:
    """Metrics and requirements beside the other keys."""
    flat = {key: value for key, value in drive.items() if key not in ("metrics", "requirements")}
    required = {f"require {name}": value for name, value in drive.get("requirements", {}).items()}
    return {**flat, **drive.get("metrics", {}), **required}


def find_unconfirmed(journal: Journal, best: int, robustness: RobustnessResult) -> dict[str, Trial | None]:
    """Unconfirmed candidates by key: the first `best` trials of the ranking, and the best baseline (None)."""
    best_trials = robustness.rank_trials(journal.trials())[:best]
    keys: dict[str, Trial | None] = {slot_key(trial.slot): trial for trial in best_trials}
    keys[find_best_baseline(journal.baselines()).name] = None
    return {key: trial for key, trial in keys.items() if key not in journal.confirmations()}


def confirm_over_bus(
    bench: Bench, journal: Journal, evaluator: BusEvaluator, vectors: Vectors, missing: dict[str, Trial | None]
) -> Iterator[Event]:
    """Drive the missing candidates one after the other, and store their evaluations."""
    started, order = time.monotonic(), list(vectors)
    for done, (key, trial) in enumerate(missing.items(), 1):
        if trial is None:
            candidate = VectorCandidate(order.index(key), vectors[key])
        else:
            candidate = VectorCandidate(len(order) + trial.slot, parameters_of(bench, trial.parameters))
        try:
            (evaluation,) = evaluator.evaluate([candidate])
        except BenchError as error:
            yield Event("warning", f"{key} failed over the bus and is driven again: {error.message}")
            (evaluation,) = evaluator.evaluate([candidate])
        journal.store_confirmation(key, with_objectives(evaluation, bench, journal.settings.objectives))
        score = ConfirmedStudy(journal).scores()[key]
        data = count_data("confirm", done, len(missing), started) | evaluator.pace
        message = f"{key}: batch {score.batch:.6f}, bus {score.bus:.6f}, {score.verdict}"
        yield Event("progress" if score.is_equal else "warning", message, data)
