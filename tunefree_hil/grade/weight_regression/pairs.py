"""Pairs of a human and a generated drive of the same task, and their differences as a table (paper, eq. 10).

A pair counts in the regression where both drives came to their end without a re-plan: a failed drive has the failure
score, whatever the weights are, and a re-plan costs its penalty.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.grade.score import FINISHED, counted_value

Array = np.ndarray


class DriverKind(StrEnum):
    """Who drove the human side of a pair."""

    HUMAN = "human"  # a recorded person
    MODEL = "model"  # the driver model of this project


class RankedDrive(NamedTuple):
    """A drive as the regression sees it.

    Attributes:
        name: For messages.
        task: Identity of what was to be driven: drives of one pair must have the same.
        metrics: Metric -> value, graded as the base weights say; None where it is not available.
        outcome: As in a ScenarioGrade.
        replans: Number of re-plans.
        other_scores: Name of other weights -> their weighted mean of this drive.
    """

    name: str
    task: str
    metrics: Mapping[str, float | None]
    outcome: str = FINISHED
    replans: int = 0
    other_scores: Mapping[str, float] = {}

    @property
    def is_decided_by_weights(self) -> bool:
        """Whether its score is a weighted mean of its metrics and nothing else."""
        return self.outcome == FINISHED and self.replans == 0


class DrivePair(NamedTuple):
    """A pair: the human drive should have the lower score. group: pairs of a group are held out together."""

    human: RankedDrive
    generated: RankedDrive
    group: str
    kind: DriverKind

    @property
    def name(self) -> str:
        """For messages."""
        return f"{self.human.name} / {self.generated.name}"


class PairTable(NamedTuple):
    """The pairs as arrays.

    Attributes:
        metrics: Names of the metrics, those with a weight in the base weights.
        shares: Base weights over their sum, shape (n_metrics,).
        differences: Human minus generated, as counted by the score; 0 where not available. Shape (n_pairs, n_metrics).
        is_available: Whether both drives have the metric, same shape.
    """

    metrics: tuple[str, ...]
    shares: Array
    differences: Array
    is_available: Array

    @property
    def n_pairs(self) -> int:
        """Number of pairs."""
        return len(self.differences)

    def select(self, rows: Array) -> PairTable:
        """The table of some rows."""
        return self._replace(differences=self.differences[rows], is_available=self.is_available[rows])

    def swap(self, is_swapped: Array) -> PairTable:
        """The table with human and generated drive exchanged where `is_swapped`, shape (n_pairs,)."""
        return self._replace(differences=np.where(is_swapped[:, None], -self.differences, self.differences))


def require_same_task(pair: DrivePair) -> None:
    """Raise InputError for drives of unlike tasks."""
    if pair.human.task != pair.generated.task:
        raise InputError(
            f"{pair.human.name} drove {pair.human.task}, {pair.generated.name} drove {pair.generated.task}",
            code="unlike_tasks",
            key="pairs",
            hint="pair drives of the same scenario file or reference path",
        )


def make_pair_table(pairs: Sequence[DrivePair], base: WeightsSpec) -> PairTable:
    """The differences of pairs that are decided by weights.

    Raises:
        InputError: A pair of unlike tasks, or a drive without any metric that the base weights name.
    """
    metrics = tuple(name for name, weight in base.metrics.items() if weight > 0.0)
    weights = np.array([base.metrics[name] for name in metrics])
    differences = np.zeros((len(pairs), len(metrics)))
    is_available = np.zeros((len(pairs), len(metrics)), dtype=bool)
    for row, pair in enumerate(pairs):
        require_same_task(pair)
        for column, name in enumerate(metrics):
            human, generated = pair.human.metrics.get(name), pair.generated.metrics.get(name)
            if human is not None and generated is not None:
                is_available[row, column] = True
                differences[row, column] = counted_value(human, base) - counted_value(generated, base)
        if not is_available[row].any():
            raise InputError(
                f"{pair.name}: no weighted metric is available in both drives",
                code="nothing_to_grade",
                key="pairs",
                hint=f"the logs must contain what {base.name!r} weighs: {', '.join(metrics)}",
            )
    return PairTable(metrics, weights / weights.sum(), differences, is_available)


def score_margins(table: PairTable, multipliers: Array) -> Array:
    """Score of the generated minus score of the human drive (eq. 7), positive where the human is ranked better.

    Args:
        multipliers: Weight over base weight of each metric, shape (n_metrics,).

    Returns:
        Shape (n_pairs,); metrics that are not available are dropped and the rest is renormalised. 0 where all metrics
        that a pair has lost their weight.
    """
    weights = table.is_available * (table.shares * multipliers)
    totals = weights.sum(axis=1)
    return -(weights * table.differences).sum(axis=1) / np.where(totals > 0.0, totals, 1.0)


def find_reversed_pairs(pairs: Sequence[DrivePair]) -> list[tuple[int, int]]:
    """Indices of pairs of which the second says the opposite of the first: same drives, exchanged."""
    first_seen: dict[tuple[str, str, str], int] = {}
    reversed_pairs = []
    for number, pair in enumerate(pairs):
        key = (pair.human.task, pair.human.name, pair.generated.name)
        opposite = (pair.human.task, pair.generated.name, pair.human.name)
        if opposite in first_seen:
            reversed_pairs.append((first_seen[opposite], number))
        first_seen.setdefault(key, number)
    return reversed_pairs
