"""A hill and an accelerometer's offset, which a calibration cannot tell apart.

A model of drives up the same hill has the hill in its rolling resistance; what the accelerometer measures of the hill
then looks like an offset. Only a rolling resistance that no tyre has excludes the hill.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.gap.estimation.least_squares import Fit
from tunefree_hil.gap.selection.baseline_misfit import BaselineMisfit
from tunefree_hil.gap.selection.criteria import BASELINE, GRADE_CRITERIA, CandidateScore
from tunefree_hil.plant.data_sheet import DEFAULTS

GRADE, ACCEL_BIAS, BIAS_KEY, ROLLING_KEY = "grade", "accel_bias", "bias_mps2", "rolling_frac"
WITH_ROLLING = ("physics", "hybrid")  # kinds of plant that have a rolling resistance, whether or not their file says so


def add_grade_equivalent(
    steps: Sequence[CandidateScore], fit: Fit, baseline: BaselineMisfit, model: ModelSpec
) -> list[CandidateScore]:
    """Make the hill an equivalent of an accelerometer's offset that the calibration logs had as well.

    Args:
        fit: the fit with all steps.
    """
    return [
        step._replace(equivalents=(*step.equivalents, GRADE))
        if step.name == ACCEL_BIAS
        and GRADE not in step.equivalents
        and _had_same_offset(fit, baseline)
        and may_be_grade(fit, model)
        else step
        for step in steps
    ]


def _had_same_offset(fit: Fit, baseline: BaselineMisfit) -> bool:
    """Whether the calibration logs had the same offset."""
    known = baseline.explaining.get(ACCEL_BIAS) or baseline.effects.get(ACCEL_BIAS) or {}
    before, sigma = known.get(BIAS_KEY, (math.nan, 0.0))
    bias = fit.values[f"{ACCEL_BIAS}.{BIAS_KEY}"]
    limit = max(BASELINE.new_value_sigmas * sigma, GRADE_CRITERIA.same_offset_share * abs(bias))
    return abs(bias - before) <= limit


def may_be_grade(fit: Fit, model: ModelSpec) -> bool:
    """Whether a hill as steep as the offset suggests may be in the model's rolling resistance. A net that has none may
    have learned any hill.
    """
    ordinary = DEFAULTS[ROLLING_KEY]
    if model.plant.kind not in WITH_ROLLING and ROLLING_KEY not in model.plant.params:
        return True
    rolling = model.plant.params.get(ROLLING_KEY, ordinary)
    level = rolling - fit.values[f"{ACCEL_BIAS}.{BIAS_KEY}"] / G_MPS2
    if rolling <= 0.0 or level <= 0.0:
        return False
    sigma = GRADE_CRITERIA.rolling_log_sigma
    distance, level_distance = (math.log(number / ordinary) / sigma for number in (rolling, level))
    return 0.5 * (level_distance**2 - distance**2) < GRADE_CRITERIA.min_exclusion_nats
