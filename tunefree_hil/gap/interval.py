"""How well an effect's own parameters are known: 95 % intervals that a wrong noise does not make too narrow.

Two deviations are taken and the wider one believed: by the curvature of the fit, which trusts its noise, and by how
much the blocks pull in different directions (the sandwich of the two), which trusts nothing but that blocks are
independent. Blocks that prove a repair are not looked at. An effect is extra to a model, and takes the place of what
recalibration may move; what a calibration does not know of that is not known of the effect either, and is added.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from tunefree_hil.gap.graph import effects
from tunefree_hil.gap.problem import Fitted, Free, gathered, prior_of

Array = np.ndarray

UPPER = 0.975  # of Student's t with one degree of freedom less than there are blocks


class Value(NamedTuple):
    """A parameter of an effect with its 95 % interval, all three in `unit`."""

    value: float
    low: float
    high: float
    unit: str


def values_of(name: str, model: Fitted, blocks: Array) -> dict[str, Value]:
    """The parameters of one of a model's effects, by their names. blocks: those that it was fitted on."""
    deviation, units, found = deviations(model, blocks), effects()[name].units, {}
    reach = float(stdtrit(len(blocks) - 1, UPPER))
    for one in model.free:
        owner, _, parameter = one.key.partition(".")
        if owner == name:
            i = model.keys.index(one.key)
            low, high = _ends(one, float(model.z[i]), reach * float(deviation[i]), reach)
            found[parameter] = Value(model.values[one.key], low, high, units[parameter])
    return found


def _ends(one: Free, u: float, by: float, reach: float) -> tuple[float, float]:
    """(low, high) of a parameter at u that is known within `by` of it by these logs, and by its calibration as well as
    that knows it: of a factor in shares of it.
    """
    value = one.value(u)
    doubt = reach * one.doubt * (value / one.neutral if one.logarithmic and one.neutral > 0.0 else 1.0)
    ends = [one.value(float(np.clip(u + way * by, one.least, one.most))) for way in (-1.0, 1.0)]
    far = [value - float(np.hypot(value - min(ends), doubt)), value + float(np.hypot(max(ends) - value, doubt))]
    return max(far[0], one.value(one.least)), min(far[1], one.value(one.most))


def deviations(model: Fitted, blocks: Array) -> Array:
    """Of each key of a fitted model [p], in its own unit (nuisances in standard deviations, free ones in u)."""
    prior = prior_of(model.keys, model.free)
    curve, _, _ = gathered(model.sums, len(model.keys), blocks)
    flat = 2.0 * np.pi * (prior == 0.0)  # as `log_evidence` takes what is uniform over its prior
    inverse = np.linalg.inv(curve + np.diag(prior + flat))
    pulls = np.zeros((len(blocks), len(model.keys)))
    for one in model.sums.values():
        pulls[:, one.columns] += one.slope[blocks] / one.colour.stretch
    pulls = pulls - pulls.mean(axis=0)
    share = len(blocks) / max(len(blocks) - 1, 1)
    sandwich = inverse @ (share * pulls.T @ pulls) @ inverse
    return np.sqrt(np.maximum(np.diag(inverse), np.diag(sandwich)))
