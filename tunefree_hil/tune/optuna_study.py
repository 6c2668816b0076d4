"""Filled slots, failed attempts and baselines, read from and written to an Optuna study."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import optuna
from optuna.trial import FrozenTrial, TrialState

from tunefree_hil.grade.requirements.judgement import measure_violation
from tunefree_hil.tune import store
from tunefree_hil.tune.pareto import with_trades
from tunefree_hil.tune.sampling import sampler_value_from_score
from tunefree_hil.tune.trial import INTERRUPTED, OBJECTIVES, Baseline, Evaluation, Trial, check_evaluation

BASELINE = "baseline "  # prefix of the key of a user attribute of the study


class StoredTrials:
    """Reads and writes the trials of one Optuna study.

    The user attributes of a trial are `slot`, `worker` (shared studies), `score`, `scenarios`, `objectives` (where
    there are several) and `error`. Its value is the logarithm of the score in any case, so that studies of one and of
    several objectives have one form; the search takes the objectives from the attributes.
    """

    def __init__(self, optuna_study: optuna.Study) -> None:
        self.optuna_study = optuna_study
        self.settings: store.StudySettings = store.read_settings(optuna_study)
        self.versions = store.read_versions(optuna_study)
        self.distributions = {axis.name: axis.stored_distribution() for axis in self.settings.space.axes}

    def trials(self) -> list[Trial]:
        """The filled slots, in slot order."""
        by_slot: dict[int, Trial] = {}
        for frozen in self.optuna_study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)):
            trial = self.convert(frozen)
            by_slot.setdefault(trial.slot, trial)
        return self._with_trades([by_slot[slot] for slot in sorted(by_slot)])

    def failures(self) -> list[Trial]:
        """The failed attempts in order of time; the error of one that was cut off is "interrupted"."""
        frozen_trials = self.optuna_study.get_trials(deepcopy=False, states=(TrialState.FAIL,))
        return [self.convert(frozen) for frozen in frozen_trials]

    def add_baseline(self, name: str, parameters: Mapping[str, float], evaluation: Evaluation) -> None:
        """Store the score of a baseline with the study. It is not a trial: the sampler does not learn from it."""
        check_evaluation(evaluation, f"baseline {name}")
        self.optuna_study.set_user_attr(BASELINE + name, {"parameters": dict(parameters), **evaluation.as_data()})

    def baselines(self) -> dict[str, Baseline]:
        """The stored baselines by name."""
        attributes = self.optuna_study.user_attrs.items()
        return {
            key.removeprefix(BASELINE): self._baseline(data) for key, data in attributes if key.startswith(BASELINE)
        }

    def ask(self, slot: int, parameters: Mapping[str, float]) -> optuna.Trial:
        """Begin a trial with these parameters; it is stored as running."""
        self.optuna_study.enqueue_trial(dict(parameters), user_attrs={"slot": slot})
        return self.optuna_study.ask(self.distributions)

    def tell(self, running: optuna.Trial, evaluation: Evaluation) -> Trial:
        """Complete a running trial with its score."""
        for key, value in evaluation.as_data().items():
            running.set_user_attr(key, value)
        (trial,) = self._with_trades(
            [self.convert(self.optuna_study.tell(running, sampler_value_from_score(evaluation.score)))]
        )
        return trial

    def tell_failed(self, running: optuna.Trial, error: str) -> Trial:
        """End a running trial as failed."""
        running.set_user_attr("error", error)
        return self.convert(self.optuna_study.tell(running, state=TrialState.FAIL))

    def fail_unfinished(self) -> None:
        """End the trials that a stopped process left waiting or running; without `error` they are "interrupted"."""
        while self.optuna_study.get_trials(deepcopy=False, states=(TrialState.WAITING,)):
            self.optuna_study.ask()  # starts the waiting trial: only a running one can be ended
        for frozen in self.optuna_study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
            self.optuna_study.tell(frozen.number, state=TrialState.FAIL)

    def convert(self, frozen: FrozenTrial) -> Trial:
        """Convert a trial of Optuna. Parameters may be missing where the process was killed during `ask`."""
        attributes = frozen.user_attrs
        is_failed = frozen.state == TrialState.FAIL
        return Trial(
            slot=attributes["slot"],
            number=frozen.number,
            parameters={name: frozen.params[name] for name in self.distributions if name in frozen.params},
            score=math.nan if is_failed else attributes["score"],
            scenarios=attributes.get("scenarios", {}),
            error=attributes.get("error", INTERRUPTED) if is_failed else "",
            violation=self._violation(attributes.get("scenarios", {})),
            objectives=tuple(attributes.get(OBJECTIVES, ())),
        )

    def _with_trades(self, trials: list[Trial]) -> list[Trial]:
        return with_trades(trials, self.baselines()) if self.settings.objectives else trials

    def _baseline(self, data: Mapping[str, Any]) -> Baseline:
        scenarios = data["scenarios"]
        objectives = tuple(data.get(OBJECTIVES, ()))
        return Baseline(data["parameters"], data["score"], scenarios, self._violation(scenarios), objectives)

    def _violation(self, scenarios: Mapping[str, Any]) -> float:
        return measure_violation(scenarios, self.settings.requirements)
