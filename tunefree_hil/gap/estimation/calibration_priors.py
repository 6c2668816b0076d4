"""Prior of the recalibrated parameters from the logs that a model was calibrated on.

A calibration states each constant with an interval. Of parameters that act nearly alike (drive force, knee, gain of the
throttle), the logs know the joint effect much better than these intervals say. Without that knowledge, recalibration
could move all of them a little and mistake a motor that gives a tenth less for another day.

Let theta + d be a parameter on the day of the calibration, theta + d' on a later day: theta belongs to the car, d and
d' are drifts. Their prior covariance is [[S, T], [T, S]], where S = T + D: T is the doubt of the calibration, D that of
the drift. If the calibration logs put the parameter at m with covariance C, then theta has mean T S^-1 m and covariance
T - T S^-1 (S - C) S^-1 T. Blocks of the logs that contradict each other count less: m and C are then those of logs with
correspondingly larger noise (`_posterior_from_blocks`), and what few blocks cannot tell about many parameters is taken
from the average (`_shrink_to_average`). Later logs are compared with the model moved there, and its recalibration has
the remaining doubt as its prior (`apply_calibration_prior`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.gap.estimation.intervals import curvature_covariance, sandwich_covariance
from tunefree_hil.gap.estimation.least_squares import Fit
from tunefree_hil.gap.estimation.nuisance import Nuisance
from tunefree_hil.gap.model.card import CALIBRATION_PRIORS_KEY, card_error, load_model_card

Array = np.ndarray

MIN_INFORMATION = 1e-6  # share of a prior's information below which logs are taken to know nothing of a direction
EIGENVALUE_TOLERANCE = 1e-6  # of a correlation matrix that was rounded when it was written


class CalibrationPrior(NamedTuple):
    """Where the calibration logs put the car.

    Args:
        keys: parameters
        offset: from the model's own values, each in its unit, shape (n_keys,)
        covariance: of `offset`, without the drift of a later day, shape (n_keys, n_keys)
    """

    keys: tuple[str, ...]
    offset: Array
    covariance: Array


NO_PRIOR = CalibrationPrior((), np.zeros(0), np.zeros((0, 0)))


def prior_from_fit(recalibrated: Fit, nuisances: Sequence[Nuisance], blocks: Array) -> CalibrationPrior:
    """Prior from the recalibrated model of the calibration logs, and the blocks that it was fitted on."""
    by_key = {nuisance.key: nuisance for nuisance in nuisances if nuisance.calibration_sigma > 0.0}
    columns = [i for i, key in enumerate(recalibrated.keys) if key in by_key]
    known = [by_key[recalibrated.keys[i]] for i in columns]
    sigma = np.array([nuisance.sigma for nuisance in known])
    units = np.outer(sigma, sigma)
    total = np.linalg.inv(recalibrated.prior_precision)[np.ix_(columns, columns)] * units  # S
    of_car = total - np.diag(sigma**2 - [nuisance.calibration_sigma**2 for nuisance in known])  # T
    gain = np.linalg.solve(total, of_car).T  # T S^-1
    by_curvature, by_blocks = (
        covariance(recalibrated, blocks)[np.ix_(columns, columns)] * units
        for covariance in (curvature_covariance, sandwich_covariance)
    )
    mean, posterior = _posterior_from_blocks(
        total, by_curvature, by_blocks, sigma * recalibrated.z[columns], len(blocks)
    )
    keys = tuple(nuisance.key for nuisance in known)
    return CalibrationPrior(keys, gain @ mean, of_car - gain @ (total - posterior) @ gain.T)


def apply_calibration_prior(
    nuisances: Sequence[Nuisance], correlation: Array, prior: CalibrationPrior
) -> tuple[list[Nuisance], Array]:
    """Nuisances and the correlation of their priors, shape (n_nuisances, n_nuisances), given the calibration logs."""
    index = {nuisance.key: i for i, nuisance in enumerate(nuisances)}
    shared = [k for k, key in enumerate(prior.keys) if key in index]
    rows = [index[prior.keys[k]] for k in shared]
    if not rows:
        return list(nuisances), correlation
    sigma = np.array([nuisance.sigma for nuisance in nuisances])
    covariance = correlation * np.outer(sigma, sigma)
    of_car = prior.covariance[np.ix_(shared, shared)]
    drift_variance = [nuisances[i].sigma ** 2 - nuisances[i].calibration_sigma ** 2 for i in rows]
    covariance[np.ix_(rows, rows)] = of_car + np.diag(drift_variance)
    sigma, updated = np.sqrt(np.diag(covariance)), list(nuisances)
    for i, variance in zip(rows, np.diag(of_car), strict=True):
        updated[i] = nuisances[i]._replace(sigma=float(sigma[i]), calibration_sigma=float(variance) ** 0.5)
    return updated, covariance / np.outer(sigma, sigma)


def _posterior_from_blocks(
    prior: Array, by_curvature: Array, by_blocks: Array, mean: Array, n_blocks: int
) -> tuple[Array, Array]:
    """Mean (k,) and covariance (k, k) of parameters theta, with noise as large as the blocks disagree.

    The score of the logs is b = J theta + e, where e has the covariance J + M: J is the information of their curvature,
    M the scatter of the scores of their blocks. M of blocks that agree is about J: such logs count by half. The fit had
    assumed M = 0: it is at `mean` with covariance `by_curvature`; `by_blocks` is M propagated through that. Where the
    prior of theta is the identity, K = (1 + J (J + M)^-1 J)^-1, and theta is at K J (J + M)^-1 b; in directions without
    information in J it stays. (A mean that is shrunk along the axes of one covariance may change its sign along those
    of another.)
    """
    root = np.linalg.cholesky(prior)
    by_curvature, by_blocks = (
        np.linalg.solve(root, np.linalg.solve(root, covariance).T) for covariance in (by_curvature, by_blocks)
    )
    precision = np.linalg.inv(by_curvature)
    values, vectors = np.linalg.eigh(precision - np.eye(len(root)))
    values, vectors = values[values > MIN_INFORMATION], vectors[:, values > MIN_INFORMATION]
    half, back = vectors * np.sqrt(values), precision @ vectors / np.sqrt(values)
    weight = np.linalg.inv(np.eye(len(values)) + _shrink_to_average(back.T @ by_blocks @ back, n_blocks))
    covariance = np.linalg.inv(np.eye(len(root)) + half @ weight @ half.T)
    posterior: Array = root @ covariance @ half @ weight @ back.T @ np.linalg.solve(root, mean)
    return posterior, root @ covariance @ root.T


def _shrink_to_average(scatter: Array, n_blocks: int) -> Array:
    """Shrink the scatter of the blocks' scores (k, k), in units of their noise, to its average over all directions.

    Fewer blocks than parameters show no scatter in some directions, which are not better known for that.
    """
    size = len(scatter)
    if not size:
        return scatter
    share = size / (size + n_blocks - 1)
    return (1.0 - share) * scatter + share * np.trace(scatter) / size * np.eye(size)


def card_entry_from_prior(prior: CalibrationPrior) -> dict[str, Any]:
    """Entries for the model's card; none for an empty prior."""
    if not prior.keys:
        return {}
    entry = {"keys": list(prior.keys), "off": prior.offset.tolist(), "covariance": prior.covariance.tolist()}
    return {CALIBRATION_PRIORS_KEY: entry}


def read_calibration_prior(model: ModelSpec) -> CalibrationPrior:
    """Read the prior from a model's card; NO_PRIOR where the card has none.

    Raises: InputError for an invalid card.
    """
    entry = load_model_card(model).get(CALIBRATION_PRIORS_KEY)
    if entry is None:
        return NO_PRIOR
    try:
        return _parse(entry)
    except (TypeError, KeyError, ValueError) as error:
        raise card_error(Path(model.folder) / model.plant.card, f"{CALIBRATION_PRIORS_KEY}: {error}") from error


def _parse(entry: Mapping[str, Any]) -> CalibrationPrior:
    keys = tuple(str(key) for key in entry["keys"])
    offset, covariance = np.array(entry["off"], dtype=float), np.array(entry["covariance"], dtype=float)
    size = len(keys)
    has_shape = offset.shape == (size,) and covariance.shape == (size, size)
    if not (has_shape and np.isfinite(offset).all() and np.isfinite(covariance).all()):
        raise ValueError(f"{size} keys need {size} finite offsets and a {size} x {size} covariance")
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if not (size and (scale > 0.0).all() and _smallest_eigenvalue(covariance, scale) > -EIGENVALUE_TOLERANCE):
        raise ValueError("the covariance has a direction of negative variance")
    return CalibrationPrior(keys, offset, covariance)


def _smallest_eigenvalue(covariance: Array, scale: Array) -> float:
    return float(np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min())
