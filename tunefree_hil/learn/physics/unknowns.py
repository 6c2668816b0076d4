"""The least-squares problem of the physical constants: unknowns, residuals, shape constants, uncertainty.

Consecutive windows are of the same manoeuvre and share its model error. So stretches of several windows count as
independent, and the residuals of a stretch are corrected for its leverage on the fit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from tunefree_hil.learn.data_sheet import ConstantPrior
from tunefree_hil.learn.physics.windows import (
    N_TARGETS,
    TARGETS,
    FreeRunWindow,
    OutputCorrection,
    WindowSet,
    compute_errors,
    compute_target_rms,
)
from tunefree_hil.learn.robust_least_squares import (
    COLD_START_MARGIN,
    WARM_START_MARGIN,
    RobustFit,
    SolverOptions,
    fit_robustly,
)
from tunefree_hil.plant.constants import LEAST

Array = np.ndarray

# Unknowns that are parameters of effects (docs/reference/effects.md) and not of the plant: no report shows them.
STEER_OFFSET, BRAKE_DEAD_BAND, POWERTRAIN_LAG = "steer_offset_rad", "brake_dead_band_frac", "powertrain_lag_s"
STEER_OFFSET_UNCERTAINTY_RAD = 0.1
BRAKE_DEAD_BAND_UNCERTAINTY = 0.2  # share of brake travel
POWERTRAIN_LAG_UNCERTAINTY_S = 0.5  # engine and gearbox: 0.1 to 0.5 s
# An unknown of the logs: the share of the constant accelerometer offset that is a slope of the road.
ROAD_SHARE, ROAD_SHARE_UNCERTAINTY = "road_share", 2.0


class FittedEffect(NamedTuple):
    """The effect that an unknown stands for, its parameter, and the value below which it is negligible."""

    effect: str
    param: str
    negligible: float


FITTED_EFFECTS = {
    STEER_OFFSET: FittedEffect("steer_offset", "offset_rad", 0.005),
    BRAKE_DEAD_BAND: FittedEffect("brake_dead_band", "half_width_frac", 0.002),
    POWERTRAIN_LAG: FittedEffect("powertrain_lag", "tau_s", 0.02),
}
LATERAL_CONSTANTS = (
    "front_stiffness_n_per_rad",
    "rear_stiffness_n_per_rad",
    "yaw_inertia_kgm2",
    "steer_ratio",
    "linkage_bend",
    STEER_OFFSET,
)
MIN_CONSTANTS = {BRAKE_DEAD_BAND: 0.0, POWERTRAIN_LAG: 0.0, "overrun_force_n": 0.0, **LEAST}
INITIAL_ERROR_SCALES = {
    "speed_mps": 0.2,
    "yaw_rate_radps": 0.01,
    "heading_rad": 0.02,
    "lateral_accel_mps2": 0.3,
    "x_m": 0.7,
    "y_m": 0.7,
}
# Fitted only where they reduce the speed error: otherwise they would only widen the intervals of the other constants.
SHAPE_CONSTANTS = ("drive_corner", "overrun_force_n", "brake_rise_per_frac", POWERTRAIN_LAG)
NO_IMPROVEMENT = "it reduces the squared speed error by less than a tenth, or by no more than chance"


class ProblemCriteria(NamedTuple):
    """Weights and limits of the fit (docs/results/criteria.md)."""

    independent_samples: float = 4.0  # of each target in a window of 8 s: errors within a window are correlated
    soft_l1_scale: float = 3.0  # standard deviations, from which on the loss grows linearly
    max_unknown: float = 6.0  # half uncertainties: three times the prior uncertainty
    min_scale_share: float = 0.02  # least error scale, as a share of the initial one: limits the weight of a target
    # of the squared speed error, by a shape constant; one that explains less only widens the intervals of the others
    min_error_reduction: float = 0.1
    windows_per_stretch: int = 3  # consecutive windows of the same manoeuvre
    min_stretches: int = 4  # with fewer each window counts as a stretch
    min_residual_share: float = 1e-6  # lower limit of 1 - leverage of a stretch


CRITERIA = ProblemCriteria()


class PhysicsProblem:
    """Free-run errors as a function of unknowns: the constants in half uncertainties, 0 being the prior value.

    Attributes:
        names: The unknowns that these windows can identify.
        priors: By name, of all unknowns.
        scale: Error of each target that counts as 1, shape (6,).
        is_measured: Which errors are measured, shape (n_windows * n_compared * 6,).
        blocks: Window of each measured error.
        stretches: Stretch of each measured error.
    """

    def __init__(
        self, windows: WindowSet, fixed: Mapping[str, float], known: Mapping[str, ConstantPrior], brake_travel: float
    ) -> None:
        self.windows = windows.windows
        self.fixed = dict(fixed)
        self.priors = {
            **known,
            STEER_OFFSET: ConstantPrior(0.0, STEER_OFFSET_UNCERTAINTY_RAD, False, False),
            BRAKE_DEAD_BAND: ConstantPrior(0.0, BRAKE_DEAD_BAND_UNCERTAINTY * brake_travel, False, False),
            POWERTRAIN_LAG: ConstantPrior(0.0, POWERTRAIN_LAG_UNCERTAINTY_S, False, False),
        }
        if any(window.sensed_slope for window in self.windows):
            self.priors[ROAD_SHARE] = ConstantPrior(0.0, ROAD_SHARE_UNCERTAINTY, False, False)
        names = list(self.priors)
        if "brake_force_n_per_frac" not in known:  # no brake, or no brake signal
            names.remove(BRAKE_DEAD_BAND)
        if "drive_force_n" not in known:  # commanded by acceleration: the lag belongs to that channel
            names.remove(POWERTRAIN_LAG)
        if not windows.is_steered:
            names = [name for name in names if name not in LATERAL_CONSTANTS]
        if not windows.has_pedals:
            names = [name for name in names if name in LATERAL_CONSTANTS]
        self.names = names
        self.scale = np.array([INITIAL_ERROR_SCALES[name] for name in TARGETS])
        self.is_measured = np.concatenate(
            [np.isfinite(window.targets).ravel() for window in self.windows] or [np.zeros(0, dtype=bool)]
        )
        self.n_compared = len(self.windows[0].rows) if self.windows else 0
        errors_per_window = self.n_compared * N_TARGETS
        self.blocks = np.repeat(np.arange(len(self.windows)), errors_per_window)[self.is_measured]
        self.stretches = np.repeat(assign_stretches(self.windows), errors_per_window)[self.is_measured]

    def constant_from_unknown(self, name: str, unknown: float) -> float:
        """The constant that an unknown stands for."""
        prior = self.priors[name]
        if prior.is_factor:
            return prior.value * math.exp(0.5 * unknown * math.log(prior.uncertainty))
        return prior.value + 0.5 * unknown * prior.uncertainty

    def min_unknown(self, name: str) -> float:
        """Lower limit of an unknown."""
        limit = -CRITERIA.max_unknown
        if name not in MIN_CONSTANTS:
            return limit
        prior = self.priors[name]
        return max(2.0 * (MIN_CONSTANTS[name] - prior.value) / prior.uncertainty, limit)

    def constants_from_unknowns(self, names: Sequence[str], x: Array) -> dict[str, float]:
        """All constants; those not in `names` at their prior values."""
        constants = {name: prior.value for name, prior in self.priors.items()}
        fitted = {name: self.constant_from_unknown(name, float(value)) for name, value in zip(names, x, strict=True)}
        return constants | fitted

    def params(self, constants: Mapping[str, float]) -> dict[str, float]:
        """[plant.params] in full."""
        not_plant = (*FITTED_EFFECTS, ROAD_SHARE)
        return self.fixed | {name: value for name, value in constants.items() if name not in not_plant}

    def errors(self, constants: Mapping[str, float]) -> Array:
        """Free-run errors, not scaled, shape (n_windows, n_compared, 6)."""
        correction = OutputCorrection(
            float(constants[STEER_OFFSET]),
            float(constants[BRAKE_DEAD_BAND]),
            float(constants.get(ROAD_SHARE, 0.0)),
            float(constants[POWERTRAIN_LAG]),
        )
        return compute_errors(self.params(constants), correction, self.windows)

    def residuals(self, names: Sequence[str], x: Array) -> Array:
        """Scaled errors, each window weighted as `independent_samples` numbers of each target; then the priors."""
        share = math.sqrt(CRITERIA.independent_samples / self.n_compared)
        rows = (self.errors(self.constants_from_unknowns(names, x)) / self.scale).ravel()[self.is_measured] * share
        return np.concatenate([np.nan_to_num(rows, nan=1e3, posinf=1e3, neginf=-1e3), x])

    def rescale(self, constants: Mapping[str, float]) -> None:
        """Set the scale of each target to its root mean square error with these constants."""
        for name, error in compute_target_rms(self.errors(constants)).items():
            floor = CRITERIA.min_scale_share * INITIAL_ERROR_SCALES[name]
            self.scale[TARGETS.index(name)] = max(error, floor)


def solve_problem(problem: PhysicsProblem, names: Sequence[str], x: Array, max_evaluations: int) -> RobustFit:
    """Fit the unknowns `names` from x; x all 0 is a cold start."""
    low = np.array([problem.min_unknown(name) for name in names])
    options = SolverOptions(
        soft_l1_scale=CRITERIA.soft_l1_scale * math.sqrt(CRITERIA.independent_samples / problem.n_compared),
        max_evaluations=max_evaluations,
        n_priors=len(names),
        start_margin=WARM_START_MARGIN if x.any() else COLD_START_MARGIN,
    )
    bounds = low, np.full(len(names), CRITERIA.max_unknown)
    return fit_robustly(partial(problem.residuals, names), x, bounds, problem.blocks, options)


def add_shape_constants(problem: PhysicsProblem, plain: list[str], fit: RobustFit) -> tuple[list[str], RobustFit]:
    """Add those SHAPE_CONSTANTS that reduce the speed error, and fit again.

    All are added together first, then each is left out in turn, because some reduce the error only together.
    """
    tried = [name for name in SHAPE_CONSTANTS if name in problem.names]
    if not tried:
        return plain, fit
    names = [*plain, *tried]
    full = solve_problem(problem, names, np.zeros(len(names)), 25)
    if not reduces_error(_squared_speed_errors(problem, plain, fit), _squared_speed_errors(problem, names, full)):
        return plain, fit
    for shape in tried:
        fewer = [name for name in names if name != shape]
        without = solve_problem(problem, fewer, np.delete(full.x, names.index(shape)), 15)
        squares = _squared_speed_errors(problem, fewer, without)
        if not reduces_error(squares, _squared_speed_errors(problem, names, full)):
            names, full = fewer, without
    problem.rescale(problem.constants_from_unknowns(names, full.x))
    return names, solve_problem(problem, names, full.x, 15)


def reduces_error(before: Array, after: Array) -> bool:
    """Whether squared errors by stretch fall by min_error_reduction and by more than one standard error.

    Returns:
        False for a single stretch, which has no scatter.
    """
    gain = before - after
    if len(gain) < 2:
        return False
    standard_error = float(np.std(gain, ddof=1)) / math.sqrt(len(gain))
    return float(gain.mean()) > max(CRITERIA.min_error_reduction * float(before.mean()), standard_error)


def _squared_speed_errors(problem: PhysicsProblem, names: Sequence[str], fit: RobustFit) -> Array:
    """Mean squared speed error of each stretch with a measured speed."""
    errors = problem.errors(problem.constants_from_unknowns(names, fit.x))[:, :, TARGETS.index("speed_mps")]
    stretches = assign_stretches(problem.windows)
    squares = (errors[stretches == stretch] ** 2 for stretch in np.unique(stretches))
    return np.array([np.nanmean(square) for square in squares if np.isfinite(square).any()])


class EstimateCorrelation(NamedTuple):
    """Correlation of the errors of fitted constants (of the logarithm of a factor), shape (n_names, n_names)."""

    names: tuple[str, ...] = ()
    correlation: Array = np.zeros((0, 0))


def compute_remaining_uncertainty(fit: RobustFit) -> Array:
    """Uncertainty of each unknown after the fit (1 before), widened by the scatter between windows."""
    covariance = np.linalg.pinv(fit.jacobian.T @ fit.jacobian, hermitian=True)
    return np.maximum(np.sqrt(np.maximum(np.diag(covariance), 0.0)), fit.std_dev)


def assign_stretches(windows: Sequence[FreeRunWindow]) -> Array:
    """Stretch of each window: `windows_per_stretch` consecutive windows of a drive; one window each where few."""
    stretches, stretch, count = np.zeros(len(windows), dtype=int), -1, 0
    for i, window in enumerate(windows):
        if i == 0 or window.name != windows[i - 1].name or count == CRITERIA.windows_per_stretch:
            stretch, count = stretch + 1, 0
        stretches[i], count = stretch, count + 1
    return stretches if stretch + 1 >= CRITERIA.min_stretches else np.arange(len(windows))


def compute_interval_half_widths(fit: RobustFit, stretches: Array) -> Array:
    """Half of each unknown's 95 % interval (1: one standard deviation of the prior).

    The residuals of a stretch understate its error, the more so the more it determines the fit. They are corrected by
    the leverage of the stretch (Bell and McCaffrey 2002, "Bias reduction in standard errors for linear regression with
    multi-stage samples").

    Args:
        fit: The fit.
        stretches: Stretch of each data residual, shape (n_data,).
    """
    influences = _stretch_influences(fit, stretches)
    count = len(influences)
    scatter = np.sqrt(np.sum(influences * influences, axis=0) * (count / (count - 1)))
    half = float(student.ppf(0.975, count - 1)) * scatter
    return np.minimum(np.maximum(half, fit.quantile * compute_remaining_uncertainty(fit)), fit.quantile)


def estimate_correlation(names: Sequence[str], fit: RobustFit, stretches: Array) -> EstimateCorrelation:
    """Correlation of the unknowns: the mean of that by the curvature of the fit and that between stretches.

    The curvature shows which unknowns are only known as a sum. The few stretches show the model error, but also
    correlation by chance.
    """
    influences = _stretch_influences(fit, stretches)
    covariance = np.linalg.pinv(fit.jacobian.T @ fit.jacobian, hermitian=True)
    mean = 0.5 * (_correlation_from_covariance(covariance) + _correlation_from_covariance(influences.T @ influences))
    return EstimateCorrelation(tuple(names), mean)


def _correlation_from_covariance(covariance: Array) -> Array:
    std_dev = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    correlation = covariance / np.outer(std_dev, std_dev)
    np.fill_diagonal(correlation, 1.0)
    return correlation


def _stretch_influences(fit: RobustFit, stretches: Array) -> Array:
    """Shift of the unknowns by each stretch, with leverage-corrected residuals, shape (n_stretches, n_unknowns)."""
    covariance = np.linalg.pinv(fit.jacobian.T @ fit.jacobian, hermitian=True)
    root = np.linalg.cholesky(covariance)
    labels = np.unique(stretches)
    influences = np.zeros((len(labels), len(covariance)))
    for i, label in enumerate(labels):
        rows = np.flatnonzero(stretches == label)
        jacobian, residuals = fit.jacobian[rows], fit.residuals[rows]
        basis, size, _ = np.linalg.svd(jacobian @ root, full_matrices=False)
        more = 1.0 / np.sqrt(np.maximum(1.0 - size * size, CRITERIA.min_residual_share)) - 1.0
        influences[i] = covariance @ (jacobian.T @ (residuals + basis @ (more * (basis.T @ residuals))))
    return influences
