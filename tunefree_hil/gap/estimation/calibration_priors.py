"""What a model's own logs make of the numbers that recalibration may move, as a prior for later logs.

A calibration fits its constants by free runs of its own, and states each with an interval. `gap` weighs signals
otherwise, and of numbers that do nearly the same (drive force, knee, throttle's gain) it knows what they come to
together far better than any of those intervals says: it knows so from the very logs that the model was made from.
Without that, recalibration could move all of them a little, and take a motor that gives a tenth less for another day.

A number of the own logs' day and the same number of a later day are theta + d and theta + d': theta the car's, d and
d' drifts. Of both the prior covariance is [[S, T], [T, S]], S = T + D: T what the calibration leaves open, D the drift.
Where the own logs put theirs at m, known by C, theta is at T S^-1 m, known by T - T S^-1 (S - C) S^-1 T. Blocks of the
logs that disagree are believed the less: both m and C are then those of logs whose noise is the larger by just that
(`_as_blocks_agree`), and what a few blocks do not say of many numbers is taken from the average (`_shrunk`). Later
logs are held against the model moved there (`repair.moved`), and its recalibration knows theta so well (`after_own`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.gap.estimation.intervals import by_blocks, curvature
from tunefree_hil.gap.estimation.least_squares import Fitted
from tunefree_hil.gap.estimation.nuisance import Nuisance
from tunefree_hil.gap.model.card import OWN_NUMBERS, card_of, no_card

Array = np.ndarray

SILENT = 1e-6  # of what a prior knows (1 / variance): logs that know less in a direction say nothing of it
ROUNDED = 1e-6  # of a correlation: by what a covariance that was written down may seem none


class OwnNumbers(NamedTuple):
    """What own logs say of the car: keys [k]; off [k]: where it is, from the model's own numbers; covariance [k, k] of
    that, a later day's drift not in it; each in its own unit.
    """

    keys: tuple[str, ...]
    off: Array
    covariance: Array


NOBODY_ASKED = OwnNumbers((), np.zeros(0), np.zeros((0, 0)))


def own_numbers(null: Fitted, drifting: Sequence[Nuisance], blocks: Array) -> OwnNumbers:
    """Of the null of a model's own logs. blocks: those that it was fitted on."""
    some = {one.key: one for one in drifting if one.told > 0.0}
    at = [i for i, key in enumerate(null.keys) if key in some]
    mine = [some[null.keys[i]] for i in at]
    sigma = np.array([one.sigma for one in mine])
    units = np.outer(sigma, sigma)
    prior = np.linalg.inv(null.prior)[np.ix_(at, at)] * units
    told = prior - np.diag(sigma**2 - [one.told**2 for one in mine])
    carried = np.linalg.solve(prior, told).T  # T S^-1
    sharp, blurred = (one(null, blocks)[np.ix_(at, at)] * units for one in (curvature, by_blocks))
    mean, known = _as_blocks_agree(prior, sharp, blurred, sigma * null.z[at], len(blocks))
    off = carried @ mean
    return OwnNumbers(tuple(one.key for one in mine), off, told - carried @ (prior - known) @ carried.T)


def after_own(some: Sequence[Nuisance], correlation: Array, own: OwnNumbers) -> tuple[list[Nuisance], Array]:
    """Nuisances and the correlation [p, p] of their priors, once the own logs have said theirs."""
    place = {one.key: i for i, one in enumerate(some)}
    both = [k for k, key in enumerate(own.keys) if key in place]
    at = [place[own.keys[k]] for k in both]
    if not at:
        return list(some), correlation
    sigma = np.array([one.sigma for one in some])
    whole = correlation * np.outer(sigma, sigma)
    car = own.covariance[np.ix_(both, both)]
    whole[np.ix_(at, at)] = car + np.diag([some[i].sigma ** 2 - some[i].told ** 2 for i in at])
    sigma, found = np.sqrt(np.diag(whole)), list(some)
    for i, known in zip(at, np.diag(car), strict=True):
        found[i] = some[i]._replace(sigma=float(sigma[i]), told=float(known) ** 0.5)
    return found, whole / np.outer(sigma, sigma)


def _as_blocks_agree(prior: Array, sharp: Array, blurred: Array, mean: Array, blocks: int) -> tuple[Array, Array]:
    """(mean [k], covariance [k, k]) by a prior and logs whose score b = J theta + e has noise of covariance J + M: J is
    what they know by their curvature alone, M what the scores of their blocks disagree by. Of blocks that agree M is
    their noise, and as large as J: such logs are believed by half.

    The fit took M for 0: it is at `mean`, known by `sharp`; `blurred` is M through that. Where theta's prior is the
    identity, K = (1 + J (J + M)^-1 J)^-1, and theta is at K J (J + M)^-1 b; in directions of which J is silent, it
    stays. (A mean that is weakened along the axes of a covariance may turn round along those of another.)
    """
    root = np.linalg.cholesky(prior)
    sharp, blurred = (np.linalg.solve(root, np.linalg.solve(root, one).T) for one in (sharp, blurred))
    precise = np.linalg.inv(sharp)
    values, vectors = np.linalg.eigh(precise - np.eye(len(root)))
    values, vectors = values[values > SILENT], vectors[:, values > SILENT]
    half, back = vectors * np.sqrt(values), precise @ vectors / np.sqrt(values)
    weight = np.linalg.inv(np.eye(len(values)) + _shrunk(back.T @ blurred @ back, blocks))
    known = np.linalg.inv(np.eye(len(root)) + half @ weight @ half.T)
    found: Array = root @ known @ half @ weight @ back.T @ np.linalg.solve(root, mean)
    return found, root @ known @ root.T


def _shrunk(disagree: Array, blocks: int) -> Array:
    """What the scores of so many blocks disagree by in each direction [k, k], where their noise is 1: drawn to the
    average by as much as it is not known. With fewer blocks than numbers nothing is seen to disagree in some
    directions, and they are no surer for that.
    """
    size = len(disagree)
    if not size:
        return disagree
    share = size / (size + blocks - 1)
    return (1.0 - share) * disagree + share * np.trace(disagree) / size * np.eye(size)


def as_data(own: OwnNumbers) -> dict[str, Any]:
    """Keys of the card; none where there is nothing to keep."""
    if not own.keys:
        return {}
    return {OWN_NUMBERS: {"keys": list(own.keys), "off": own.off.tolist(), "covariance": own.covariance.tolist()}}


def own_numbers_of(model: ModelSpec) -> OwnNumbers:
    """What a model's card says of them; nothing where its own logs were not asked. Raises InputError for a card that is
    none.
    """
    said = card_of(model).get(OWN_NUMBERS)
    if said is None:
        return NOBODY_ASKED
    try:
        return _read(said)
    except (TypeError, KeyError, ValueError) as error:
        raise no_card(Path(model.folder) / model.plant.card, f"{OWN_NUMBERS}: {error}") from error


def _read(said: Mapping[str, Any]) -> OwnNumbers:
    keys = tuple(str(key) for key in said["keys"])
    off, known = np.array(said["off"], dtype=float), np.array(said["covariance"], dtype=float)
    size = len(keys)
    if off.shape != (size,) or known.shape != (size, size) or not (np.isfinite(off).all() and np.isfinite(known).all()):
        raise ValueError(f"numbers of {size} keys are not {off.shape} and {known.shape} finite ones")
    scale = np.sqrt(np.maximum(np.diag(known), 0.0))
    if not (
        size and (scale > 0.0).all() and float(np.linalg.eigvalsh(known / np.outer(scale, scale)).min()) > -ROUNDED
    ):
        raise ValueError("this is no covariance: it has a direction of negative variance")
    return OwnNumbers(keys, off, known)
