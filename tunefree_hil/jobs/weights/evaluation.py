"""Evaluates a regression of weights: accuracies by kind of human, beside other weights, and reasons to refuse it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.grade.weight_regression.pairs import (
    DrivePair,
    PairTable,
    find_reversed_pairs,
    score_margins,
)
from tunefree_hil.grade.weight_regression.ranking import (
    CRITERIA,
    AccuracyInterval,
    accuracy_interval,
    margins_of_other_weights,
    ranking_accuracy,
)
from tunefree_hil.jobs.identity import data_sha256
from tunefree_hil.tune.weight_regression.cross_validation import Regression

Array = np.ndarray

REGRESSED = "regressed"
DIGITS = 4  # significant figures of a weight


class RefusalReason(StrEnum):
    """Why weights should not be used."""

    FEW_PAIRS = "few_pairs"
    CONTRADICTION = "contradicting_pairs"
    CHANCE = "not_better_than_chance"


class RankedPairs(NamedTuple):
    """Pairs that the weights decide, their table, and how many of all pairs that are."""

    pairs: list[DrivePair]
    table: PairTable
    n_all: int

    @property
    def groups(self) -> list[str]:
        """Group of each pair."""
        return [pair.group for pair in self.pairs]


class RegressionEvaluation(NamedTuple):
    """What a regression is worth.

    Attributes:
        margins: Name of weights -> score margin of each pair; those of `regressed` by held-out weights.
        accuracies: Kind of human ("all" too) -> name of weights -> accuracy.
        fold_accuracies: Name of weights -> accuracy in each fold.
        permuted: Mean held-out accuracy with permuted labels.
        unmet: Margin that each pair lacks with the final weights, shape (n_pairs,).
        refusals: Reasons not to use the weights.
    """

    margins: Mapping[str, Array]
    accuracies: Mapping[str, Mapping[str, AccuracyInterval]]
    fold_accuracies: Mapping[str, tuple[float, ...]]
    permuted: float
    unmet: Array
    refusals: tuple[RefusalReason, ...]


ALL = "all"


def evaluate_regression(
    ranked: RankedPairs, regression: Regression, base: WeightsSpec, margin: float, seed: int
) -> RegressionEvaluation:
    """Accuracies on the same pairs by regressed (held out), base and other weights; reasons to refuse."""
    table, pairs = ranked.table, ranked.pairs
    margins = {
        REGRESSED: regression.held_out.margins,
        base.name: score_margins(table, np.ones(len(table.metrics))),
        **{name: margins_of_other_weights(pairs, name) for name in _other_names(pairs)},
    }
    kinds = {ALL: np.ones(len(pairs), dtype=bool)}
    kinds |= {str(kind): np.array([pair.kind is kind for pair in pairs]) for kind in {pair.kind for pair in pairs}}
    accuracies = {
        kind: {name: _interval(values[rows], ranked, rows, seed) for name, values in margins.items()}
        for kind, rows in kinds.items()
    }
    folds = regression.held_out.folds
    fold_accuracies = {
        name: tuple(ranking_accuracy(values[fold][np.isfinite(values[fold])]) for fold in folds)
        for name, values in margins.items()
    }
    unmet = np.maximum(margin - score_margins(table, regression.fit.multipliers), 0.0)
    refusals = list_refusals(ranked, accuracies[ALL][REGRESSED])
    permuted = float(np.mean(regression.permuted))
    return RegressionEvaluation(margins, accuracies, fold_accuracies, permuted, unmet, refusals)


def list_refusals(ranked: RankedPairs, accuracy: AccuracyInterval) -> tuple[RefusalReason, ...]:
    """Why the pairs do not determine weights; the held-out accuracy must be clearly above one half."""
    reasons = []
    if len(ranked.pairs) < len(ranked.table.metrics):
        reasons.append(RefusalReason.FEW_PAIRS)
    if find_reversed_pairs(ranked.pairs):
        reasons.append(RefusalReason.CONTRADICTION)
    if not (accuracy.share >= CRITERIA.min_accuracy and accuracy.low > 0.5):
        reasons.append(RefusalReason.CHANCE)
    return tuple(reasons)


def regressed_weights(table: PairTable, multipliers: Array, base: WeightsSpec) -> dict[str, float]:
    """Weights by metric, with the sum of the base weights."""
    total = sum(weight for weight in base.metrics.values() if weight > 0.0)
    values = total * table.shares * multipliers
    return {name: float(f"{value:.{DIGITS}g}") for name, value in zip(table.metrics, values, strict=True)}


def pairs_sha256(pairs: Sequence[DrivePair]) -> str:
    """Hash of everything that a regression reads of its pairs."""
    return data_sha256([_pair_data(pair) for pair in pairs])


def _pair_data(pair: DrivePair) -> list[Any]:
    return [pair.human._asdict(), pair.generated._asdict(), pair.group, str(pair.kind)]


def pair_rows(ranked: RankedPairs, evaluation: RegressionEvaluation) -> list[dict[str, Any]]:
    """A row for each pair, for the report."""
    return [
        {
            "human": pair.human.name,
            "generated": pair.generated.name,
            "group": pair.group,
            "kind": str(pair.kind),
            "sha256": data_sha256(_pair_data(pair)),
            "held_out_margin": float(evaluation.margins[REGRESSED][row]),
            "unmet": float(evaluation.unmet[row]),
        }
        for row, pair in enumerate(ranked.pairs)
    ]


def _other_names(pairs: Sequence[DrivePair]) -> list[str]:
    return list(dict.fromkeys(name for pair in pairs for name in pair.generated.other_scores))


def _interval(margins: Array, ranked: RankedPairs, rows: Array, seed: int) -> AccuracyInterval:
    groups = [group for group, is_used in zip(ranked.groups, rows, strict=True) if is_used]
    return accuracy_interval(margins, groups, seed)
