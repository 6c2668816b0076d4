"""The slots of a shared study as rows of Optuna's tables, which any worker may begin, complete or fail.

A trial is created as RUNNING with its parameters in one step, because Optuna's queue could give the trial of one worker
to another. It is completed by its id, so the result of a worker whose lease had expired is still used.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any, NamedTuple

import optuna
from optuna.exceptions import UpdateFinishedTrialError
from optuna.storages import RDBStorage
from optuna.trial import FrozenTrial, TrialState, create_trial

from tunefree_hil.tune.optuna_study import StoredTrials
from tunefree_hil.tune.sampling import sampler_value_from_score, suggest_points
from tunefree_hil.tune.trial import Evaluation, Trial
from tunefree_hil.tune.trial_loop import point_from_trial

FINALISATION = "ending"  # user attribute of the study


class Attempt(NamedTuple):
    """An attempt at a slot; `number` is Optuna's. Stored in kept.json under its field names."""

    slot: int
    number: int
    parameters: dict[str, float]


class SharedTrials:
    """Reads and writes the slots of one study in `storage`; `stored` reads trials and baselines."""

    def __init__(self, study: optuna.Study, storage: RDBStorage) -> None:
        self.stored = StoredTrials(study)
        self.settings = self.stored.settings
        self._storage = storage
        self._study_id = storage.get_study_id_from_name(study.study_name)

    def close(self) -> None:
        """Close the connections to the server."""
        self._storage.remove_session()
        self._storage.engine.dispose()

    def begin(self, slot: int, worker: str) -> Attempt:
        """Begin a slot that this worker has leased.

        An unfinished attempt of another worker is stored as failed, and its parameters are tried again.
        """
        for frozen in self._running():
            if frozen.user_attrs.get("slot") == slot:
                self._finish(frozen._trial_id, TrialState.FAIL, {})
        values = self._failed_parameters(slot) or self._suggest(slot)
        attributes = {"slot": slot, "worker": worker}
        trial_id = self._create(TrialState.RUNNING, values, attributes)
        return Attempt(slot, self._storage.get_trial_number_from_id(trial_id), values)

    def fail(self, attempt: Attempt, error: str) -> Trial:
        """Store an attempt as failed."""
        trial_id = self._storage.get_trial_id_from_study_id_trial_number(self._study_id, attempt.number)
        self._finish(trial_id, TrialState.FAIL, {"error": error})
        return self.stored.convert(self._storage.get_trial(trial_id))

    def complete(self, attempt: Attempt, evaluation: Evaluation) -> Trial | None:
        """Store an evaluation, even where its attempt was stored as failed before.

        Returns:
            The trial; None where another worker has filled the slot.
        """
        trial_id = self._find_attempt(attempt)
        done = {trial.slot: trial for trial in self.stored.trials()}.get(attempt.slot)
        if done is not None:  # possibly by this worker, just before the connection was lost
            if trial_id is not None and done.number == attempt.number:
                return done
            if trial_id is not None:
                self._finish(trial_id, TrialState.FAIL, {"error": "filled by another worker"})
            return None
        scored = evaluation.as_data()
        value = sampler_value_from_score(evaluation.score)
        # An attempt that another worker has stored as failed (an expired lease) is replaced by a new trial.
        if trial_id is None or not self._finish(trial_id, TrialState.COMPLETE, scored, value):
            trial_id = self._create(TrialState.COMPLETE, attempt.parameters, {"slot": attempt.slot, **scored}, value)
        return self.stored.convert(self._storage.get_trial(trial_id))

    def read_finalisation(self) -> dict[str, Any]:
        """The parts of the finalisation (finalisation.py) that are stored; empty before all slots are filled."""
        return dict(self.stored.optuna_study.user_attrs.get(FINALISATION, {}))

    def store_finalisation(self, parts: Mapping[str, Any]) -> None:
        """Replace the stored parts of the finalisation."""
        self.stored.optuna_study.set_user_attr(FINALISATION, dict(parts))

    def _running(self) -> list[FrozenTrial]:
        return self.stored.optuna_study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))

    def _find_attempt(self, attempt: Attempt) -> int | None:
        """The id of the attempt; None where a server that was restored from older data does not have it."""
        for frozen in self.stored.optuna_study.get_trials(deepcopy=False):
            if frozen.number == attempt.number and frozen.user_attrs.get("slot") == attempt.slot:
                is_same = {name: frozen.params.get(name) for name in attempt.parameters} == attempt.parameters
                return frozen._trial_id if is_same else None
        return None

    def _create(
        self, state: TrialState, values: Mapping[str, float], attributes: dict[str, Any], value: float | None = None
    ) -> int:
        frozen = create_trial(
            state=state,
            value=value,
            params=dict(values),
            distributions={axis.name: axis.stored_distribution() for axis in self.settings.space.axes},
            user_attrs=attributes,
        )
        frozen.datetime_start = frozen.datetime_start or datetime.now()
        return self._storage.create_new_trial(self._study_id, template_trial=frozen)

    def _finish(
        self, trial_id: int, state: TrialState, attributes: Mapping[str, Any], value: float | None = None
    ) -> bool:
        """End a trial; False where it had ended already."""
        try:
            for key, attribute in attributes.items():
                self._storage.set_trial_user_attr(trial_id, key, attribute)
            return self._storage.set_trial_state_values(trial_id, state, None if value is None else [value])
        except UpdateFinishedTrialError:
            return False

    def _failed_parameters(self, slot: int) -> dict[str, float]:
        """The parameters of the last failed attempt at `slot`; empty without one."""
        names = self.settings.space.names
        for trial in reversed(self.stored.failures()):
            if trial.slot == slot and set(trial.parameters) == set(names):
                return {name: trial.parameters[name] for name in names}
        return {}

    def _suggest(self, slot: int) -> dict[str, float]:
        """Suggest parameters from all finished trials, away from the running ones."""
        settings = self.settings
        if slot < len(settings.given_points):
            return settings.given_points[slot]
        history = [point_from_trial(trial, settings) for trial in self.stored.trials()]
        pending = [frozen.params for frozen in self._running()]
        drawn = suggest_points(
            settings.space,
            history,
            sampler=settings.sampler,
            seed=settings.seed,
            slots=[slot],
            pending=pending,
            kappa_w=settings.kappa_w,
            given=len(settings.given_points),
        )
        return drawn[0]
