"""Analysis of the parameters of a study: importance, values on an edge of the range, points of slices."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np
import optuna
from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances

from tunefree_hil.tune.sampling import sampler_value_from_score
from tunefree_hil.tune.space import Axis, Space
from tunefree_hil.tune.study import Trial

MIN_TRIALS = 20  # with fewer trials an importance is random
BEST_SHARE = 0.1  # of the trials, which are compared with all
LARGEST_SWITCH = 2  # values without an order that have a trend all the same
EDGE_SHARE = 0.02  # of the range, in the scale of the search


class Importance(NamedTuple):
    """Importance of one parameter, over n trials. Stored under its field names.

    share: By PED-ANOVA; 1 in sum over the parameters, None below MIN_TRIALS trials or where no score is worse than
        those of the best tenth.
    rank: Spearman's correlation of value and score; positive where a larger value scores worse, 0 for three or more
        values without an order.
    """

    share: float | None
    rank: float
    n: int


class Edge(StrEnum):
    """The edge of its range that a value lies on."""

    NONE = ""
    LOWER = "lower"
    UPPER = "upper"


def compute_importance(space: Space, trials: Sequence[Trial]) -> dict[str, Importance]:
    """Compute the importance of each parameter, the largest share first.

    PED-ANOVA (Watanabe, Bansal, Hutter 2023; Optuna's) compares the best tenth of the trials with all trials, for each
    parameter alone. The rank correlation has also a sign.
    """
    scores = np.array([trial.score for trial in trials])
    columns = {name: np.array([trial.parameters[name] for trial in trials]) for name in space.names}
    shares = _shares(space, trials) if len(trials) >= MIN_TRIALS and _has_best_tenth(scores) else {}
    ranks = {
        axis.name: 0.0
        if axis.choices and len(axis.grid) > LARGEST_SWITCH
        else rank_correlation(columns[axis.name], scores)
        for axis in space.axes
    }
    importances = {name: Importance(shares.get(name), ranks[name], len(trials)) for name in space.names}
    order = sorted(
        importances, key=lambda name: -(importances[name].share or 0.0) if shares else -abs(importances[name].rank)
    )
    return {name: importances[name] for name in order}


def _has_best_tenth(scores: np.ndarray) -> bool:
    """Whether any score is worse than those of the best tenth; else it says nothing about the parameters."""
    return bool(np.sort(scores)[max(2, math.ceil(BEST_SHARE * len(scores))) - 1] < np.max(scores))


def _shares(space: Space, trials: Sequence[Trial]) -> dict[str, float]:
    """The importances by PED-ANOVA, from logarithms of the scores, as the sampler gets them."""
    varied = [name for name in space.names if len({trial.parameters[name] for trial in trials}) > 1]
    if not varied:
        return {}
    storage = optuna.storages.InMemoryStorage()
    directions = [optuna.study.StudyDirection.MINIMIZE]
    study_id = storage.create_new_study(directions, "importance")
    distributions = {axis.name: axis.stored_distribution() for axis in space.axes}
    for trial in trials:
        frozen = optuna.trial.create_trial(
            params={name: trial.parameters[name] for name in space.names},
            distributions=distributions,
            value=sampler_value_from_score(trial.score),
        )
        storage.create_new_trial(study_id, template_trial=frozen)
    study = optuna.Study("importance", storage)
    evaluator = PedAnovaImportanceEvaluator(target_quantile=BEST_SHARE)
    shares = get_param_importances(study, evaluator=evaluator, params=varied)
    if not all(math.isfinite(share) for share in shares.values()):
        return {}
    return {name: float(shares.get(name, 0.0)) for name in space.names}


def rank_correlation(values: np.ndarray, scores: np.ndarray) -> float:
    """Spearman's correlation, -1 to 1; 0 where values or scores are constant."""
    if len(values) < 2 or np.ptp(values) == 0.0 or np.ptp(scores) == 0.0:
        return 0.0
    return float(np.corrcoef(_ranks(values), _ranks(scores))[0, 1])


def _ranks(values: np.ndarray) -> np.ndarray:
    """Ranks; equal values get their mean rank."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    return (ends - 0.5 * (counts - 1))[inverse]


def find_edge(axis: Axis, value: float) -> Edge:
    """The edge of the range within 2 % of which a value lies; values without an order have no edge."""
    if axis.choices:
        return Edge.NONE
    scale = math.log if axis.log else float
    low, high, position = scale(axis.low), scale(axis.high), scale(value)
    share = (position - low) / (high - low)
    if share <= EDGE_SHARE:
        return Edge.LOWER
    return Edge.UPPER if share >= 1.0 - EDGE_SHARE else Edge.NONE


def describe_edges(space: Space, values: Mapping[str, float]) -> list[str]:
    """A sentence for each value on an edge of its range."""
    sentences = []
    for axis in space.axes:
        edge = find_edge(axis, values[axis.name])
        if edge is not Edge.NONE:
            sentences.append(
                f"{axis.name} is at the {edge} edge of its range ({axis.low:g} to {axis.high:g}): widen the range"
            )
    return sentences


def choose_slice_points(axis: Axis, points: int) -> list[float]:
    """Values across the range of one parameter, both edges included.

    Args:
        axis: The parameter.
        points: How many values, 2 or more (ValueError); fewer where the grid of the parameter has fewer.
    """
    if points < 2:
        raise ValueError("a slice has two points or more")
    if axis.grid:
        indices = np.unique(np.round(np.linspace(0, len(axis.grid) - 1, points)).astype(int))
        return [axis.grid[i] for i in indices.tolist()]
    ends = (math.log(axis.low), math.log(axis.high)) if axis.log else (axis.low, axis.high)
    raw = np.linspace(*ends, points).tolist()
    return [axis.clip(math.exp(value) if axis.log else value) for value in raw]
