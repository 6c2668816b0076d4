"""Regresses weights from pairs, with the strength of the pull to the base weights and the accuracy by held-out groups.

The strength is chosen inside each training part, by the mean loss of groups held out of it, so that the held-out
accuracy has seen neither weights nor strength.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.grade.weight_regression.pairs import PairTable, score_margins
from tunefree_hil.grade.weight_regression.ranking import (
    CRITERIA,
    other_rows,
    ranking_accuracy,
    split_folds,
)
from tunefree_hil.tune.weight_regression.hinge_solver import WeightFit, fit_multipliers, mean_hinge_loss

Array = np.ndarray

STRENGTHS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0)  # half decades; above 1 the base weights hardly move


class StrengthChoice(NamedTuple):
    """The strength with, up to a standard error, the least held-out loss; losses: of each of STRENGTHS."""

    strength: float
    losses: tuple[float, ...]


class HeldOutRanking(NamedTuple):
    """Score margins of every pair by weights that were made without its group, shape (n_pairs,); rows of the folds."""

    margins: Array
    folds: list[Array]


class Regression(NamedTuple):
    """Weights from all pairs, and what they are worth.

    Attributes:
        fit: The multipliers.
        choice: The strength and how it was chosen.
        held_out: Margins by held-out weights.
        permuted: Held-out accuracy of each run with permuted labels.
    """

    fit: WeightFit
    choice: StrengthChoice
    held_out: HeldOutRanking
    permuted: tuple[float, ...]


class RegressionStep(NamedTuple):
    """A step of the regression that is done, of `total`."""

    done: int
    total: int


def regress(
    table: PairTable, groups: Sequence[str], margin: float, seed: int
) -> Generator[RegressionStep, None, Regression]:
    """Regress weights and evaluate them; yields a step for each run.

    Args:
        groups: Group of each pair; at least CRITERIA.min_groups different ones.
        margin: eps of eq. 10.
        seed: Of the folds and the permutations.
    """
    total = 2 + CRITERIA.n_permutations
    choice = choose_strength(table, groups, margin, seed)
    fit = fit_multipliers(table, margin, choice.strength)
    yield RegressionStep(1, total)
    held_out = rank_held_out(table, groups, margin, seed)
    yield RegressionStep(2, total)
    permuted = []
    for run in range(CRITERIA.n_permutations):
        chance = np.random.default_rng([seed, run])
        swapped = table.swap(chance.random(table.n_pairs) < 0.5)
        ranking = rank_held_out(swapped, groups, margin, seed, strength=choice.strength)
        permuted.append(ranking_accuracy(ranking.margins))
        yield RegressionStep(3 + run, total)
    return Regression(fit, choice, held_out, tuple(permuted))


def choose_strength(table: PairTable, groups: Sequence[str], margin: float, seed: int) -> StrengthChoice:
    """The largest strength whose held-out loss is within one standard error of the least (one-standard-error rule).

    Breiman et al., Classification and Regression Trees (1984), 3.4.3.
    """
    folds = split_folds(groups, CRITERIA.n_folds, seed)
    losses = np.empty((len(STRENGTHS), len(folds)))
    for column, fold in enumerate(folds):
        rest = table.select(other_rows(fold, table.n_pairs))
        for row, strength in enumerate(STRENGTHS):
            fit = fit_multipliers(rest, margin, strength)
            losses[row, column] = mean_hinge_loss(table.select(fold), margin, fit.multipliers)
    means = losses.mean(axis=1)
    best = int(np.argmin(means))
    error = losses[best].std(ddof=1) / np.sqrt(len(folds)) if len(folds) > 1 else 0.0
    chosen = int(np.flatnonzero(means <= means[best] + error)[-1])
    return StrengthChoice(STRENGTHS[chosen], tuple(float(mean) for mean in means))


def rank_held_out(
    table: PairTable, groups: Sequence[str], margin: float, seed: int, *, strength: float | None = None
) -> HeldOutRanking:
    """Rank every pair by weights that were made without its group. strength: None to choose it in each fold."""
    folds = split_folds(groups, CRITERIA.n_folds, seed)
    margins = np.full(table.n_pairs, np.nan)
    for fold in folds:
        rows = other_rows(fold, table.n_pairs)
        rest, rest_groups = table.select(rows), [groups[int(row)] for row in rows]
        used = strength or choose_strength(rest, rest_groups, margin, seed).strength
        fit = fit_multipliers(rest, margin, used)
        margins[fold] = score_margins(table.select(fold), fit.multipliers)
    return HeldOutRanking(margins, folds)
