"""The slots of a shared study as rows of Optuna's tables: begun, told, told FAIL, whoever does it.

A trial is begun as RUNNING with its parameters in one step (Optuna's own queue would hand one worker's trial to
another), and told by its id, so a worker that was taken for dead can still be heard.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any, NamedTuple

import optuna
from optuna.exceptions import UpdateFinishedTrialError
from optuna.storages import RDBStorage
from optuna.trial import FrozenTrial, TrialState, create_trial

from tunefree_hil.tune.optuna_study import Shelf
from tunefree_hil.tune.sampling import Told, learned_value, suggest_some
from tunefree_hil.tune.trial import Evaluation, Trial

ENDING = "ending"


class Begun(NamedTuple):
    """An attempt at a slot; `number` is Optuna's."""

    slot: int
    number: int
    parameters: dict[str, float]


class Slots(Shelf):
    """Reads and writes the slots of one study in `storage`."""

    def __init__(self, study: optuna.Study, storage: RDBStorage) -> None:
        super().__init__(study)
        self._storage = storage
        self._study_id = storage.get_study_id_from_name(study.study_name)

    def close(self) -> None:
        """Let go of the server."""
        self._storage.remove_session()
        self._storage.engine.dispose()

    def begin(self, slot: int, worker: str) -> Begun:
        """Begin `slot`, which is ours: what another one left of it is told FAIL, and its parameters are tried again."""
        for frozen in self._running():
            if frozen.user_attrs.get("slot") == slot:
                self._finish(frozen._trial_id, TrialState.FAIL, {})
        values = self._failed_before(slot) or self._suggested(slot)
        attributes = {"slot": slot, "worker": worker}
        trial_id = self._add(TrialState.RUNNING, values, attributes)
        return Begun(slot, self._storage.get_trial_number_from_id(trial_id), values)

    def fail(self, begun: Begun, error: str) -> Trial:
        """Tell an attempt FAIL, with what went wrong."""
        trial_id = self._id_of(begun.number)
        self._finish(trial_id, TrialState.FAIL, {"error": error})
        return self._read(self._storage.get_trial(trial_id))

    def settle(self, begun: Begun, evaluation: Evaluation) -> Trial | None:
        """Tell an evaluation, whatever became of its attempt meanwhile; None where another worker filled the slot."""
        trial_id = self._attempt(begun)
        done = {trial.slot: trial for trial in self.trials()}.get(begun.slot)
        if done is not None:  # also by ourselves, just before the server went away
            if trial_id is not None and done.number == begun.number:
                return done
            if trial_id is not None:
                self._finish(trial_id, TrialState.FAIL, {"error": "filled by another worker"})
            return None
        scored = {"score": float(evaluation.score), "scenarios": evaluation.scenarios}
        value = learned_value(evaluation.score)
        if trial_id is None or not self._finish(trial_id, TrialState.COMPLETE, scored, value):  # it was taken for dead
            trial_id = self._add(TrialState.COMPLETE, begun.parameters, {"slot": begun.slot, **scored}, value)
        return self._read(self._storage.get_trial(trial_id))

    def ending(self) -> dict[str, Any]:
        """What was found when all slots were filled (ending.py); empty before."""
        return dict(self._optuna.user_attrs.get(ENDING, {}))

    def keep_ending(self, found: Mapping[str, Any]) -> None:
        """Store that, in the place of what was found before."""
        self._optuna.set_user_attr(ENDING, dict(found))

    def _running(self) -> list[FrozenTrial]:
        return self._optuna.get_trials(deepcopy=False, states=(TrialState.RUNNING,))

    def _attempt(self, begun: Begun) -> int | None:
        """The id of that attempt; None where this study has none: the server came back without what it had."""
        for frozen in self._optuna.get_trials(deepcopy=False):
            if frozen.number == begun.number and frozen.user_attrs.get("slot") == begun.slot:
                same = {name: frozen.params.get(name) for name in begun.parameters} == begun.parameters
                return frozen._trial_id if same else None
        return None

    def _id_of(self, number: int) -> int:
        return self._storage.get_trial_id_from_study_id_trial_number(self._study_id, number)

    def _add(
        self, state: TrialState, values: Mapping[str, float], attributes: dict[str, Any], value: float | None = None
    ) -> int:
        frozen = create_trial(
            state=state,
            value=value,
            params=dict(values),
            distributions={axis.name: axis.stored() for axis in self.settings.space.axes},
            user_attrs=attributes,
        )
        frozen.datetime_start = frozen.datetime_start or datetime.now()
        return self._storage.create_new_trial(self._study_id, template_trial=frozen)

    def _finish(
        self, trial_id: int, state: TrialState, attributes: Mapping[str, Any], value: float | None = None
    ) -> bool:
        """False where the trial had been finished already."""
        try:
            for key, one in attributes.items():
                self._storage.set_trial_user_attr(trial_id, key, one)
            return self._storage.set_trial_state_values(trial_id, state, None if value is None else [value])
        except UpdateFinishedTrialError:
            return False

    def _failed_before(self, slot: int) -> dict[str, float]:
        """The parameters that a failed attempt at `slot` had."""
        names = self.settings.space.names
        for trial in reversed(self.failures()):
            if trial.slot == slot and set(trial.parameters) == set(names):
                return {name: trial.parameters[name] for name in names}
        return {}

    def _suggested(self, slot: int) -> dict[str, float]:
        """Learned from all that is finished, away from what is running."""
        settings = self.settings
        if slot == 0 and settings.first:
            return dict(settings.first)
        history = [Told(trial.parameters, trial.score) for trial in self.trials()]
        pending = [one.params for one in self._running()]
        drawn = suggest_some(
            settings.space, history, sampler=settings.sampler, seed=settings.seed, slots=[slot], pending=pending
        )
        return drawn[0]
