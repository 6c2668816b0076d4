"""How well parameters are known: 95 % intervals, their consistency across blocks, and nuisances at their bounds.

Two standard deviations are computed and the larger is used: from the curvature of the fit, which relies on its noise
model, and from the scatter of the blocks (sandwich estimator), which relies only on the blocks being independent.
Holdout blocks are not used. An effect is added to a model and replaces what recalibration may move; what the
calibration does not know about that adds to the interval of the effect.

An effect that exists has the same parameters in all blocks. One that stands in for another cause does not, and neither
does a nuisance that compensates for a missing effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, stdtrit

from tunefree_hil.gap.estimation.evidence import MIN_EVIDENCE_NATS
from tunefree_hil.gap.estimation.least_squares import Fit, FreeParameter, is_free, sum_equations
from tunefree_hil.gap.estimation.nuisance import DAILY_EFFECTS, DRIFT_SIGMAS
from tunefree_hil.gap.model.graph import load_catalogue

Array = np.ndarray


class IntervalCriteria(NamedTuple):
    """Limits for intervals and consistency (docs/results/criteria.md)."""

    # of an effect's size, by which its parameter may differ between blocks: no model is exact
    max_inconsistency_share: float = 0.05
    frame_jitter_s: float = 0.002  # jitter of frames: no delay is more consistent than that
    chance_level: float = 0.999  # quantile of chi squared, up to which blocks are taken to differ by chance only
    # scatter between blocks over the drift from day to day, up to which a parameter is consistent; a car with other
    # pedals than its model reaches 1.1
    max_drift_ratio: float = 1.5
    # standard deviation, of the distance from neutral: no car has an effect exactly in the form of the catalogue
    form_share: float = 0.01
    # standard deviations, of the 2 that are allowed, from which a nuisance is at its bound
    at_bound_sigmas: float = 1.8


CRITERIA = IntervalCriteria()
# How far throttle, brake and steering follow their commands. They may drift from day to day, but not between blocks
GAINS = ("throttle_gain.gain_frac", "brake_gain.gain_frac", "steer_gain.gain_frac")
SLOPE_STEP_U = 0.01  # half the step by which the derivative of a value by u is taken
MIN_BLOCK_INFORMATION = 1e-9  # of the most informative block: blocks with less are not used
UPPER_QUANTILE = 0.975  # of Student's t distribution, for a 95 % interval


class ParameterEstimate(NamedTuple):
    """A parameter of an effect with its 95 % interval, all in `unit`."""

    value: float
    low: float
    high: float
    unit: str


class BlockInconsistency(NamedTuple):
    """Scatter of an effect's first parameter between blocks, beyond noise; 0 where chance explains it.

    Args:
        key: of the parameter
        std_u: standard deviation, in u
        share: of the distance from neutral; of a factor without a neutral value, of itself
    """

    key: str
    std_u: float
    share: float


class AtBound(NamedTuple):
    """A nuisance at its bound.

    Args:
        key: of the parameter
        z: where it is, in standard deviations
        nats: log likelihood that moving it further would gain, with the others free to follow
    """

    key: str
    z: float
    nats: float

    @property
    def text(self) -> str:
        """For reports."""
        return f"recalibration moves {self.key} by {self.z:+.1f} standard deviations"


class _BlockScores(NamedTuple):
    """Of one key by block, shape (n_blocks,): gradient of the log likelihood, and its curvature."""

    gradient: Array
    curvature: Array


def estimate_parameters(name: str, fit: Fit, blocks: Array) -> dict[str, ParameterEstimate]:
    """Estimate the parameters of one of a model's effects, by parameter name, from the blocks it was fitted on."""
    deviation, units, estimates = standard_deviations(fit, blocks), load_catalogue()[name].units, {}
    quantile = float(stdtrit(len(blocks) - 1, UPPER_QUANTILE))
    for free in fit.free:
        owner, _, parameter = free.key.partition(".")
        if owner == name:
            i = fit.keys.index(free.key)
            low, high = _interval(free, float(fit.z[i]), quantile * float(deviation[i]), quantile)
            estimates[parameter] = ParameterEstimate(fit.values[free.key], low, high, units[parameter])
    return estimates


def _interval(free: FreeParameter, u: float, half_width: float, quantile: float) -> tuple[float, float]:
    """Interval of a parameter at u, known within `half_width` of u by these logs, and as well as by its calibration.

    The doubt of the calibration is a share of a factor, and of what scales a constant of the model the doubt of that.
    """
    value = free.value_from_u(u)
    is_factor = free.is_logarithmic and free.neutral > 0.0
    doubt = quantile * free.calibration_sigma * (value / free.neutral if is_factor else 1.0)
    if free.constant_sigma:  # the neutral value of a limit is infinite
        doubt = float(np.hypot(doubt, quantile * free.constant_sigma * (value - free.neutral)))
    half_width = float(np.hypot(half_width, quantile * CRITERIA.form_share * distance_to_neutral(free, u)))
    ends = [free.value_from_u(float(np.clip(u + side * half_width, free.u_min, free.u_max))) for side in (-1.0, 1.0)]
    low = value - float(np.hypot(value - min(ends), doubt))
    high = value + float(np.hypot(max(ends) - value, doubt))
    return max(low, free.value_from_u(free.u_min)), min(high, free.value_from_u(free.u_max))


def standard_deviations(fit: Fit, blocks: Array) -> Array:
    """Of each key, shape (n_keys,): nuisances in standard deviations of their priors, free parameters in u."""
    by_curvature, by_blocks = _covariances(fit, blocks)
    return np.sqrt(np.maximum(np.diag(by_curvature), np.diag(by_blocks)))


def curvature_covariance(fit: Fit, blocks: Array) -> Array:
    """Covariance of the keys, shape (n_keys, n_keys), from the curvature: it relies on the noise model."""
    return _covariances(fit, blocks)[0]


def sandwich_covariance(fit: Fit, blocks: Array) -> Array:
    """Covariance of the keys, shape (n_keys, n_keys), from the scatter of the blocks' scores."""
    return _covariances(fit, blocks)[1]


def _covariances(fit: Fit, blocks: Array) -> tuple[Array, Array]:
    """From the curvature, and from the scatter of the blocks."""
    curvature = sum_equations(fit.equations, len(fit.keys), blocks).curvature
    flat = np.diag(2.0 * np.pi * is_free(fit.keys, fit.free))  # a uniform prior, as in `log_evidence`
    inverse = np.linalg.inv(curvature + fit.prior_precision + flat)
    scores = np.zeros((len(blocks), len(fit.keys)))
    for equations in fit.equations.values():
        scores[:, equations.columns] += equations.gradient[blocks] / equations.noise.correlation_rows
    scores = scores - scores.mean(axis=0)
    share = len(blocks) / max(len(blocks) - 1, 1)
    return inverse, inverse @ (share * scores.T @ scores) @ inverse


def estimates_across_blocks(fit: Fit, blocks: Array) -> dict[str, tuple[float, float]]:
    """Value and standard deviation of each free key, in its unit.

    The deviation is that of the fit, and the scatter between blocks, be they of one drive or of several.
    """
    deviations, estimates = standard_deviations(fit, blocks), {}
    for free in fit.free:
        i = fit.keys.index(free.key)
        u = float(fit.z[i])
        total = float(np.hypot(deviations[i], _excess_scatter(_block_scores(fit, i, blocks), np.zeros(len(blocks)))))
        change = abs(free.value_from_u(u + SLOPE_STEP_U) - free.value_from_u(u - SLOPE_STEP_U))
        estimates[free.key] = (fit.values[free.key], total * (change / (2.0 * SLOPE_STEP_U)))
    return estimates


def block_inconsistency(fit: Fit, name: str, blocks: Array, drives: Array) -> BlockInconsistency:
    """Scatter of one of a model's effects between the blocks of a drive.

    It is 0 also where the same parameter scatters no less in a model that lacks nothing.

    Args:
        drives: the drive of each block
    """
    free = next(parameter for parameter in fit.free if parameter.key.partition(".")[0] == name)
    i = fit.keys.index(free.key)
    u, scatter = float(fit.z[i]), _scatter_within_drives(fit, i, blocks, drives)
    is_time = load_catalogue()[name].units[free.key.partition(".")[2]] == "s"
    is_jitter = is_time and abs(free.value_from_u(u + scatter) - free.value_from_u(u)) < CRITERIA.frame_jitter_s
    if is_jitter or scatter <= CRITERIA.max_drift_ratio * _sigma_in_u(free, u, free.drift_sigma):
        return BlockInconsistency(free.key, 0.0, 0.0)
    return BlockInconsistency(free.key, scatter, scatter / max(distance_to_neutral(free, u), 1e-9))


def inconsistent_gains(fit: Fit, blocks: Array, drives: Array, sigmas: Mapping[str, float]) -> dict[str, float]:
    """Recalibrated gains that scatter between blocks: by key, the ratio of the scatter to the drift.

    Args:
        drives: the drive of each block
        sigmas: prior standard deviation of each key
    """
    keys = [key for key in GAINS if key in fit.keys]
    unit = {key: sigmas.get(key, DRIFT_SIGMAS[key]) / DRIFT_SIGMAS[key] for key in keys}
    ratios = {key: unit[key] * _scatter_within_drives(fit, fit.keys.index(key), blocks, drives) for key in keys}
    return {key: ratio for key, ratio in ratios.items() if ratio > CRITERIA.max_drift_ratio}


def inconsistent_daily_effects(fit: Fit, blocks: Array, drives: Array) -> dict[str, float]:
    """Recalibrated effects of the day that differ between drives: by key, the scatter in prior standard deviations.

    The fit has one value for all drives.
    """
    ratios, drive_numbers = {}, np.unique(drives)
    for i, key in enumerate(fit.keys[: len(fit.keys) - len(fit.free)]):
        if key.partition(".")[0] in DAILY_EFFECTS and len(drive_numbers) > 1:
            sums = [
                np.array([float(values[drives == drive].sum()) for drive in drive_numbers])
                for values in _block_scores(fit, i, blocks)
            ]
            ratios[key] = _excess_scatter(_BlockScores(*sums), np.zeros(len(drive_numbers)))
    return {key: ratio for key, ratio in ratios.items() if ratio > CRITERIA.max_drift_ratio}


def _scatter_within_drives(fit: Fit, i: int, blocks: Array, drives: Array) -> float:
    """Standard deviation of key i between the blocks of a drive, beyond noise, in its own unit; 0 for chance.

    Drives may be days apart, so they may differ. What all blocks of a drive have in common is no scatter, as where a
    key is at its bound. A block estimates gradient / curvature, with the deviation 1 / sqrt(curvature): the test for
    chance uses all blocks so weighted; the scatter is mostly that of the informative ones.
    """
    return _excess_scatter(_block_scores(fit, i, blocks), drives)


def _excess_scatter(scores: _BlockScores, groups: Array) -> float:
    """Standard deviation, within its group, of what blocks estimate, beyond chance. groups: of each block."""
    gradient, curvature = scores
    is_informative = curvature > MIN_BLOCK_INFORMATION * float(curvature.max(initial=0.0))
    chi_squared, degrees, excess, weight = 0.0, 0, 0.0, 0.0
    for group in np.unique(groups[is_informative]):
        in_group = is_informative & (groups == group)
        w, p = curvature[in_group], gradient[in_group]
        total = float(w.sum())
        p = p - w * float(p.sum()) / total
        chi_squared += float(np.sum(p * p / w))
        degrees += len(w) - 1
        excess += float(p @ p) - float(np.sum(w - w * w / total))
        weight += float(np.sum(w * w * (1.0 - 2.0 * w / total + float(w @ w) / total**2)))
    if degrees < 1 or chi_squared <= float(chdtri(degrees, 1.0 - CRITERIA.chance_level)) or weight <= 0.0:
        return 0.0
    return max(excess / weight, 0.0) ** 0.5


def _block_scores(fit: Fit, i: int, blocks: Array) -> _BlockScores:
    """Of key i, summed over all targets."""
    gradient, curvature = np.zeros(len(blocks)), np.zeros(len(blocks))
    for equations in fit.equations.values():
        for c in np.flatnonzero(equations.columns == i):
            gradient += equations.gradient[blocks, c] / equations.noise.correlation_rows
            curvature += equations.curvature[blocks, c, c] / equations.noise.correlation_rows
    return _BlockScores(gradient, curvature)


def _sigma_in_u(free: FreeParameter, u: float, sigma: float) -> float:
    """A standard deviation in the parameter's unit at neutral (of a factor: a share), converted to u at u."""
    if not free.is_logarithmic:
        return sigma / (free.high - free.low)
    value = free.neutral if 0.0 < free.neutral < np.inf else free.value_from_u(u)
    return sigma / value / float(np.log(free.high / free.low))


def distance_to_neutral(free: FreeParameter, u: float) -> float:
    """Distance in u; of a logarithmic parameter without a neutral value on its scale, a factor of e."""
    if not free.is_logarithmic:
        return abs(u - free.u_from_value(free.neutral))
    is_on_scale = 0.0 < free.neutral < np.inf
    return abs(u - free.u_from_value(free.neutral)) if is_on_scale else 1.0 / float(np.log(free.high / free.low))


def find_parameters_at_bound(fit: Fit, blocks: Array) -> list[AtBound]:
    """Nuisances at their bounds that would gain more than MIN_EVIDENCE_NATS beyond them, largest gain first.

    The gain is that of the quadratic of the fit and is not simulated: far beyond its bound a parameter may act
    differently.
    """
    form = sum_equations(fit.equations, len(fit.keys), blocks)
    curvature, gradient = form.curvature + fit.prior_precision, form.gradient + fit.prior_precision @ fit.z
    n_nuisances = len(fit.keys) - len(fit.free)
    is_loose = np.ones(len(fit.keys), dtype=bool)
    is_loose[:n_nuisances] = np.abs(fit.z[:n_nuisances]) <= CRITERIA.at_bound_sigmas
    at_bound = []
    for i in np.flatnonzero(~is_loose):
        moving = np.append(np.flatnonzero(is_loose), i)
        variance = np.linalg.pinv(curvature[np.ix_(moving, moving)])[-1, -1]
        nats = 0.5 * float(gradient[i] ** 2 * variance)
        if gradient[i] * fit.z[i] < 0.0 and nats > MIN_EVIDENCE_NATS:
            at_bound.append(AtBound(fit.keys[i], float(fit.z[i]), nats))
    return sorted(at_bound, key=lambda parameter: -parameter.nats)
