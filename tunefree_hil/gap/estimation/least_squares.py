"""The least-squares problem of a fit: parameters, Jacobian, normal equations by target and block, and bounded steps.

Nuisances (gap/estimation/nuisance.py) are counted in standard deviations of their priors, free parameters in u, which
is 0 and 1 at the ends of their priors. Residuals are whitened and in units of the noise, so that half their squared sum
is a negative log likelihood.

Steps are minima of a convex quadratic within bounds, found by active sets. Nuisances may reach MAX_SIGMA each. Where
the calibration logs were used as a prior (gap/estimation/calibration_priors.py), combinations of nuisances that are
known better than each of them are bounded as well: the joint bounds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.estimation.noise import NoiseModel
from tunefree_hil.gap.estimation.nuisance import Nuisance
from tunefree_hil.gap.estimation.residuals import ResidualModel, Residuals
from tunefree_hil.gap.measured.blocks import HOLDOUT

Array = np.ndarray

FREE_STEP_U = 0.02  # step of a free parameter for finite differences, in u
NUISANCE_STEP_SIGMA = 0.5  # step of a nuisance, in standard deviations
MIN_RELATIVE_CHANGE = 1e-9  # of a target's largest residual: a smaller change is none
MAX_SIGMA = 2.0  # standard deviations that recalibration may move a nuisance
# Standard deviations along a joint bound. Without it, five logs of unchanged cars moved 1.6 to 3.3, and a throttle that
# gave a tenth less 4.8: recalibration then hid that effect.
MAX_JOINT_SIGMA = 3.0
MAX_JOINT_VARIANCE = 0.9  # a direction has a joint bound if its variance, of parameters of variance 1, is below this
JOINT_BOUND_STIFFNESS = 1e4  # stiffness of a joint bound, times what the data know of its direction
JOINT_BOUND_SLACK = 1.05  # of MAX_JOINT_SIGMA: a bound of that stiffness may give way so far
MAX_CLAMP_TURNS = 6
TURNS_PER_PARAMETER = 4  # turns of an active-set step, for each of its parameters
RELEASE_TOLERANCE = 1e-9  # of the largest gradient: a smaller pull releases no bound
CURVATURE_FLOOR = 1e-6  # added to every curvature: a parameter that the data do not depend on stays where it is


class FreeParameter(NamedTuple):
    """A parameter that is searched, with u = 0 at `low` and u = 1 at `high` of its prior.

    Args:
        key: as the simulation takes it
        low: lower end of the prior
        high: upper end of the prior
        is_logarithmic: u is proportional to the logarithm
        neutral: value without effect
        u_min: lower end of the search, beyond the prior where that makes sense
        u_max: upper end of the search
        calibration_sigma: doubt of the model's own calibration of it, in its unit at neutral
        constant_sigma: relative doubt of the model's constant that scales the parameter
        drift_sigma: change from day to day, in its unit at neutral
    """

    key: str
    low: float
    high: float
    is_logarithmic: bool
    neutral: float
    u_min: float
    u_max: float
    calibration_sigma: float = 0.0
    constant_sigma: float = 0.0
    drift_sigma: float = 0.0

    def value_from_u(self, u: float) -> float:
        """The value at u."""
        if self.is_logarithmic:
            return self.low * (self.high / self.low) ** u
        return self.low + u * (self.high - self.low)

    def u_from_value(self, value: float) -> float:
        """u of a value."""
        if self.is_logarithmic:
            return math.log(max(value, 1e-300) / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


class NormalEquations(NamedTuple):
    """Normal equations of a target by block, of whitened residuals r with Jacobian J in units of the noise.

    Args:
        columns: numbers of the keys that the target depends on, shape (n_columns,)
        squared_residuals: r'r, shape (n_blocks,)
        gradient: J'r, shape (n_blocks, n_columns)
        curvature: J'J, shape (n_blocks, n_columns, n_columns)
        row_counts: shape (n_blocks,)
        noise: the noise model by which residuals are whitened
    """

    columns: Array
    squared_residuals: Array
    gradient: Array
    curvature: Array
    row_counts: Array
    noise: NoiseModel


class Fit(NamedTuple):
    """A fitted model.

    Args:
        name: of the effect that it was fitted for; "" for recalibration alone
        keys: parameters that were moved; the free ones are the last
        z: their solution, shape (n_keys,): nuisances in standard deviations, free parameters in u
        free: the free parameters
        values: as the simulation takes them
        prior_precision: of the nuisances, 0 for free parameters, shape (n_keys, n_keys)
        equations: normal equations at the solution, by target
        residuals: at the solution
    """

    name: str
    keys: tuple[str, ...]
    z: Array
    free: tuple[FreeParameter, ...]
    values: dict[str, float]
    prior_precision: Array
    equations: dict[str, NormalEquations]
    residuals: Residuals


class Jacobian(NamedTuple):
    """Derivatives of residuals by keys: by target the column numbers (c,), and one array (n_rows, c) a drive."""

    by_target: dict[str, tuple[Array, list[Array]]]


class QuadraticForm(NamedTuple):
    """Sum of normal equations: curvature (n_keys, n_keys), gradient (n_keys,), squared residuals."""

    curvature: Array
    gradient: Array
    squared_residuals: float


class LeastSquaresProblem:
    """Fits of one problem.

    Args:
        nuisances: what recalibration may move, in this order
        correlation: of their priors, shape (n_nuisances, n_nuisances); None for none
        has_calibration_prior: the calibration logs are in the priors: then there are joint bounds
    """

    def __init__(
        self,
        residual_model: ResidualModel,
        nuisances: Sequence[Nuisance],
        correlation: Array | None = None,
        *,
        has_calibration_prior: bool = False,
    ) -> None:
        self.residual_model, self._has_joint_bounds = residual_model, has_calibration_prior
        self._joint_bounds: dict[tuple[str, ...], Array] = {}
        self.nuisances = {nuisance.key: nuisance for nuisance in nuisances}
        self._correlation = np.eye(len(nuisances)) if correlation is None else correlation

    def prior_precision(self, keys: Sequence[str], free: Sequence[FreeParameter]) -> Array:
        """Precision of the priors, shape (n_keys, n_keys); 0 for free parameters, whose priors are uniform."""
        free_mask = is_free(keys, free)
        index = {key: i for i, key in enumerate(self.nuisances)}
        rows = [index[key] for key, free_key in zip(keys, free_mask, strict=True) if not free_key]
        precision = np.zeros((len(keys), len(keys)))
        precision[np.ix_(~free_mask, ~free_mask)] = np.linalg.inv(self._correlation[np.ix_(rows, rows)])
        return precision

    def joint_bounds(self, keys: Sequence[str], free: Sequence[FreeParameter]) -> Array:
        """Directions of z that are known better than each parameter, shape (n_bounds, n_keys).

        Along each, z must stay within MAX_JOINT_SIGMA of zero.
        """
        free_mask = is_free(keys, free)
        bounded_keys = tuple(key for key, free_key in zip(keys, free_mask, strict=True) if not free_key)
        if bounded_keys not in self._joint_bounds:
            index = {key: i for i, key in enumerate(self.nuisances)}
            rows = [index[key] for key in bounded_keys]
            variance, directions = np.linalg.eigh(self._correlation[np.ix_(rows, rows)])
            is_tight = variance < (MAX_JOINT_VARIANCE if self._has_joint_bounds else 0.0)
            self._joint_bounds[bounded_keys] = (directions[:, is_tight] / np.sqrt(variance[is_tight])).T
        bounds = np.zeros((len(self._joint_bounds[bounded_keys]), len(keys)))
        bounds[:, ~free_mask] = self._joint_bounds[bounded_keys]
        return bounds

    def parameter_values(self, keys: Sequence[str], z: Array, free: Sequence[FreeParameter]) -> dict[str, float]:
        """Values at z as the simulation takes them."""
        by_key = {parameter.key: parameter for parameter in free}
        values = {}
        for key, coordinate in zip(keys, z, strict=True):
            if key in by_key:
                values[key] = by_key[key].value_from_u(float(coordinate))
            else:
                nuisance = self.nuisances[key]
                values[key] = nuisance.neutral + nuisance.sigma * float(coordinate)
        return values

    def jacobian(
        self, keys: Sequence[str], z: Array, free: Sequence[FreeParameter], columns: Sequence[int], residuals: Residuals
    ) -> Jacobian:
        """Finite differences, one simulation for each column.

        Args:
            columns: numbers of the keys to differentiate by
            residuals: at z
        """
        by_key = {parameter.key: parameter for parameter in free}
        shifted: list[Residuals] = []
        steps = []
        for i in columns:
            step = NUISANCE_STEP_SIGMA
            if keys[i] in by_key:
                step = FREE_STEP_U if z[i] + FREE_STEP_U <= by_key[keys[i]].u_max else -FREE_STEP_U
            shifted_z = z.copy()
            shifted_z[i] += step
            shifted.append(self.residual_model.simulate_residuals(self.parameter_values(keys, shifted_z, free)))
            steps.append(step)
        by_target = {}
        for name, target_residuals in residuals.items():
            derivatives = [
                [(moved[name][d] - target_residuals[d]) / step for d in range(len(target_residuals))]
                for moved, step in zip(shifted, steps, strict=True)
            ]
            by_target[name] = _stack_columns(columns, derivatives, target_residuals)
        return Jacobian(by_target)

    def normal_equations(
        self, residuals: Residuals, jacobian: Jacobian, noise_models: Mapping[str, NoiseModel]
    ) -> dict[str, NormalEquations]:
        """Normal equations of all targets."""
        return {
            name: self.target_equations(name, residuals[name], jacobian.by_target[name], noise_models[name])
            for name in residuals
        }

    def target_equations(
        self, name: str, residual: list[Array], derivatives: tuple[Array, list[Array]], noise: NoiseModel
    ) -> NormalEquations:
        """Normal equations of a target. derivatives: its part of the Jacobian."""
        columns, pieces = derivatives
        joint = [np.column_stack([r, s]) for r, s in zip(residual, pieces, strict=True)]
        rows, blocks = self.residual_model.whiten(name, joint, noise)
        count, width = self.residual_model.blocks.count, rows.shape[1]
        products = np.zeros((count, width, width))
        for b in np.unique(blocks):
            block_rows = rows[blocks == b]
            products[b] = block_rows.T @ block_rows
        row_counts = np.bincount(blocks, minlength=count).astype(float)
        return NormalEquations(columns, products[:, 0, 0], products[:, 0, 1:], products[:, 1:, 1:], row_counts, noise)

    def noise_models(self, residuals: Residuals) -> dict[str, NoiseModel]:
        """Noise models estimated from these residuals, by target."""
        return {name: self.residual_model.estimate_noise(name, pieces) for name, pieces in residuals.items()}

    def non_holdout_blocks(self) -> Array:
        """Numbers of the blocks for fitting and selection."""
        return np.flatnonzero(self.residual_model.blocks.roles != HOLDOUT)


def _stack_columns(
    columns: Sequence[int], derivatives: list[list[Array]], residual: list[Array]
) -> tuple[Array, list[Array]]:
    """Columns that the target depends on, and their derivatives, one array (n_rows, c) a drive."""
    size = max(max(float(np.abs(piece).max()) for piece in residual), 1e-12)
    used = [
        c
        for c, derivative in enumerate(derivatives)
        if max(float(np.abs(piece).max()) for piece in derivative) > MIN_RELATIVE_CHANGE * size
    ]
    pieces = [
        np.stack([derivatives[c][d] for c in used], axis=1) if used else np.zeros((len(residual[d]), 0))
        for d in range(len(residual))
    ]
    return np.array([columns[c] for c in used], dtype=np.int64), pieces


def is_free(keys: Sequence[str], free: Sequence[FreeParameter]) -> Array:
    """Which keys are free parameters, shape (n_keys,); the others are nuisances."""
    free_keys = {parameter.key for parameter in free}
    return np.array([key in free_keys for key in keys], dtype=bool)


def sum_equations(equations: Mapping[str, NormalEquations], n_keys: int, blocks: Array) -> QuadraticForm:
    """Sum normal equations over targets and blocks, each target divided by its correlation rows."""
    curvature, gradient, squared = np.zeros((n_keys, n_keys)), np.zeros(n_keys), 0.0
    for target in equations.values():
        scale = 1.0 / target.noise.correlation_rows
        columns = target.columns
        curvature[np.ix_(columns, columns)] += scale * target.curvature[blocks].sum(axis=0)
        gradient[columns] += scale * target.gradient[blocks].sum(axis=0)
        squared += scale * float(target.squared_residuals[blocks].sum())
    return QuadraticForm(curvature, gradient, squared)


def penalised_cost(equations: Mapping[str, NormalEquations], z: Array, prior_precision: Array, blocks: Array) -> float:
    """Squared residuals in units of the noise, and the squared deviation from the priors."""
    squared = sum(
        float(target.squared_residuals[blocks].sum()) / target.noise.correlation_rows for target in equations.values()
    )
    return squared + float(z @ prior_precision @ z)


class Reference(NamedTuple):
    """Residuals with their normal equations, which hold for a target as long as its residuals are unchanged."""

    residuals: Residuals
    equations: Mapping[str, NormalEquations]


def sum_squared_residuals(
    problem: LeastSquaresProblem,
    residuals: Residuals,
    noise_models: Mapping[str, NoiseModel],
    reference: Reference,
    blocks: Array,
) -> float:
    """Squared residuals in units of the noise; those of targets that did not change are taken from `reference`."""
    total = 0.0
    for name, pieces in residuals.items():
        noise = noise_models[name]
        if all(np.array_equal(a, b) for a, b in zip(pieces, reference.residuals[name], strict=True)):
            total += float(reference.equations[name].squared_residuals[blocks].sum()) / noise.correlation_rows
            continue
        rows, row_blocks = problem.residual_model.whiten(name, pieces, noise)
        total += float(np.sum(rows[np.isin(row_blocks, blocks)] ** 2)) / noise.correlation_rows
    return total


class Bounds(NamedTuple):
    """Smallest and largest z of each key, each of shape (n_keys,)."""

    low: Array
    high: Array


def key_bounds(keys: Sequence[str], free: Sequence[FreeParameter]) -> Bounds:
    """Bounds of each key by itself."""
    by_key = {parameter.key: parameter for parameter in free}
    low = np.array([by_key[key].u_min if key in by_key else -MAX_SIGMA for key in keys])
    high = np.array([by_key[key].u_max if key in by_key else MAX_SIGMA for key in keys])
    return Bounds(low, high)


def step_within_joint_bounds(curvature: Array, gradient: Array, z: Array, bounds: Bounds, joint_bounds: Array) -> Array:
    """Step to the minimum of a convex quadratic within bounds and joint bounds.

    The joint bound that is exceeded most is made active, one after the other, and released where the rest pulls it
    back inside. Where that does not end, the last result is shrunk inside (`shrink_inside_joint_bounds`).

    Args:
        curvature: shape (n_keys, n_keys)
        gradient: at z, shape (n_keys,)
        z: start, shape (n_keys,)
        joint_bounds: directions along which |z| is at most MAX_JOINT_SIGMA, shape (n_joint_bounds, n_keys)
    """
    along = np.einsum("wi,ij,wj->w", joint_bounds, curvature, joint_bounds)
    stiffness = JOINT_BOUND_STIFFNESS * (1.0 + along / np.sum(joint_bounds**2, axis=1) ** 2)
    side = np.zeros(len(joint_bounds))  # -1 or 1 of the active ones
    for _ in range(TURNS_PER_PARAMETER * len(joint_bounds) + 1):
        weight = stiffness * np.abs(side)
        pull = gradient + joint_bounds.T @ (weight * (joint_bounds @ z - MAX_JOINT_SIGMA * side))
        step = step_within_bounds(curvature + (joint_bounds.T * weight) @ joint_bounds, pull, z, bounds)
        distance = joint_bounds @ (z + step)
        inward = np.where(side != 0.0, MAX_JOINT_SIGMA - distance * side, 0.0)
        beyond = np.where(side == 0.0, np.abs(distance) - MAX_JOINT_SIGMA, 0.0)
        if inward.max(initial=0.0) > 0.0:
            side[int(np.argmax(inward))] = 0.0
        elif beyond.max(initial=0.0) > 0.0:
            worst = int(np.argmax(beyond))
            side[worst] = np.sign(distance[worst])
        else:
            break
    return shrink_inside_joint_bounds(z + step, joint_bounds) - z


def shrink_inside_joint_bounds(z: Array, joint_bounds: Array) -> Array:
    """z, or where it clearly exceeds a joint bound, z with all parameters of such bounds shrunk towards zero.

    What was within its own bounds stays within them.
    """
    excess = float(np.abs(joint_bounds @ z).max(initial=0.0)) / MAX_JOINT_SIGMA
    return np.where((joint_bounds != 0.0).any(axis=0), z / excess, z) if excess > JOINT_BOUND_SLACK else z


def step_within_bounds(curvature: Array, gradient: Array, z: Array, bounds: Bounds) -> Array:
    """Step to the minimum of a convex quadratic within bounds, by an active set.

    A key that would leave its bounds is clamped, and released where the rest, once it has moved, pulls it back.

    Args:
        curvature: shape (n_keys, n_keys)
        gradient: at z, shape (n_keys,)
        z: start, shape (n_keys,)
    """
    curvature, lowest, highest = curvature + CURVATURE_FLOOR * np.eye(len(z)), bounds.low - z, bounds.high - z
    step, clamped = _clamp_in_turn(curvature, gradient, lowest, highest)
    tolerance = RELEASE_TOLERANCE * (1.0 + float(np.abs(gradient).max(initial=0.0)))
    for _ in range(TURNS_PER_PARAMETER * len(z)):
        loose = ~clamped
        pull = -(gradient + curvature @ step)
        move = np.zeros(len(z))
        move[loose] = np.linalg.solve(curvature[np.ix_(loose, loose)], pull[loose])
        end, is_moving = np.where(move > 0.0, highest, lowest), move != 0.0
        room = np.full(len(z), np.inf)
        room[is_moving] = (end - step)[is_moving] / move[is_moving]
        share = min(float(room.min(initial=np.inf)), 1.0)
        step = np.where(room <= share, end, np.clip(step + share * move, lowest, highest))
        if share < 1.0:
            clamped |= room <= share
            continue
        pull = -(gradient + curvature @ step)
        inward = np.where(step <= lowest, pull, 0.0) + np.where(step >= highest, -pull, 0.0)
        inward[~clamped | (lowest >= highest)] = 0.0
        if inward.max(initial=0.0) <= tolerance:
            break
        clamped[int(np.argmax(inward))] = False
    return step


def _clamp_in_turn(curvature: Array, gradient: Array, lowest: Array, highest: Array) -> tuple[Array, Array]:
    """A step within bounds near the minimum, and which keys it clamps: each that leaves its bounds stays clamped.

    Of parameters that act nearly alike all may be clamped that leave together, where one would do.
    """
    step, loose = np.zeros(len(gradient)), np.ones(len(gradient), dtype=bool)
    for _ in range(MAX_CLAMP_TURNS):
        pull = gradient[loose] + curvature[np.ix_(loose, ~loose)] @ step[~loose]
        step[loose] = -np.linalg.solve(curvature[np.ix_(loose, loose)], pull)
        within = np.clip(step, lowest, highest)
        beyond = loose & (within != step)
        step = within
        if not beyond.any():
            break
        loose &= ~beyond
        if not loose.any():
            break
    return step, ~loose
