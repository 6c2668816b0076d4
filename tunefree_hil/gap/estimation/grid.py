"""Start values of a candidate: a coarse grid over its own parameters, with recalibration solved at each point.

The error as a function of a delay has many local minima, so no derivative is used before a grid was evaluated. The
derivatives of the nuisances are those of the model that the candidate is added to, so that a point of the grid costs
one simulation: what recalibration could do there is a small linear problem.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.gap.estimation.least_squares import (
    Bounds,
    Fit,
    FreeParameter,
    Jacobian,
    LeastSquaresProblem,
    key_bounds,
    step_within_joint_bounds,
)
from tunefree_hil.gap.estimation.residuals import Residuals, rms_difference

Array = np.ndarray


class GridCriteria(NamedTuple):
    """Resolution of the grids."""

    linear_points: int = 12  # of a linear parameter that has no neutral value inside its prior
    logarithmic_points: int = 8  # of a logarithmic parameter
    # smallest step of a delay: edges a few hundredths of a second too early or late are worse than unmoved ones, and a
    # coarser grid has no point from which a derivative leads to the minimum
    delay_step_s: float = 0.015
    delay_step_share: float = 0.1  # step of a delay, as a share of it
    halvings: int = 7  # bisections between two grid points, to where a limit begins to act
    refined_points: int = 9  # between the neighbours of the best point: the error of a delay varies over a tick
    # share of a target's mean square; a point that removes more is tried as well, whatever its noise
    min_alternative_reduction: float = 0.5


CRITERIA = GridCriteria()
# Distances from neutral, as shares of the prior on either side, for parameters that act nearly linearly
SHARES_OF_PRIOR = (0.03, 0.1, 0.3, 1.0)
NEAR_NEUTRAL_SHARES = SHARES_OF_PRIOR[:2]  # for a factor, whose regular grid has no point near neutral
# Nuisances of the same kind as an effect, with the sign of the relation. Beside the effect the nuisance would move the
# other way, and leave a smoothing that no car has, or a delay that differs from it by rounding only.
RECALIBRATION_TWINS = {"ins_latency.delay_s": ("clock.ins_s", 1.0), "report_latency.delay_s": ("clock.ins_s", -1.0)}
NO_TWIN = ("", 1.0)
LIMIT_SHARES = (0.0, 0.03, 0.07, 0.12, 0.2, 0.33, 0.5)  # of the way from where a limit acts to where it acts too much


class StartPoint(NamedTuple):
    """The best point of a grid.

    Args:
        keys: parameters that move
        z: of them, shape (n_keys,); recalibration is solved there
        gain: squared residuals less than those of the model that the candidate is added to
        first_parameter_only: of several parameters, the best point with all but the first neutral, if another one
        max_effect_share: largest RMS change of a target by any point of the grid, as a share of its signal
        alternative: the point that removes most of a target's mean square, if it is much, and another point. A filter
            that fits the residual of a limit can make the remaining corners seem larger than the whole was
    """

    keys: tuple[str, ...]
    z: Array
    gain: float
    first_parameter_only: StartPoint | None = None
    max_effect_share: float = 0.0
    alternative: StartPoint | None = None

    @property
    def priority(self) -> float:
        """The gain; infinite with an alternative, which is always fitted."""
        return self.gain if self.alternative is None else math.inf


class _WhitenedTarget(NamedTuple):
    """A target of the base model in non-holdout blocks, whitened: its Jacobian (n_rows, n_keys), and products."""

    jacobian: Array
    gradient: Array
    squared_residuals: float


class GridScan:
    """Grids of candidates that are added to one model.

    Args:
        base: the model that candidates are added to
        jacobian: of its keys, at its solution
        noise_source: the model whose noise is used for all candidates; None for `base`
    """

    def __init__(
        self, problem: LeastSquaresProblem, base: Fit, jacobian: Jacobian, noise_source: Fit | None = None
    ) -> None:
        self.problem, self.base, self._jacobian = problem, base, jacobian
        source = base if noise_source is None else noise_source
        self.noise_models = {name: equations.noise for name, equations in source.equations.items()}
        self._curvature = np.zeros((len(base.keys), len(base.keys)))
        self._targets = {name: self._whiten_target(name, residual) for name, residual in base.residuals.items()}
        self._signal_scales = {name: problem.residual_model.signal_scale(name) for name in base.residuals}

    def find_start(self, free: Sequence[FreeParameter]) -> StartPoint:
        """Find the best point of the grid, or the point where recalibration has put the same parameter.

        Raises: InputError if no value gives a possible car.
        """
        best = self._drop_same_alternative(free, self._best_of(free, [*grid_points(free), *self._twin_points(free)]))
        is_limit = len(free) == 1 and not math.isfinite(free[0].neutral)
        if is_limit and not self._changes_residuals(free[0], float(best.z[-1])):
            coarse, best = best, self._best_of(free, [best.z[-1:], *self._limit_points(free[0])])
            best = best._replace(
                max_effect_share=max(coarse.max_effect_share, best.max_effect_share),
                alternative=coarse.alternative or best.alternative,
            )
        neutral = [parameter.u_from_value(parameter.neutral) for parameter in free[1:]]
        if np.array_equal(best.z[len(best.z) - len(neutral) :], neutral):
            return best
        # A grid of two parameters is coarse: its best point may trade one for the other along a wrong valley
        try:
            points = [np.array([u, *neutral]) for u in _axis_points(free[0])]
            return best._replace(first_parameter_only=self._best_of(free, points))
        except InputError:
            return best

    def _drop_same_alternative(self, free: Sequence[FreeParameter], start: StartPoint) -> StartPoint:
        n = len(free)
        is_same = start.alternative is not None and np.array_equal(start.alternative.z[-n:], start.z[-n:])
        return start._replace(alternative=None) if is_same else start

    def refine_start(self, free: Sequence[FreeParameter], start: StartPoint) -> StartPoint:
        """Refine the grid around a point, for a single parameter that does not act nearly linearly."""
        points = self._points_around(free, start)
        return max(start, self._best_of(free, points), key=lambda point: point.gain) if points else start

    def refine_alternative(self, free: Sequence[FreeParameter], start: StartPoint) -> StartPoint:
        """The same for an alternative: the point around it that removes most of a target's mean square."""
        return self._best_of(free, self._points_around(free, start) or [start.z[-len(free) :]]).alternative or start

    def _points_around(self, free: Sequence[FreeParameter], start: StartPoint) -> list[Array]:
        if len(free) != 1 or free[0].low < 0.0:
            return []
        axis = sorted(_axis_points(free[0]))
        i = int(np.argmin(np.abs(np.array(axis) - start.z[-1])))
        width = max(axis[min(i + 1, len(axis) - 1)] - axis[i], axis[i] - axis[max(i - 1, 0)])
        near = start.z[-1] + width * np.linspace(-1.0, 1.0, CRITERIA.refined_points)
        return [np.array([u]) for u in np.clip(near, free[0].u_min, free[0].u_max)]

    def kept_columns(self, free: Sequence[FreeParameter]) -> list[int]:
        """Columns of the base model's keys that are fitted beside a candidate: not those that it replaces."""
        replaced = {parameter.key for parameter in free}
        replaced |= {RECALIBRATION_TWINS.get(parameter.key, NO_TWIN)[0] for parameter in free}
        return [i for i, key in enumerate(self.base.keys) if key not in replaced]

    def jacobian(self, free: Sequence[FreeParameter]) -> Jacobian:
        """Jacobian of these columns."""
        return select_columns(self._jacobian, self.kept_columns(free))

    def _limit_points(self, parameter: FreeParameter) -> list[Array]:
        """Points at which a limit just begins to act.

        Between two points of a coarse grid a limit may go from far too strong to no effect at all, while the true one
        lies just below what the drives reach.
        """
        axis = sorted(_axis_points(parameter))
        acting = [u for u in axis if self._changes_residuals(parameter, u)]
        idle_points = [u for u in axis if u not in acting]
        if not acting or not idle_points or max(acting) > max(idle_points):
            return []
        begin = acts = max(acting)
        idle = min(u for u in idle_points if u > acts)
        for _ in range(CRITERIA.halvings):
            middle = 0.5 * (acts + idle)
            acts, idle = (middle, idle) if self._changes_residuals(parameter, middle) else (acts, middle)
        return [np.array([acts - share * (acts - begin)]) for share in LIMIT_SHARES]

    def _changes_residuals(self, parameter: FreeParameter, u: float) -> bool:
        """Whether a value changes any residual in non-holdout blocks."""
        base = self.base
        keys, z = (*base.keys, parameter.key), np.append(base.z, u)
        try:
            residuals = self._simulate(keys, z, (*base.free, parameter))
        except InputError:
            return True  # such a low limit is no possible car
        for name, pieces in residuals.items():
            before = base.residuals[name]
            if not is_unchanged(pieces, before):
                change = self._whiten(name, [a - b for a, b in zip(pieces, before, strict=True)])
                if change.any():
                    return True
        return False

    def _twin_points(self, free: Sequence[FreeParameter]) -> list[Array]:
        """The point at which recalibration has put these parameters, if it has: replacing it must lose nothing."""
        values, twin_values = self.base.values, list[float]()
        for parameter in free:
            twin, sign = RECALIBRATION_TWINS.get(parameter.key, NO_TWIN)
            if parameter.key not in values and twin not in values:
                return []
            twin_values.append(values[parameter.key] if parameter.key in values else sign * values[twin])
        point = [parameter.u_from_value(value) for parameter, value in zip(free, twin_values, strict=True)]
        return [np.clip(point, [parameter.u_min for parameter in free], [parameter.u_max for parameter in free])]

    def _best_of(self, free: Sequence[FreeParameter], points: Sequence[Array]) -> StartPoint:
        """The best of some points.

        An effect has no prior: what the same change had cost recalibration counts as gain.
        """
        columns, base = self.kept_columns(free), self.base
        kept_keys = [base.keys[i] for i in columns]
        keys = (*kept_keys, *(parameter.key for parameter in free))
        all_free, kept_z = (*base.free, *free), np.array([base.z[i] for i in columns])
        precision = self.problem.prior_precision(kept_keys, base.free)
        removed_penalty = float(base.z @ base.prior_precision @ base.z - kept_z @ precision @ kept_z)
        base_cost = self._recalibrated_cost(base.residuals, columns, kept_z, precision)[0] + removed_penalty
        best, alternative = None, None
        max_effect_share, max_reduction = 0.0, CRITERIA.min_alternative_reduction
        bounds = key_bounds(keys, all_free)
        for u in points:
            z = np.concatenate([kept_z, u])
            try:
                residuals = self._simulate(keys, z, all_free)
            except InputError:  # not a possible car
                continue
            max_effect_share = max(max_effect_share, self._effect_share(residuals))
            cost, step = self._recalibrated_cost(residuals, columns, kept_z, precision)
            gain = base_cost - cost
            if best is None or gain > best.gain:
                best = StartPoint(keys, np.clip(np.concatenate([kept_z + step, u]), *bounds), gain)
            if (reduction := self._max_reduction(residuals)) > max_reduction:
                max_reduction, alternative = reduction, StartPoint(keys, np.clip(z, *bounds), gain)
        if best is None:
            key = ",".join(parameter.key for parameter in free)
            raise InputError("no value of it gives a possible car", code="no_such_effect", key=key)
        return best._replace(max_effect_share=max_effect_share, alternative=alternative)

    def _simulate(self, keys: Sequence[str], z: Array, free: Sequence[FreeParameter]) -> Residuals:
        return self.problem.residual_model.simulate_residuals(self.problem.parameter_values(keys, z, free))

    def _max_reduction(self, residuals: Residuals) -> float:
        """Largest share of a target's mean square that is removed, outside holdout blocks."""
        model, shares = self.problem.residual_model, list[float]()
        for name, pieces in residuals.items():
            base_pieces = self.base.residuals[name]
            if not is_unchanged(pieces, base_pieces):
                after, before = (_sum_squares(p, model.non_holdout_rows(name)) for p in (pieces, base_pieces))
                shares.append(1.0 - after / max(before, 1e-300))
        return max(shares, default=0.0)

    def _effect_share(self, residuals: Residuals) -> float:
        """Largest RMS change of a target, as a share of its signal."""
        model = self.problem.residual_model
        shares = [
            rms_difference(pieces, self.base.residuals[name], model.non_holdout_rows(name))
            / max(self._signal_scales[name], 1e-12)
            for name, pieces in residuals.items()
            if not is_unchanged(pieces, self.base.residuals[name])
        ]
        return max(shares, default=0.0)

    def _recalibrated_cost(
        self, residuals: Residuals, columns: Sequence[int], z: Array, precision: Array
    ) -> tuple[float, Array]:
        """Cost and step of the best recalibration from z with these residuals, by the normal equations.

        Args:
            columns: of the base model's keys that are fitted
            z: of them, shape (n_columns,)
            precision: of their priors, shape (n_columns, n_columns)
        """
        gradient, squared = np.zeros(len(self.base.keys)), 0.0
        for name, pieces in residuals.items():
            target = self._targets[name]
            if not is_unchanged(pieces, self.base.residuals[name]):
                white = self._whiten(name, pieces)
                target = _WhitenedTarget(target.jacobian, white @ target.jacobian, float(white @ white))
            gradient, squared = gradient + target.gradient, squared + target.squared_residuals
        bounds = key_bounds(self.base.keys, self.base.free)
        curvature, gradient = self._curvature[np.ix_(columns, columns)] + precision, gradient[columns] + precision @ z
        joint_bounds = self.problem.joint_bounds([self.base.keys[i] for i in columns], self.base.free)
        kept_bounds = Bounds(bounds.low[columns], bounds.high[columns])
        step = step_within_joint_bounds(curvature, gradient, z, kept_bounds, joint_bounds)
        return squared + float(z @ precision @ z) + float(2.0 * gradient @ step + step @ curvature @ step), step

    def _whiten_target(self, name: str, residual: list[Array]) -> _WhitenedTarget:
        columns, pieces = self._jacobian.by_target[name]
        joint = self._whiten(name, [np.column_stack([r, p]) for r, p in zip(residual, pieces, strict=True)])
        jacobian = np.zeros((len(joint), len(self.base.keys)))
        jacobian[:, columns] = joint[:, 1:]
        self._curvature[np.ix_(columns, columns)] += joint[:, 1:].T @ joint[:, 1:]
        return _WhitenedTarget(jacobian, joint[:, 0] @ jacobian, float(joint[:, 0] @ joint[:, 0]))

    def _whiten(self, name: str, residual: Sequence[Array]) -> Array:
        """Rows in non-holdout blocks, whitened, in units of the noise."""
        noise = self.noise_models[name]
        rows, row_blocks = self.problem.residual_model.whiten(name, residual, noise)
        return rows[np.isin(row_blocks, self.problem.non_holdout_blocks())] / np.sqrt(noise.correlation_rows)


def _sum_squares(residual: Sequence[Array], rows: Sequence[Array]) -> float:
    return sum(float(np.sum(piece[used] ** 2)) for piece, used in zip(residual, rows, strict=True))


def is_unchanged(residual: Sequence[Array], reference: Sequence[Array]) -> bool:
    """Whether two residuals of a target are equal in every drive."""
    return all(np.array_equal(a, b) for a, b in zip(residual, reference, strict=True))


def select_columns(jacobian: Jacobian, selected: Sequence[int]) -> Jacobian:
    """The Jacobian of these columns, numbered anew."""
    index = {old: new for new, old in enumerate(selected)}
    by_target = {}
    for name, (columns, pieces) in jacobian.by_target.items():
        used = [c for c, column in enumerate(columns) if int(column) in index]
        numbers = np.array([index[int(columns[c])] for c in used], dtype=np.int64)
        by_target[name] = (numbers, [piece[:, used] for piece in pieces])
    return Jacobian(by_target)


def grid_points(free: Sequence[FreeParameter]) -> list[Array]:
    """Points over the prior of one parameter; of two, a coarser grid of both. Each of shape (n_parameters,)."""
    first = _axis_points(free[0])
    if len(free) == 1:
        return [np.array([u]) for u in first]
    further = product(*((0.1, parameter.u_from_value(parameter.neutral), 0.9) for parameter in free[1:]))
    return [np.array([u, *rest]) for u, rest in product(first, further)]


def _axis_points(parameter: FreeParameter) -> list[float]:
    """Points in u: distances to both sides of neutral where it is inside the prior, else regular points."""
    count = CRITERIA.logarithmic_points if parameter.is_logarithmic else CRITERIA.linear_points
    regular = [float(u) for u in np.linspace(0.0, 1.0, count)]
    if parameter.key.endswith("delay_s") and not parameter.is_logarithmic:
        return _delay_points(parameter)
    if not parameter.low < parameter.neutral < parameter.high:
        return regular
    neutral = parameter.u_from_value(parameter.neutral)
    shares = NEAR_NEUTRAL_SHARES if parameter.is_logarithmic else SHARES_OF_PRIOR
    distances = [neutral + share * (end - neutral) for end in (0.0, 1.0) for share in shares]
    return regular + distances if parameter.is_logarithmic else distances


def _delay_points(parameter: FreeParameter) -> list[float]:
    delays_s = [parameter.low]
    while delays_s[-1] < parameter.high:
        step_s = max(CRITERIA.delay_step_s, CRITERIA.delay_step_share * delays_s[-1])
        delays_s.append(min(delays_s[-1] + step_s, parameter.high))
    return [parameter.u_from_value(delay_s) for delay_s in delays_s]
