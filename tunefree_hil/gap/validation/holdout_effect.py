"""What an effect does to its own signal on the holdout blocks, compared with the blocks that it was fitted on."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.selection.scoring import bootstrap_reduction
from tunefree_hil.gap.workers.worker import FitSummary

Array = np.ndarray

# RMS on the holdout blocks, as a share of that on the fitted ones, below which the holdout does not reach the effect
MIN_REFERENCE_SHARE = 0.1


class HoldoutEffect(NamedTuple):
    """What an effect does to the signal that shows it best; shares of the recalibrated error, NaN where not measured.

    Where recalibration misses next to nothing on the holdout blocks (a stop that they do not reach), shares are of
    MIN_REFERENCE_SHARE of its error elsewhere.

    Args:
        fit_error_reduction: share of the RMS that the effect removes on the blocks that it was fitted on.
        holdout_error_reduction: the same on the holdout blocks.
        effect_energy: share of the squares there that the effect changes, for better or worse.
    """

    fit_error_reduction: float
    holdout_error_reduction: float
    effect_energy: float


NOT_MEASURED = HoldoutEffect(math.nan, math.nan, math.nan)


class ComparedModels(NamedTuple):
    """The model without an effect and with it, and the model without any."""

    before: FitSummary
    after: FitSummary
    recalibrated: FitSummary


def measure_holdout_effect(models: ComparedModels, target: str, blocks: Array, holdout: Array) -> HoldoutEffect:
    """Measure the effect that `models.after` has and `models.before` has not.

    Row by row or by means over a second, whichever is surer on the fitted blocks; the same then on the holdout blocks.

    Args:
        blocks, holdout: the fitted blocks, and the holdout blocks.
    """
    views = [[model.squared_residuals[target] for model in models]]
    if target in models.before.averaged_squared_residuals:
        views.append([model.averaged_squared_residuals[target] for model in models])
    view = max(views, key=lambda squares: bootstrap_reduction(squares, blocks).low)
    before, after, recalibrated = (sums[holdout] for sums, _ in view)
    fit_reduction = bootstrap_reduction(view, blocks).value
    if not recalibrated.sum() > 0.0:
        return HoldoutEffect(fit_reduction, math.nan, math.nan)
    sums, counts = view[2]
    fitted_square = float(sums[blocks].sum() / max(counts[blocks].sum(), 1.0))
    reference = max(float(recalibrated.sum()), MIN_REFERENCE_SHARE**2 * fitted_square * float(counts[holdout].sum()))
    reduction = math.sqrt(before.sum() / reference) - math.sqrt(after.sum() / reference)
    return HoldoutEffect(fit_reduction, reduction, float(np.abs(before - after).sum()) / reference)
