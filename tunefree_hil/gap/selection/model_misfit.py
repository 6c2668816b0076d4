"""What a fitted model leaves unexplained, by target."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.diagnostics.lack_of_fit import LackOfFit
from tunefree_hil.gap.diagnostics.residual_tests import LinkResidual, assess_links
from tunefree_hil.gap.selection.baseline_misfit import BaselineMisfit
from tunefree_hil.gap.workers import worker
from tunefree_hil.gap.workers.pool import WorkerPool
from tunefree_hil.gap.workers.worker import FitSummary, OpenProblem

Array = np.ndarray


class SearchContext(NamedTuple):
    """What a search works with: the processes, the problem that they have open, and the blocks that count."""

    pool: WorkerPool
    problem: OpenProblem
    blocks: Array


class ModelMisfit(NamedTuple):
    """lack_of_fit: what could still be explained, by target. links: every target, the worst broken first."""

    lack_of_fit: dict[str, LackOfFit]
    links: list[LinkResidual]


def assess_model(pool: WorkerPool, problem: OpenProblem, model: FitSummary, blocks: Array) -> ModelMisfit:
    """What a model leaves in these blocks, and which links are broken with it."""
    (lack_of_fit,) = pool.call(worker.assess_lack_of_fit, [model.fit], blocks)
    (bursts,) = pool.call(worker.find_bursts, [model.fit], blocks)
    return ModelMisfit(lack_of_fit, assess_links(lack_of_fit, problem.target_properties, problem.signal_scales, bursts))


def mark_broken_targets(problem: OpenProblem, links: Sequence[LinkResidual], baseline: BaselineMisfit) -> OpenProblem:
    """The problem with the targets that recalibration leaves broken, and those of them that are within the baseline."""
    broken = [link for link in links if link.is_broken]
    within = frozenset(link.signal for link in broken if baseline.is_within(link))
    return problem._replace(broken_targets=frozenset(link.signal for link in broken), targets_within_baseline=within)
