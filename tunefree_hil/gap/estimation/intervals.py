"""How well an effect's own parameters are known: 95 % intervals that a wrong noise does not make too narrow.

Two deviations are taken and the wider one believed: by the curvature of the fit, which trusts its noise, and by how
much the blocks pull in different directions (the sandwich of the two), which trusts nothing but that blocks are
independent. Blocks that prove a repair are not looked at. An effect is extra to a model, and takes the place of what
recalibration may move; what a calibration does not know of that is not known of the effect either, and is added.

What recalibration would move further than it may: a number at its end that the logs still pull at.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, stdtrit

from tunefree_hil.gap.estimation.evidence import LEAST_NATS
from tunefree_hil.gap.estimation.least_squares import Fitted, Free, gathered, is_free
from tunefree_hil.gap.estimation.nuisance import DAILY, DRIFT
from tunefree_hil.gap.model.graph import effects

Array = np.ndarray

WAVERS = 0.05  # of itself: by what a constant may differ from block to block for want of a model that is exact
JITTER_S = 0.002  # by which frames come sooner or later themselves: no delay is steadier
CHANCE = 0.999  # that blocks differ by no more than chance
# How much of its throttle, brake and steering a car does: by what that may be off from day to day it is not off from
# one block to the next
GAINS = ("throttle_gain.gain_frac", "brake_gain.gain_frac", "steer_gain.gain_frac")
# Of what a number drifts from day to day (drifts.py), standard deviations: a car with other pedals than a model has
# comes to 1.1. Not of what its calibration leaves open: the worse that is, the more would be let pass.
UNSTEADY = 1.5
FORM = 0.01  # of the distance from neutral, standard deviation: no car does an effect quite in the catalogue's form
AROUND = 0.01  # of u, to either side: over which a parameter's scale is taken as even
KNOWS = 1e-9  # of the block that knows most of a key: who knows less says nothing of it

UPPER = 0.975  # of Student's t with one degree of freedom less than there are blocks


class Value(NamedTuple):
    """A parameter of an effect with its 95 % interval, all three in `unit`."""

    value: float
    low: float
    high: float
    unit: str


class Wavering(NamedTuple):
    """By how much an effect's first parameter differs from block to block beyond noise: in u (problem.Free), and as a
    share of its distance from neutral (of a factor of itself where neutral is none); 0 where chance would do.
    """

    key: str
    by: float
    share: float


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
    that knows it: of a factor in shares of it, of what counts by a constant of the model as well as that is known.
    """
    value = one.value(u)
    doubt = reach * one.doubt * (value / one.neutral if one.logarithmic and one.neutral > 0.0 else 1.0)
    if one.share:  # a limit's neutral is without end
        doubt = float(np.hypot(doubt, reach * one.share * (value - one.neutral)))
    by = float(np.hypot(by, reach * FORM * distance(one, u)))
    ends = [one.value(float(np.clip(u + way * by, one.least, one.most))) for way in (-1.0, 1.0)]
    far = [value - float(np.hypot(value - min(ends), doubt)), value + float(np.hypot(max(ends) - value, doubt))]
    return max(far[0], one.value(one.least)), min(far[1], one.value(one.most))


def deviations(model: Fitted, blocks: Array) -> Array:
    """Of each key of a fitted model [p], in its own unit (nuisances in standard deviations, free ones in u)."""
    inverse, sandwich = _doubts(model, blocks)
    return np.sqrt(np.maximum(np.diag(inverse), np.diag(sandwich)))


def curvature(model: Fitted, blocks: Array) -> Array:
    """Covariance of the keys of a fitted model [p, p], in their units, as a fit has it that trusts its noise."""
    return _doubts(model, blocks)[0]


def by_blocks(model: Fitted, blocks: Array) -> Array:
    """The same [p, p] by what the blocks disagree by, alone: the sandwich."""
    return _doubts(model, blocks)[1]


def _doubts(model: Fitted, blocks: Array) -> tuple[Array, Array]:
    """(inverse curvature, sandwich) [p, p] of a fitted model."""
    curve, _, _ = gathered(model.sums, len(model.keys), blocks)
    flat = np.diag(2.0 * np.pi * is_free(model.keys, model.free))  # as `log_evidence` takes what is uniform
    inverse = np.linalg.inv(curve + model.prior + flat)
    pulls = np.zeros((len(blocks), len(model.keys)))
    for one in model.sums.values():
        pulls[:, one.columns] += one.slope[blocks] / one.colour.stretch
    pulls = pulls - pulls.mean(axis=0)
    share = len(blocks) / max(len(blocks) - 1, 1)
    return inverse, inverse @ (share * pulls.T @ pulls) @ inverse


def across(model: Fitted, blocks: Array) -> dict[str, tuple[float, float]]:
    """(value, deviation) of each free key, in its unit: by the fit, and by what it is from one block to another, be
    that of one drive or of two.
    """
    by, found = deviations(model, blocks), {}
    for one in model.free:
        i = model.keys.index(one.key)
        u = float(model.z[i])
        whole = float(np.hypot(by[i], _spread(*_pulls(model, i, blocks), np.zeros(len(blocks)))))
        slope = abs(one.value(u + AROUND) - one.value(u - AROUND)) / (2.0 * AROUND)
        found[one.key] = (model.values[one.key], whole * slope)
    return found


def wavering(model: Fitted, name: str, blocks: Array, drives: Array) -> Wavering:
    """Of one of a model's effects; 0 too where the same number differs no less in a model that misses nothing. An
    effect that is there is the same in all blocks; what stands in for something else follows that. drives: of which
    drive each block is.
    """
    one = next(free for free in model.free if free.key.partition(".")[0] == name)
    i = model.keys.index(one.key)
    u, by = float(model.z[i]), _between(model, i, blocks, drives)
    jitters = (
        effects()[name].units[one.key.partition(".")[2]] == "s" and abs(one.value(u + by) - one.value(u)) < JITTER_S
    )
    if jitters or by <= UNSTEADY * _in_u(one, u, one.drift):
        return Wavering(one.key, 0.0, 0.0)
    return Wavering(one.key, by, by / max(distance(one, u), 1e-9))


def unsteady(model: Fitted, blocks: Array, drives: Array, sigmas: Mapping[str, float]) -> dict[str, float]:
    """By how many deviations of its drift each of GAINS that was recalibrated differs from block to block, as far as
    that is more than UNSTEADY. drives: of which drive each block is; sigmas: what each key's unit is (null.nuisances).
    """
    some = [key for key in GAINS if key in model.keys]
    unit = {key: sigmas.get(key, DRIFT[key]) / DRIFT[key] for key in some}
    found = {key: unit[key] * _between(model, model.keys.index(key), blocks, drives) for key in some}
    return {key: by for key, by in found.items() if by > UNSTEADY}


def _between(model: Fitted, i: int, blocks: Array, drives: Array) -> float:
    """Standard deviation of key i from block to block of a drive, beyond noise, in its own unit; 0 where chance would
    do. From one drive to another it may be another one: these may be days apart. What all blocks of a drive say alike
    is no difference between them, however strongly they say it, as where a key is held at an end of its range.

    A block says pull / curve, and knows it by 1 / sqrt(curve). Whether that is chance is asked of all blocks as far as
    they know it; by how much they differ, mostly of those that know it well.
    """
    return _spread(*_pulls(model, i, blocks), drives)


def apart(model: Fitted, blocks: Array, drives: Array) -> dict[str, float]:
    """By how many deviations of its prior each of DAILY that was recalibrated differs from drive to drive, as far as
    that is more than UNSTEADY: it is one number for all of them here.
    """
    found, every = {}, np.unique(drives)
    for i, key in enumerate(model.keys[: len(model.keys) - len(model.free)]):
        if key.partition(".")[0] in DAILY and len(every) > 1:
            whole = [[float(one[drives == drive].sum()) for drive in every] for one in _pulls(model, i, blocks)]
            found[key] = _spread(np.array(whole[0]), np.array(whole[1]), np.zeros(len(every)))
    return {key: by for key, by in found.items() if by > UNSTEADY}


def _spread(pull: Array, curve: Array, groups: Array) -> float:
    """Standard deviation, within its group, of what pulls [b] with these curvatures say, beyond chance."""
    known = curve > KNOWS * float(curve.max(initial=0.0))
    square, degrees, excess, weight = 0.0, 0, 0.0, 0.0
    for group in np.unique(groups[known]):
        w, p = (one[known & (groups == group)] for one in (curve, pull))
        whole = float(w.sum())
        p = p - w * float(p.sum()) / whole
        square += float(np.sum(p * p / w))
        degrees += len(w) - 1
        excess += float(p @ p) - float(np.sum(w - w * w / whole))
        weight += float(np.sum(w * w * (1.0 - 2.0 * w / whole + float(w @ w) / whole**2)))
    if degrees < 1 or square <= float(chdtri(degrees, 1.0 - CHANCE)) or weight <= 0.0:
        return 0.0
    return max(excess / weight, 0.0) ** 0.5


def _pulls(model: Fitted, i: int, blocks: Array) -> tuple[Array, Array]:
    """(pull, curvature) of key i [b] by block, over all targets."""
    pull, curve = np.zeros(len(blocks)), np.zeros(len(blocks))
    for sums in model.sums.values():
        for c in np.flatnonzero(sums.columns == i):
            pull += sums.slope[blocks, c] / sums.colour.stretch
            curve += sums.curve[blocks, c, c] / sums.colour.stretch
    return pull, curve


def _in_u(one: Free, u: float, sigma: float) -> float:
    """A deviation that is given in the parameter's unit at neutral, in u at u: of a factor it is a share."""
    if not one.logarithmic:
        return sigma / (one.high - one.low)
    value = one.neutral if 0.0 < one.neutral < np.inf else one.value(u)
    return sigma / value / float(np.log(one.high / one.low))


def distance(one: Free, u: float) -> float:
    """From neutral to u; of what is sought by its logarithm and has no neutral on it, one of these."""
    if not one.logarithmic:
        return abs(u - one.place(one.neutral))
    reachable = 0.0 < one.neutral < np.inf
    return abs(u - one.place(one.neutral)) if reachable else 1.0 / float(np.log(one.high / one.low))


AT_END = 1.8  # standard deviations, of the 2 that it may go


class Held(NamedTuple):
    """A number of recalibration's: key; z: where it is held, in standard deviations; nats: what letting it go further
    would gain, all that is not held moving with it.
    """

    key: str
    z: float
    nats: float

    @property
    def words(self) -> str:
        """For who reads."""
        return f"recalibration moves {self.key} by {self.z:+.1f} standard deviations"


def held_back(model: Fitted, blocks: Array) -> list[Held]:
    """Of a fitted model what is held back by more than LEAST_NATS, the most first. blocks: those that it was fitted on.

    By the curvature of the fit, and not simulated: far beyond its end a number may do something else.
    """
    curve, slope, _ = gathered(model.sums, len(model.keys), blocks)
    curve, slope = curve + model.prior, slope + model.prior @ model.z
    loose = np.ones(len(model.keys), dtype=bool)
    loose[: len(model.keys) - len(model.free)] = np.abs(model.z[: len(model.keys) - len(model.free)]) <= AT_END
    found = []
    for i in np.flatnonzero(~loose):
        some = np.append(np.flatnonzero(loose), i)
        inner = np.linalg.pinv(curve[np.ix_(some, some)])[-1, -1]
        nats = 0.5 * float(slope[i] ** 2 * inner)
        if slope[i] * model.z[i] < 0.0 and nats > LEAST_NATS:
            found.append(Held(model.keys[i], float(model.z[i]), nats))
    return sorted(found, key=lambda one: -one.nats)
