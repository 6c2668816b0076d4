"""How well weights rank pairs that they were not made from: folds by group, accuracy, permuted labels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.grade.weight_regression.pairs import DrivePair

Array = np.ndarray


class WeightRegressionCriteria(NamedTuple):
    """What a regression of weights needs and when its result may be used."""

    margin: float = 0.05  # eps of eq. 10 in units of the score; typical sets of gains differ by 0.1 and more
    n_folds: int = 5  # of the held-out evaluation; fewer where there are fewer groups
    min_groups: int = 3  # a group is held out and the strength is chosen on others: two would leave one
    min_accuracy: float = 0.65  # held-out share ranked right below which the pairs do not determine weights
    n_permutations: int = 20  # runs with permuted labels; their mean is the control
    n_named: int = 5  # pairs with the largest unmet margin that a refusal names


CRITERIA = WeightRegressionCriteria()
RESAMPLES = 2000  # of the groups, for an interval


class AccuracyInterval(NamedTuple):
    """A share with its 95 % interval, by drawing groups with replacement: pairs of a group are alike."""

    share: float
    low: float
    high: float
    n: int


def ranking_accuracy(margins: Array) -> float:
    """Share of the pairs whose human drive has the lower score; a tie counts half. NaN for none."""
    if len(margins) == 0:
        return math.nan
    return float(np.mean(margins > 0.0) + 0.5 * np.mean(margins == 0.0))


def accuracy_interval(margins: Array, groups: Sequence[str], seed: int) -> AccuracyInterval:
    """The accuracy with its interval (cluster bootstrap). Pairs with a margin of NaN are left out."""
    known = np.isfinite(margins)
    by_group: dict[str, list[float]] = {}
    for group, margin, is_known in zip(groups, margins, known, strict=True):
        if is_known:
            by_group.setdefault(group, []).append(1.0 if margin > 0.0 else 0.5 if margin == 0.0 else 0.0)
    if not by_group:
        return AccuracyInterval(math.nan, math.nan, math.nan, 0)
    right = np.array([sum(values) for values in by_group.values()])
    counts = np.array([len(values) for values in by_group.values()])
    drawn = np.random.default_rng([seed, len(counts)]).integers(len(counts), size=(RESAMPLES, len(counts)))
    low, high = np.percentile(right[drawn].sum(axis=1) / counts[drawn].sum(axis=1), [2.5, 97.5])
    return AccuracyInterval(float(right.sum() / counts.sum()), float(low), float(high), int(counts.sum()))


def split_folds(groups: Sequence[str], n_folds: int, seed: int) -> list[Array]:
    """Rows of each fold: whole groups, dealt to the smallest fold in a drawn order.

    Args:
        groups: Group of each pair.
        n_folds: Wanted number; at most one a group.
        seed: Of the order.

    Returns:
        Row numbers of each fold, ascending; every row is in one fold.
    """
    names = sorted(set(groups))
    order = np.random.default_rng([seed, len(names)]).permutation(len(names))
    sizes = {name: sum(group == name for group in groups) for name in names}
    folds: list[list[str]] = [[] for _ in range(min(n_folds, len(names)))]
    for number in order:
        smallest = min(folds, key=lambda fold: sum(sizes[name] for name in fold))
        smallest.append(names[number])
    return [np.array([row for row, group in enumerate(groups) if group in fold], dtype=int) for fold in folds]


def other_rows(fold: Array, n_rows: int) -> Array:
    """The rows that are not in a fold."""
    return np.setdiff1d(np.arange(n_rows), fold)


def margins_of_other_weights(pairs: Sequence[DrivePair], name: str) -> Array:
    """Score margins by other weights, NaN for a pair that they cannot grade."""
    return np.array([_margin(pair.human.other_scores, pair.generated.other_scores, name) for pair in pairs])


def _margin(human: Mapping[str, float], generated: Mapping[str, float], name: str) -> float:
    return generated.get(name, math.nan) - human.get(name, math.nan)
