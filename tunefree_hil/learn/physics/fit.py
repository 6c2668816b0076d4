"""Fits the physical constants of plant/single_track.py by free runs on recorded actuator outputs.

Each window starts at the measured motion; the errors of speed, yaw rate, heading, lateral acceleration and position are
minimised. Masses and geometry stay at the data sheet, since motion shows forces per mass only. A constant whose
uncertainty the windows hardly reduce keeps its prior value with a wide interval.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.data_sheet import ConstantPrior
from tunefree_hil.learn.estimate import Estimate, replace_value
from tunefree_hil.learn.physics.unknowns import (
    BRAKE_DEAD_BAND,
    FITTED_EFFECTS,
    MIN_CONSTANTS,
    NO_IMPROVEMENT,
    POWERTRAIN_LAG,
    ROAD_SHARE,
    SHAPE_CONSTANTS,
    STEER_OFFSET,
    EstimateCorrelation,
    PhysicsProblem,
    add_shape_constants,
    compute_interval_half_widths,
    compute_remaining_uncertainty,
    estimate_correlation,
    solve_problem,
)
from tunefree_hil.learn.physics.windows import OutputCorrection, WindowSet, compute_target_rms
from tunefree_hil.learn.robust_least_squares import RobustFit

Array = np.ndarray
Progress = tuple[int, int]  # (steps done, steps in all)

PROGRESS_STEPS = 8  # reported per fit, whatever the number of fits inside
NOT_SIGNIFICANT = "it reduces the speed error, but these logs do not distinguish it from zero"
ONLY_JOINTLY_KNOWN = "these logs identify it only together with the others: the best joint value"


class FitCriteria(NamedTuple):
    """When a constant counts as identified (docs/results/criteria.md)."""

    min_windows: int = 6  # needed for a fit
    # of the prior uncertainty, for an identified constant
    max_remaining_share: float = 0.5
    # of the prior uncertainty: a constant with more is dropped at once, below it the worst goes first
    unidentifiable_share: float = 0.95
    # error with only the identified constants over that of the joint fit, above which the joint values are kept
    max_rms_ratio: float = 1.5


CRITERIA = FitCriteria()


class PhysicsFit(NamedTuple):
    """Fitted constants.

    Attributes:
        estimates: The constants, and those of FITTED_EFFECTS.
        params: [plant.params] in full.
        rms_before: Root mean square error of each target with the prior values.
        rms_after: The same with the fitted ones.
        n_windows: Number of windows.
        notes: What was left out.
        correlation: Of the estimates.
    """

    estimates: dict[str, Estimate]
    params: dict[str, float]
    rms_before: dict[str, float]
    rms_after: dict[str, float]
    n_windows: int
    notes: tuple[str, ...]
    correlation: EstimateCorrelation = EstimateCorrelation()

    def output_correction(self) -> OutputCorrection:
        """The significant effects between outputs and vehicle; others do not go into a model."""
        values = {
            name: self.estimates[name].value if is_significant(name, self.estimates[name]) else 0.0
            for name in FITTED_EFFECTS
        }
        road = self.estimates.get(ROAD_SHARE)
        share = road.value if road is not None and road.known else 0.0
        return OutputCorrection(
            float(values[STEER_OFFSET]), float(values[BRAKE_DEAD_BAND]), share, float(values[POWERTRAIN_LAG])
        )


class _Solution(NamedTuple):
    """A fit of some unknowns. dropped: remaining share of uncertainty of those that are not identified."""

    names: list[str]
    fit: RobustFit
    dropped: dict[str, float]


def is_significant(name: str, estimate: Estimate) -> bool:
    """Whether one of FITTED_EFFECTS differs from zero by more than its interval and more than is negligible."""
    return (
        estimate.known
        and (estimate.low > 0.0 or estimate.high < 0.0)
        and abs(estimate.value) > FITTED_EFFECTS[name].negligible
    )


def fit_physics(
    windows: WindowSet, fixed: Mapping[str, float], priors: Mapping[str, ConstantPrior], brake_travel: float
) -> Generator[Progress, None, PhysicsFit]:
    """Fit the constants that the windows identify; yields (steps done, steps in all).

    Args:
        windows: Free-run windows.
        fixed: [plant.params] that are not fitted.
        priors: Of the constants to fit.
        brake_travel: Brake duty from rest to the limit.

    Raises:
        InputError: There are too few windows.
    """
    if len(windows.windows) < CRITERIA.min_windows:
        if not windows.has_pedals:
            return _keep_priors(windows, fixed, priors, brake_travel)
        raise _too_few_windows(windows)
    problem = PhysicsProblem(windows, fixed, priors, brake_travel)
    names = [name for name in problem.names if name not in SHAPE_CONSTANTS]
    x = np.zeros(len(names))
    rms_before = compute_target_rms(problem.errors(problem.constants_from_unknowns(names, x)))
    yield 0, PROGRESS_STEPS
    fit = solve_problem(problem, names, x, 25)
    yield 1, PROGRESS_STEPS
    problem.rescale(problem.constants_from_unknowns(names, fit.x))
    fit = solve_problem(problem, names, fit.x, 15)
    yield 2, PROGRESS_STEPS
    names, fit = add_shape_constants(problem, names, fit)
    yield 3, PROGRESS_STEPS
    result = yield from _estimate_constants(problem, names, fit, rms_before, windows.notes)
    if POWERTRAIN_LAG in names and not is_significant(POWERTRAIN_LAG, result.estimates[POWERTRAIN_LAG]):
        # The model will have no lag, so the other constants are fitted again without it.
        fewer = [name for name in names if name != POWERTRAIN_LAG]
        fit = solve_problem(problem, fewer, np.delete(fit.x, names.index(POWERTRAIN_LAG)), 15)
        result = yield from _estimate_constants(problem, fewer, fit, rms_before, windows.notes)
        result.estimates[POWERTRAIN_LAG] = _keep_prior(problem, POWERTRAIN_LAG, {})._replace(
            why=NOT_SIGNIFICANT, is_needed=True
        )
    yield PROGRESS_STEPS, PROGRESS_STEPS
    return result


def _too_few_windows(windows: WindowSet) -> InputError:
    return InputError(
        f"the logs hold {len(windows.windows)} windows of free motion, {CRITERIA.min_windows} are needed"
        + "".join(f"; {note}" for note in windows.notes),
        code="too_short",
        key="LOG",
        hint="drive longer, on a level road and in drive gear, with reports of the actuators and of the speed",
    )


def _estimate_constants(
    problem: PhysicsProblem, names: list[str], fit: RobustFit, rms_before: dict[str, float], notes: tuple[str, ...]
) -> Generator[Progress, None, PhysicsFit]:
    """Estimates of all constants from a joint fit of `names`."""
    joint = _Solution(names, fit, {})
    joint_values = problem.constants_from_unknowns(names, fit.x)
    joint_rms = compute_target_rms(problem.errors(joint_values))
    half_widths = dict(zip(names, compute_interval_half_widths(fit, problem.stretches), strict=True))
    correlation = estimate_correlation(names, fit, problem.stretches)
    solution = yield from _drop_unidentified(problem, names, fit)
    names, fit = solution.names, solution.fit
    values = problem.constants_from_unknowns(names, fit.x if names else np.zeros(0))
    rms_after = compute_target_rms(problem.errors(values))
    if names and solution.dropped:  # constants held at their priors would narrow the intervals of the others
        alone = dict(zip(names, compute_interval_half_widths(fit, problem.stretches), strict=True))
        half_widths = {name: max(half_widths[name], half) for name, half in alone.items()}
    estimates = {name: _make_estimate(problem, solution, name, half_widths) for name in problem.priors}
    if any(rms_after[name] > CRITERIA.max_rms_ratio * joint_rms[name] for name in rms_after):
        # With the priors of the dropped constants the motion differs too much from the measured one.
        values, rms_after = joint_values, joint_rms
        replaced = {name: estimate for name, estimate in estimates.items() if estimate.is_needed}
        estimates |= {
            name: replace_value(estimate, joint_values[name], ONLY_JOINTLY_KNOWN) for name, estimate in replaced.items()
        }
        estimates |= _estimate_jointly_known(problem, joint)
    n_windows = len(problem.windows)
    return PhysicsFit(estimates, problem.params(values), rms_before, rms_after, n_windows, notes, correlation)


def _estimate_jointly_known(problem: PhysicsProblem, joint: _Solution) -> dict[str, Estimate]:
    """Estimates of the constants that are identified while all others are free."""
    half_widths = dict(zip(joint.names, compute_interval_half_widths(joint.fit, problem.stretches), strict=True))
    remaining = dict(zip(joint.names, compute_remaining_uncertainty(joint.fit), strict=True))
    return {
        name: _make_estimate(problem, joint, name, half_widths)
        for name in joint.names
        if remaining[name] <= CRITERIA.max_remaining_share
    }


def _drop_unidentified(
    problem: PhysicsProblem, names: list[str], fit: RobustFit
) -> Generator[Progress, None, _Solution]:
    """Set constants that are not identified to their priors and fit the rest again, until all are identified."""
    dropped: dict[str, float] = {}
    while names:
        remaining = compute_remaining_uncertainty(fit)
        threshold = min(CRITERIA.unidentifiable_share, float(remaining.max()))
        worst = np.flatnonzero((remaining > CRITERIA.max_remaining_share) & (remaining >= threshold))
        if not len(worst):
            break
        dropped |= {names[i]: float(remaining[i]) for i in worst}
        keep = [i for i in range(len(names)) if i not in worst]
        names = [names[i] for i in keep]
        if names:
            fit = solve_problem(problem, names, fit.x[keep], 10)
        yield min(4 + len(dropped), PROGRESS_STEPS - 1), PROGRESS_STEPS
    return _Solution(names, fit, dropped)


def _keep_priors(
    windows: WindowSet, fixed: Mapping[str, float], priors: Mapping[str, ConstantPrior], brake_travel: float
) -> PhysicsFit:
    """All constants at their priors: no pedal output is reported, and there are too few windows."""
    problem = PhysicsProblem(windows._replace(windows=()), fixed, priors, brake_travel)
    values = problem.constants_from_unknowns((), np.zeros(0))
    estimates = {name: _keep_prior(problem, name, {}) for name in problem.priors}
    note = f"no pedal output is reported, and only {len(windows.windows)} free runs are possible: no constant is fitted"
    return PhysicsFit(estimates, problem.params(values), {}, {}, 0, (note,))


def _make_estimate(
    problem: PhysicsProblem, solution: _Solution, name: str, half_widths: Mapping[str, float]
) -> Estimate:
    if name not in solution.names:
        return _keep_prior(problem, name, solution.dropped)
    x, half = float(solution.fit.x[solution.names.index(name)]), float(half_widths[name])
    low = max(x - half, problem.min_unknown(name))
    return Estimate(
        problem.constant_from_unknown(name, x),
        problem.constant_from_unknown(name, low),
        problem.constant_from_unknown(name, x + half),
    )


def _keep_prior(problem: PhysicsProblem, name: str, dropped: Mapping[str, float]) -> Estimate:
    """The prior value of a constant, with the reason."""
    prior = problem.priors[name]
    low, high = prior.interval()
    low = max(low, MIN_CONSTANTS.get(name, -math.inf))
    source = "data sheet" if prior.is_stated else "a plausible value"
    if name in SHAPE_CONSTANTS and name in problem.names and name not in dropped:
        return Estimate(prior.value, low, high, False, NO_IMPROVEMENT, is_needed=False)
    if name in dropped:
        why = f"these logs leave {min(dropped[name], 1.0):.0%} of the prior uncertainty"
    else:
        why = "the logs lack the outputs that it needs"
    return Estimate(prior.value, low, high, False, f"{why}; {source}")
