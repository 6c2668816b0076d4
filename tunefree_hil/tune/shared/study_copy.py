"""Copies of a study that is stored elsewhere, as study.db: for optuna-dashboard, and for readers of a run's study."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import optuna
from optuna.trial import create_trial

from tunefree_hil.base.errors import InputError
from tunefree_hil.tune import store
from tunefree_hil.tune.optuna_study import BASELINE
from tunefree_hil.tune.sampling import sampler_value_from_score
from tunefree_hil.tune.space import Space
from tunefree_hil.tune.trial import OBJECTIVES, Baseline, Evaluation, ScoredStudy, Trial


def copy_study(path: Path, study: ScoredStudy, attributes: Mapping[str, Any]) -> None:
    """Copy a study to the study file at `path`, as far as the file does not have it yet.

    A file that cannot be read, or has other settings, is replaced.

    Args:
        path: study.db.
        study: The study to copy.
        attributes: Further user attributes of the copy, plain data.
    """
    try:
        file = store.open_study_file(path, study.settings)
    except InputError:
        path.unlink(missing_ok=True)
        file = store.open_study_file(path, study.settings)
    try:
        copied = {frozen.user_attrs["slot"] for frozen in file.study.get_trials(deepcopy=False)}
        file.study.add_trials(
            _frozen_from_trial(trial, study.settings.space) for trial in study.trials() if trial.slot not in copied
        )
        for name, baseline in study.baselines().items():
            file.study.set_user_attr(BASELINE + name, _data_from_baseline(baseline))
        for key, value in attributes.items():
            file.study.set_user_attr(key, value)
    finally:
        store.close_study_file(file)


def _frozen_from_trial(trial: Trial, space: Space) -> optuna.trial.FrozenTrial:
    return create_trial(
        params=dict(trial.parameters),
        distributions={axis.name: axis.stored_distribution() for axis in space.axes},
        value=sampler_value_from_score(trial.score),
        user_attrs={
            "slot": trial.slot,
            **Evaluation(trial.score, trial.scenarios, objectives=trial.objectives).as_data(),
        },
    )


def _data_from_baseline(baseline: Baseline) -> dict[str, Any]:
    data = baseline._asdict()
    if not baseline.objectives:
        del data[OBJECTIVES]
    return data
