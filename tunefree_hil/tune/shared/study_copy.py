"""Copies of a study that is kept elsewhere: a study.db for optuna-dashboard, and for what reads a run's study."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import optuna
from optuna.trial import create_trial

from tunefree_hil.base.errors import InputError
from tunefree_hil.tune import store
from tunefree_hil.tune.optuna_study import BASELINE
from tunefree_hil.tune.sampling import learned_value
from tunefree_hil.tune.space import Space
from tunefree_hil.tune.trial import Scored, Trial


def mirror(path: Path, study: Scored, more: Mapping[str, Any]) -> None:
    """Copy to the study file at `path` what it does not hold yet. One that cannot be read, or of others, is made anew.

    more: further attributes of the study, plain data.
    """
    try:
        file = store.open_file(path, study.settings)
    except InputError:
        path.unlink(missing_ok=True)
        file = store.open_file(path, study.settings)
    try:
        held = {frozen.user_attrs["slot"] for frozen in file.study.get_trials(deepcopy=False)}
        file.study.add_trials(
            _frozen(trial, study.settings.space) for trial in study.trials() if trial.slot not in held
        )
        for name, baseline in study.baselines().items():
            file.study.set_user_attr(BASELINE + name, baseline._asdict())
        for key, value in more.items():
            file.study.set_user_attr(key, value)
    finally:
        store.close_file(file)


def _frozen(trial: Trial, space: Space) -> optuna.trial.FrozenTrial:
    return create_trial(
        params=dict(trial.parameters),
        distributions={axis.name: axis.stored() for axis in space.axes},
        value=learned_value(trial.score),
        user_attrs={"slot": trial.slot, "score": trial.score, "scenarios": trial.scenarios},
    )
