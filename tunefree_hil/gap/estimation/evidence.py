"""How much more a candidate says than another: log evidence, and whether that holds in block after block.

Both are needed before a name is given. Evidence (Laplace) counts every row, stretched by how long residuals hang
together; it is in thousands of nats as soon as noise is small, and certain of the noise rather than of the name. The
paired test looks at whole blocks and at how much the difference between two models varies from block to block.

What it holds back is a candidate's own parameters: in each fold they are those of the other folds' blocks. What
recalibration moves, and the noise's filter, are those of all judged blocks, fit and choice alike, for both models that
are compared: the test is of one name against another under the same freedom, and no claim about drives that nobody has
seen. That claim is made on the blocks that prove, which nothing here has touched.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.estimation.least_squares import Fitted, bounded, ends_of, gathered, is_free
from tunefree_hil.gap.measured.blocks import PROOF, Blocks

Array = np.ndarray

FOLDS = 5
DRAWS = 2000
LEAST_NATS = 6.0
FARTHEST = 0.1  # of a prior's width that an effect's own parameter may go from fold to fold: slopes hold no farther
OUTSIDE_NATS = 20.0  # for a whole width of the prior beyond its ends


class Paired(NamedTuple):
    """Differences in predictive log likelihood [b] of one model over another, whole blocks; their sum with its 95 %
    interval by bootstrap, the doubt that it is positive, and its standard deviation.
    """

    total: float
    low: float
    high: float
    doubt: float
    noise: float = 0.0


def stretches(model: Fitted) -> dict[str, float]:
    """By how much a model's residuals hang together, by target: one for all that are compared."""
    return {name: one.colour.stretch for name, one in model.sums.items()}


def stretched(model: Fitted, by: Mapping[str, float]) -> Fitted:
    """The same model with these stretches of its noise."""
    sums = {
        name: one._replace(colour=one.colour._replace(stretch=by.get(name, one.colour.stretch)))
        for name, one in model.sums.items()
    }
    return model._replace(sums=sums)


def judged(blocks: Blocks) -> Array:
    """Blocks that are fitted on or chosen by."""
    return np.flatnonzero(blocks.roles != PROOF)


def log_evidence(model: Fitted, blocks: Array) -> float:
    """Laplace's, up to a constant that all models on the same data share."""
    loose = is_free(model.keys, model.free)
    curve, _, _ = gathered(model.sums, len(model.keys), blocks)
    flat = np.diag(2.0 * np.pi * loose)  # what is uniform over its prior, as a normal density that is 1 at its top
    logdet = np.linalg.slogdet(curve + model.prior + flat)[1]
    logdet -= np.linalg.slogdet(model.prior[np.ix_(~loose, ~loose)])[1]
    fit = sum(_log_likelihood(model, name, blocks).sum() for name in model.sums)
    fit -= 0.5 * float(model.z @ model.prior @ model.z)
    count = len(model.free)
    beyond = sum(max(0.0, -u, u - 1.0) for u in model.z[len(model.z) - count :]) if count else 0.0
    return float(fit - 0.5 * logdet + 0.5 * count * np.log(2.0 * np.pi) - OUTSIDE_NATS * beyond)


def _log_likelihood(model: Fitted, name: str, blocks: Array, step: Array | None = None) -> Array:
    """Of a target's rows in each of some blocks, after a step of the parameters by the normal equations."""
    one = model.sums[name]
    square = one.square[blocks]
    if step is not None:
        there = step[one.columns]
        square = square + 2.0 * one.slope[blocks] @ there + np.einsum("bij,i,j->b", one.curve[blocks], there, there)
    return -0.5 * (square + 2.0 * one.count[blocks] * np.log(one.colour.sigma)) / one.colour.stretch


def predictive(model: Fitted, blocks: Array, names: Sequence[str] | None = None) -> Array:
    """Log likelihood of each block [b], the effects' own parameters fitted on the blocks of the other folds.

    What recalibration may move stays where all blocks have put it, for the null as for any candidate: it is the same
    freedom for all, and moved anew in every fold it would be most of what differs.
    """
    found = np.zeros(len(blocks))
    low, high = ends_of(model.keys, model.free)
    loose = is_free(model.keys, model.free)
    for fold in range(min(FOLDS, len(blocks))):
        held = np.arange(len(blocks)) % FOLDS == fold
        step = np.zeros(len(model.keys))
        if loose.any():
            curve, slope, _ = gathered(model.sums, len(model.keys), blocks[~held])
            some = np.ix_(loose, loose)
            step[loose] = bounded(curve[some], slope[loose], model.z[loose], low[loose], high[loose]).clip(
                -FARTHEST, FARTHEST
            )
        for name in names or model.sums:
            found[held] += _log_likelihood(model, name, blocks[held], step)
    return found


def paired(one: Fitted, other: Fitted, blocks: Array, seed: int = 1, names: Sequence[str] | None = None) -> Paired:
    """One model against another, on the same noise stretch."""
    differences = predictive(one, blocks, names) - predictive(other, blocks, names)
    return bootstrapped(differences, seed)


def bootstrapped(differences: Array, seed: int = 1) -> Paired:
    """The sum of differences over blocks, with an interval. The doubt is the share of draws that are not positive, but
    no less than by chance all of so few blocks say the same: no draw of equal signs is of another one.
    """
    chance = np.random.default_rng(seed)
    drawn = chance.choice(differences, (DRAWS, len(differences))).sum(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    doubt = max(float(np.mean(drawn <= 0.0)), 0.5 ** len(differences))
    return Paired(float(differences.sum()), float(low), float(high), doubt, float(drawn.std()))


def holm(doubts: Mapping[str, float], level: float = 0.05) -> set[str]:
    """Names whose doubt is small enough when all of them are asked at once (Holm's step-down)."""
    order = sorted(doubts, key=lambda name: doubts[name])
    found: set[str] = set()
    for i, name in enumerate(order):
        if doubts[name] > level / (len(order) - i):
            break
        found.add(name)
    return found
