"""A study kept in an Optuna storage, read as ours: slots, failures, baselines."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import optuna
from optuna.trial import FrozenTrial, TrialState

from tunefree_hil.tune import store
from tunefree_hil.tune.sampling import learned_value
from tunefree_hil.tune.trial import CUT_OFF, Baseline, Evaluation, Trial, check, lowest

BASELINE = "baseline "


class Shelf:
    """Reads and writes the trials of one Optuna study."""

    def __init__(self, study: optuna.Study) -> None:
        self.settings: store.Settings = store.stored_settings(study)
        self.versions = store.versions_of(study)
        self._optuna = study
        self._stored = {axis.name: axis.stored() for axis in self.settings.space.axes}

    def trials(self) -> list[Trial]:
        """The filled slots, in slot order."""
        found: dict[int, Trial] = {}
        for frozen in self._optuna.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)):
            trial = self._read(frozen)
            found.setdefault(trial.slot, trial)
        return [found[slot] for slot in sorted(found)]

    def failures(self) -> list[Trial]:
        """The attempts that failed, in the order in which they were made; error "interrupted" for those cut off."""
        return [self._read(frozen) for frozen in self._optuna.get_trials(deepcopy=False, states=(TrialState.FAIL,))]

    def best(self) -> Trial | None:
        """The trial of the lowest score, the earliest of equals; None before the first."""
        return lowest(self.trials())

    def add_baseline(self, name: str, parameters: Mapping[str, float], evaluation: Evaluation) -> None:
        """Store a baseline's score with the study. It is no trial: the sampler does not learn from it."""
        check(evaluation, f"baseline {name}")
        data = {"parameters": dict(parameters), "score": evaluation.score, "scenarios": evaluation.scenarios}
        self._optuna.set_user_attr(BASELINE + name, data)

    def baselines(self) -> dict[str, Baseline]:
        """The stored baselines by name."""
        attributes = self._optuna.user_attrs.items()
        return {key.removeprefix(BASELINE): Baseline(**data) for key, data in attributes if key.startswith(BASELINE)}

    def _ask(self, slot: int, parameters: Mapping[str, float], **more: Any) -> optuna.Trial:
        self._optuna.enqueue_trial(dict(parameters), user_attrs={"slot": slot, **more})
        return self._optuna.ask(self._stored)

    def _tell(self, asked: optuna.Trial, answer: Evaluation) -> Trial:
        asked.set_user_attr("score", float(answer.score))
        asked.set_user_attr("scenarios", answer.scenarios)
        return self._read(self._optuna.tell(asked, learned_value(answer.score)))

    def _tell_failed(self, asked: optuna.Trial, error: str) -> Trial:
        asked.set_user_attr("error", error)
        return self._read(self._optuna.tell(asked, state=TrialState.FAIL))

    def _read(self, frozen: FrozenTrial) -> Trial:
        """Optuna's trial as ours. One that was killed while it was asked may lack parameters."""
        attributes = frozen.user_attrs
        failed = frozen.state == TrialState.FAIL
        return Trial(
            slot=attributes["slot"],
            number=frozen.number,
            parameters={name: frozen.params[name] for name in self._stored if name in frozen.params},
            score=math.nan if failed else attributes["score"],
            scenarios=attributes.get("scenarios", {}),
            error=attributes.get("error", CUT_OFF) if failed else "",
        )
