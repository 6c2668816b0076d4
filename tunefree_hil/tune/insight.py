"""What the trials of a study say about its parameters: importance, edges of the box, and where to cut slices."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import optuna
from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances

from tunefree_hil.tune.sampling import learned_value
from tunefree_hil.tune.space import Axis, Space
from tunefree_hil.tune.study import Trial

FEWEST = 20  # trials below which an importance would be chance
EDGE_SHARE = 0.02  # of the range, in the scale of the search


class Importance(NamedTuple):
    """share: of all parameters together 1, by PED-ANOVA, None below FEWEST trials. rank: Spearman's correlation of the
    value with the score, over all n trials, positive: a larger value scores worse."""

    share: float | None
    rank: float
    n: int


def importance(space: Space, trials: Sequence[Trial]) -> dict[str, Importance]:
    """How much each parameter matters, largest share first.

    PED-ANOVA (Watanabe, Bansal, Hutter 2023; Optuna's) asks how the best tenth of the trials differ from all in each
    parameter alone. The rank correlation is a second opinion that also has a sign.
    """
    shares = _shares(space, trials) if len(trials) >= FEWEST else {}
    scores = np.array([trial.score for trial in trials])
    found = {
        axis.name: Importance(
            shares.get(axis.name),
            rank_correlation(np.array([trial.parameters[axis.name] for trial in trials]), scores),
            len(trials),
        )
        for axis in space.axes
    }
    order = sorted(found, key=lambda name: -(found[name].share or 0.0) if shares else -abs(found[name].rank))
    return {name: found[name] for name in order}


def _shares(space: Space, trials: Sequence[Trial]) -> dict[str, float]:
    """PED-ANOVA's importances on the scores as the sampler learns them."""
    storage = optuna.storages.InMemoryStorage()
    directions = [optuna.study.StudyDirection.MINIMIZE]
    study_id = storage.create_new_study(directions, "importance")
    stored = {axis.name: axis.stored() for axis in space.axes}
    for trial in trials:
        frozen = optuna.trial.create_trial(
            params={name: trial.parameters[name] for name in space.names},
            distributions=stored,
            value=learned_value(trial.score),
        )
        storage.create_new_trial(study_id, template_trial=frozen)
    study = optuna.Study("importance", storage)
    found = get_param_importances(study, evaluator=PedAnovaImportanceEvaluator())
    return {name: float(value) for name, value in found.items() if math.isfinite(value)}


def rank_correlation(values: np.ndarray, scores: np.ndarray) -> float:
    """Spearman's correlation, -1 to 1; 0 where either does not vary."""
    if len(values) < 2 or np.ptp(values) == 0.0 or np.ptp(scores) == 0.0:
        return 0.0
    return float(np.corrcoef(_ranks(values), _ranks(scores))[0, 1])


def _ranks(values: np.ndarray) -> np.ndarray:
    """Ranks, those of equals averaged."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    return (ends - 0.5 * (counts - 1))[inverse]


def edge_of(axis: Axis, value: float) -> str:
    """'lower', 'upper', or '' for a value that is not within 2 % of the range of an edge of its box."""
    if axis.choices:
        return ""
    scale = math.log if axis.log else float
    low, high, at = scale(axis.low), scale(axis.high), scale(value)
    share = (at - low) / (high - low)
    if share <= EDGE_SHARE:
        return "lower"
    return "upper" if share >= 1.0 - EDGE_SHARE else ""


def edges(space: Space, values: Mapping[str, float]) -> list[str]:
    """A sentence for each value on an edge of its box."""
    found = []
    for axis in space.axes:
        edge = edge_of(axis, values[axis.name])
        if edge:
            found.append(f"{axis.name} sits on the {edge} edge of its box ({axis.low:g} to {axis.high:g}): widen it")
    return found


def slice_points(axis: Axis, points: int) -> list[float]:
    """Values across the box of one parameter, both edges in: `points` of them, or the stepped ones where they are less.

    Raises ValueError below 2 points.
    """
    if points < 2:
        raise ValueError("a slice has two points or more")
    if axis.grid:
        places = np.unique(np.round(np.linspace(0, len(axis.grid) - 1, points)).astype(int))
        return [axis.grid[i] for i in places.tolist()]
    ends = (math.log(axis.low), math.log(axis.high)) if axis.log else (axis.low, axis.high)
    raw = np.linspace(*ends, points).tolist()
    return [axis.fit(math.exp(value) if axis.log else value) for value in raw]
