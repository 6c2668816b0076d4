"""Damped Gauss-Newton fits of a model: the parameters of its effects together with all nuisances.

A Jacobian costs simulations. Nuisances act nearly linearly, so their derivatives are computed once, at the model that
candidates are added to, and shared by all candidates; those of a candidate's own parameters are computed at each step.
A model that others are compared with is refined with all derivatives renewed (`refine_fit`). The noise is estimated
from the residual of each model itself (gap/estimation/noise.py).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.gap.estimation.evidence import log_evidence, with_correlation_rows
from tunefree_hil.gap.estimation.grid import NO_TWIN, RECALIBRATION_TWINS, GridScan, StartPoint
from tunefree_hil.gap.estimation.least_squares import (
    CURVATURE_FLOOR,
    Fit,
    FreeParameter,
    Jacobian,
    LeastSquaresProblem,
    NormalEquations,
    Reference,
    key_bounds,
    penalised_cost,
    shrink_inside_joint_bounds,
    step_within_joint_bounds,
    sum_equations,
    sum_squared_residuals,
)
from tunefree_hil.gap.estimation.noise import NoiseModel
from tunefree_hil.gap.estimation.residuals import Residuals

Array = np.ndarray


class StepCriteria(NamedTuple):
    """When a fit ends, in steps."""

    max_candidate_steps: int = 8  # of a candidate
    max_refine_steps: int = 40  # of a model that is refined
    noise_update_steps: int = 3  # from here on the noise is estimated anew only when nothing more is gained
    min_cost_drop: float = 0.5  # squared residuals, in units of the noise: a step that gains less is the last


CRITERIA = StepCriteria()
DAMPINGS = (0.0, 1e-2, 1e-1, 1.0, 10.0)  # of the normal equations, tried in this order


class SearchPoint(NamedTuple):
    """Where a search stands: keys, the free ones of them, their z (n_keys,), and the residuals there."""

    keys: tuple[str, ...]
    free: tuple[FreeParameter, ...]
    z: Array
    residuals: Residuals


def fit_recalibration(problem: LeastSquaresProblem) -> tuple[Fit, Jacobian]:
    """Fit the model without effects, and return the Jacobian there, which all candidates share.

    It is refined to its minimum: otherwise effects would seem to explain what recalibration can.
    """
    keys = tuple(problem.nuisances)
    z = np.zeros(len(keys))
    residuals = problem.residual_model.simulate_residuals(problem.parameter_values(keys, z, ()))
    return _refine(problem, "", SearchPoint(keys, (), z, residuals))


def refine_fit(problem: LeastSquaresProblem, fit: Fit) -> Fit:
    """Refine a model (with its residuals) until nothing is gained, under the noise of its own residual."""
    return _refine(problem, fit.name, SearchPoint(fit.keys, fit.free, fit.z, fit.residuals))[0]


def fit_without_effect(problem: LeastSquaresProblem, fit: Fit, name: str) -> Fit:
    """Remove one effect of a model and refit the rest; nuisances that the effect had replaced are moved again."""
    free = tuple(parameter for parameter in fit.free if parameter.key.partition(".")[0] != name)
    remaining, previous = {parameter.key for parameter in free}, {parameter.key for parameter in fit.free}
    removed = previous - remaining
    z_by_key = {key: float(z) for key, z in zip(fit.keys, fit.z, strict=True) if key not in removed}
    replaced = remaining | {RECALIBRATION_TWINS.get(key, NO_TWIN)[0] for key in remaining}
    keys = (*(key for key in problem.nuisances if key not in replaced), *(parameter.key for parameter in free))
    z = np.array([z_by_key.get(key, 0.0) for key in keys])
    residuals = problem.residual_model.simulate_residuals(problem.parameter_values(keys, z, free))
    return _refine(problem, fit.name if free else "", SearchPoint(keys, free, z, residuals))[0]


def fit_candidate(scan: GridScan, name: str, free: Sequence[FreeParameter], start: StartPoint, min_gain: float) -> Fit:
    """Fit a candidate from one point of its grid beside the scan's model, or from two, and return the better fit.

    Args:
        min_gain: a candidate that gains less at its start gets one step only, so that no grid alone excludes it

    Raises: InputError if no start leads to a possible car.
    """
    problem, alternative = scan.problem, start.alternative
    max_steps = CRITERIA.max_candidate_steps if start.priority > min_gain else 1
    if start.gain > min_gain:
        start = scan.refine_start(free, start)
    columns = list(range(len(start.keys) - len(free), len(start.keys)))
    all_free = (*scan.base.free, *free)
    errors = list[InputError]()

    def descend_from(
        begin: StartPoint, noise_models: dict[str, NoiseModel] | None
    ) -> Iterator[tuple[SearchPoint, Jacobian]]:
        """Where a search from there ends, if anywhere. noise_models: None for those of its start."""
        try:
            residuals = problem.residual_model.simulate_residuals(
                problem.parameter_values(begin.keys, begin.z, all_free)
            )
            point = SearchPoint(begin.keys, all_free, begin.z, residuals)
            partial = _PartialJacobian(scan.jacobian(free), columns)
            yield _descend(problem, point, partial, noise_models or problem.noise_models(residuals), max_steps)
        except InputError as error:  # not a possible car: the other start may be one
            errors.append(error)

    begins = [begin for begin in (start, start.first_parameter_only) if begin is not None]
    ends = [end for begin in begins for end in descend_from(begin, scan.noise_models)]
    finished = [min(ends, key=lambda end: _penalised_cost(scan, end[0]))] if ends else []
    if alternative is not None:
        finished += descend_from(scan.refine_alternative(free, alternative), None)
    if not finished:
        raise errors[0]
    return _select_by_evidence([_finish(problem, name, *end) for end in finished], problem.non_holdout_blocks())


def _penalised_cost(scan: GridScan, point: SearchPoint) -> float:
    """Of a point, under the noise that is common to all candidates of the scan."""
    problem, base = scan.problem, scan.base
    reference = Reference(base.residuals, base.equations)
    blocks = problem.non_holdout_blocks()
    squared = sum_squared_residuals(problem, point.residuals, scan.noise_models, reference, blocks)
    return squared + float(point.z @ problem.prior_precision(point.keys, point.free) @ point.z)


def _select_by_evidence(fits: Sequence[Fit], blocks: Array) -> Fit:
    """The fit of largest evidence, all under the largest correlation rows of any of them."""
    if len(fits) == 1:
        return fits[0]
    correlation_rows = {
        name: max(fit.equations[name].noise.correlation_rows for fit in fits) for name in fits[0].equations
    }
    return max(fits, key=lambda fit: log_evidence(with_correlation_rows(fit, correlation_rows), blocks))


def _refine(problem: LeastSquaresProblem, name: str, point: SearchPoint) -> tuple[Fit, Jacobian]:
    """Step with a kept Jacobian while that helps, then with a renewed one, until neither helps.

    That must hold under the noise of the final residual: larger noise on the way hides how much is left to gain.
    """
    columns, point = list(range(len(point.keys))), _move_inside_joint_bounds(problem, point)

    def jacobian_at(place: SearchPoint) -> Jacobian:
        return problem.jacobian(place.keys, place.z, place.free, columns, place.residuals)

    jacobian = jacobian_at(point)
    noise_models, blocks = problem.noise_models(point.residuals), problem.non_holdout_blocks()
    is_renewed, is_noise_final = True, False
    for turn in range(CRITERIA.max_refine_steps):
        equations = problem.normal_equations(point.residuals, jacobian, noise_models)
        stepped, gain = _step(problem, point, equations, blocks)
        if gain >= CRITERIA.min_cost_drop:
            point, is_renewed, is_noise_final = stepped, False, False
        elif not is_renewed:
            jacobian, is_renewed = jacobian_at(point), True
        elif is_noise_final and turn >= CRITERIA.noise_update_steps:
            break
        else:
            is_noise_final = True
        if turn < CRITERIA.noise_update_steps or is_noise_final:
            noise_models = problem.noise_models(point.residuals)
    if not is_renewed:
        jacobian = jacobian_at(point)
    return _finish(problem, name, point, jacobian), jacobian


class _PartialJacobian(NamedTuple):
    """A Jacobian that all candidates share, and the columns of a candidate's own parameters, renewed at each step."""

    shared: Jacobian
    renewed_columns: Sequence[int]


def _descend(
    problem: LeastSquaresProblem,
    point: SearchPoint,
    partial: _PartialJacobian,
    noise_models: dict[str, NoiseModel],
    max_steps: int,
) -> tuple[SearchPoint, Jacobian]:
    """Step until nothing is gained. The noise is that after the first steps."""
    blocks, point = problem.non_holdout_blocks(), _move_inside_joint_bounds(problem, point)

    def jacobian_at(place: SearchPoint) -> Jacobian:
        columns = partial.renewed_columns
        renewed = problem.jacobian(place.keys, place.z, place.free, columns, place.residuals)
        return _replace_columns(partial.shared, renewed)

    jacobian = jacobian_at(point)
    for turn in range(max_steps):
        equations = problem.normal_equations(point.residuals, jacobian, noise_models)
        point, gain = _step(problem, point, equations, blocks)
        if gain < CRITERIA.min_cost_drop and (turn >= CRITERIA.noise_update_steps or max_steps == 1):
            break
        if turn < CRITERIA.noise_update_steps and max_steps > 1:
            noise_models = problem.noise_models(point.residuals)
        jacobian = jacobian_at(point)
    return point, jacobian


def _finish(problem: LeastSquaresProblem, name: str, point: SearchPoint, jacobian: Jacobian) -> Fit:
    equations = problem.normal_equations(point.residuals, jacobian, problem.noise_models(point.residuals))
    values = problem.parameter_values(point.keys, point.z, point.free)
    precision = problem.prior_precision(point.keys, point.free)
    return Fit(name, point.keys, point.z, point.free, values, precision, equations, point.residuals)


def _move_inside_joint_bounds(problem: LeastSquaresProblem, point: SearchPoint) -> SearchPoint:
    """A point within its joint bounds.

    Nuisances that are refitted beside others may start outside, where each step back costs and none would be taken.
    """
    z = shrink_inside_joint_bounds(point.z, problem.joint_bounds(point.keys, point.free))
    if z is point.z:
        return point
    values = problem.parameter_values(point.keys, z, point.free)
    return point._replace(z=z, residuals=problem.residual_model.simulate_residuals(values))


def _step(
    problem: LeastSquaresProblem, point: SearchPoint, equations: Mapping[str, NormalEquations], blocks: Array
) -> tuple[SearchPoint, float]:
    """The next point and what it gains: damped more and more until it gains; the same point and 0 if none does."""
    precision = problem.prior_precision(point.keys, point.free)
    cost = penalised_cost(equations, point.z, precision, blocks)
    noise_models = {name: target.noise for name, target in equations.items()}
    bounds, joint_bounds = key_bounds(point.keys, point.free), problem.joint_bounds(point.keys, point.free)
    form = sum_equations(equations, len(point.keys), blocks)
    curvature, gradient = form.curvature + precision, form.gradient + precision @ point.z
    scale = np.maximum(np.diag(curvature), CURVATURE_FLOOR)
    reference = Reference(point.residuals, equations)
    for damping in DAMPINGS:
        damped = curvature + damping * np.diag(scale)
        z = point.z + step_within_joint_bounds(damped, gradient, point.z, bounds, joint_bounds)
        try:
            values = problem.parameter_values(point.keys, z, point.free)
            residuals = problem.residual_model.simulate_residuals(values)
        except InputError:  # not a possible car: a shorter step
            continue
        squared = sum_squared_residuals(problem, residuals, noise_models, reference, blocks)
        new_cost = squared + float(z @ precision @ z)
        if new_cost < cost:
            return point._replace(z=z, residuals=residuals), cost - new_cost
    return point, 0.0


def _replace_columns(jacobian: Jacobian, renewed: Jacobian) -> Jacobian:
    """Both Jacobians; a column of `renewed` replaces the same one of `jacobian`."""
    by_target = {}
    for name, (columns, pieces) in jacobian.by_target.items():
        new_columns, new_pieces = renewed.by_target[name]
        rest = [c for c, column in enumerate(columns) if column not in new_columns]
        joined = [np.concatenate([old[:, rest], new], axis=1) for old, new in zip(pieces, new_pieces, strict=True)]
        by_target[name] = (np.concatenate([columns[rest], new_columns]), joined)
    return Jacobian(by_target)
