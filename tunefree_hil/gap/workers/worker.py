"""Functions that run in a worker process: one problem stays open there, and its models are fitted one after the other.

Each process opens the problem once: it compiles the simulation, fits the recalibrated model and computes its Jacobian.
Several processes open the same problem and share the candidates. What is sent back is small: fits without residuals.
Every function takes the token under which its problem was opened.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.gap.diagnostics.lack_of_fit import LackOfFit, measure_lack_of_fit
from tunefree_hil.gap.diagnostics.regions import Region, find_regions
from tunefree_hil.gap.diagnostics.residual_tests import Burst, Shape, TargetRows, cut_windows, fit_shape, measure_burst
from tunefree_hil.gap.estimation.calibration_priors import apply_calibration_prior, read_calibration_prior
from tunefree_hil.gap.estimation.candidates import Candidate, add_parameter_sigmas, build_candidates
from tunefree_hil.gap.estimation.gauss_newton import fit_candidate, fit_recalibration, fit_without_effect, refine_fit
from tunefree_hil.gap.estimation.grid import GridScan, StartPoint
from tunefree_hil.gap.estimation.least_squares import Fit, Jacobian, LeastSquaresProblem
from tunefree_hil.gap.estimation.nuisance import (
    Nuisance,
    build_nuisances,
    prior_correlation,
    read_constant_correlations,
    read_constant_sigmas,
    read_drift_share,
)
from tunefree_hil.gap.estimation.residuals import ProblemSpec, ResidualModel, TargetProperties, rms_difference
from tunefree_hil.gap.measured.blocks import Blocks
from tunefree_hil.gap.selection.reasons import Reason

Array = np.ndarray

AVERAGING_S = 1.0  # long compared with sensor noise, short compared with a block
NO_SQUARES: dict[str, tuple[Array, Array]] = {}


class FitSummary(NamedTuple):
    """A fitted model as it is sent: without residuals.

    Args:
        fit: the model
        squared_residuals: by target, sums of squares and numbers of rows by block, each of shape (n_blocks,)
        averaged_squared_residuals: the same of means over AVERAGING_S, which are nearly free of noise
    """

    fit: Fit
    squared_residuals: dict[str, tuple[Array, Array]]
    averaged_squared_residuals: dict[str, tuple[Array, Array]] = NO_SQUARES


class OpenProblem(NamedTuple):
    """A problem once it is opened.

    Args:
        recalibrated: the model without effects
        blocks: blocks of all drives, with their roles
        target_properties: by target
        signal_scales: by target, standard deviation of the measured signal
        candidates: effects that may explain what is missed
        untestable_effects: why the others cannot be tested
        broken_targets: targets that recalibration alone leaves broken; None before that was assessed
        targets_within_baseline: of these, the ones that the model misses on its calibration logs as well
        nuisances: what recalibration may move
    """

    recalibrated: FitSummary
    blocks: Blocks
    target_properties: dict[str, TargetProperties]
    signal_scales: dict[str, float]
    candidates: tuple[Candidate, ...]
    untestable_effects: dict[str, Reason]
    broken_targets: frozenset[str] | None = None
    targets_within_baseline: frozenset[str] = frozenset()
    nuisances: tuple[Nuisance, ...] = ()


class _ProblemState:
    """An open problem in its process."""

    def __init__(self, spec: ProblemSpec) -> None:
        self.residual_model = ResidualModel(spec)
        constant_sigmas = read_constant_sigmas(spec.model)
        drift_share = read_drift_share(spec.model, spec.drives[0].size_scale)
        nuisances = build_nuisances(self.residual_model.graph, spec.model, constant_sigmas, drift_share)
        prior = read_calibration_prior(spec.model)
        correlation = prior_correlation(nuisances, read_constant_correlations(spec.model))
        nuisances, correlation = apply_calibration_prior(nuisances, correlation, prior)
        self.problem = LeastSquaresProblem(
            self.residual_model, nuisances, correlation, has_calibration_prior=bool(prior.keys)
        )
        self.recalibrated, self.jacobian = fit_recalibration(self.problem)
        candidates, self.untestable_effects = build_candidates(
            self.residual_model.graph, spec.model, spec.vehicle, spec.drives
        )
        self.candidates = {
            candidate.name: add_parameter_sigmas(candidate, nuisances, constant_sigmas) for candidate in candidates
        }
        self._scan: tuple[Any, GridScan] | None = None

    def restore_residuals(self, fit: Fit) -> Fit:
        """A fit from another process, with its residuals simulated again."""
        return fit._replace(residuals=self.residual_model.simulate_residuals(fit.values))

    def jacobian_at(self, fit: Fit) -> Jacobian:
        """The Jacobian of all its keys."""
        if not fit.free:
            return self.jacobian
        columns = list(range(len(fit.keys)))
        return self.problem.jacobian(fit.keys, fit.z, fit.free, columns, fit.residuals)

    def grid_scan(self, start: Fit | None, noise_source: Fit | None) -> GridScan:
        """Grids of candidates that are added to a model; the latest is kept, as fits follow grids.

        Args:
            start: the model; None for the recalibrated one
            noise_source: the model whose noise is used; None for `start`
        """
        key = tuple(() if fit is None else (fit.keys, tuple(fit.z)) for fit in (start, noise_source))
        if self._scan is None or self._scan[0] != key:
            base = self.recalibrated if start is None else self.restore_residuals(start)
            self._scan = (key, GridScan(self.problem, base, self.jacobian_at(base), noise_source))
        return self._scan[1]


_open_problems: dict[str, _ProblemState] = {}


def open_problem(token: str, spec: ProblemSpec) -> OpenProblem:
    """Open a problem under a token, and close any other. Raises: InputError if the logs have nothing to compare."""
    _open_problems.clear()
    state = _open_problems[token] = _ProblemState(spec)
    model = state.residual_model
    if not model.target_properties:
        raise InputError(
            "the logs hold nothing that could be compared with a simulation",
            code="nothing_to_compare",
            key="LOG",
            hint="drive for a minute or more, above walking pace, with reports of actuators and motion",
        )
    return OpenProblem(
        recalibrated=_summarise(model, state.recalibrated),
        blocks=model.blocks,
        target_properties=model.target_properties,
        signal_scales={name: model.signal_scale(name) for name in model.target_properties},
        candidates=tuple(state.candidates.values()),
        untestable_effects=state.untestable_effects,
        nuisances=tuple(state.problem.nuisances.values()),
    )


def scan_candidates(
    token: str, names: Sequence[str], start: Fit | None, noise_source: Fit | None
) -> tuple[dict[str, StartPoint], dict[str, str]]:
    """Find the start value of each candidate.

    Args:
        start: the model that they are added to; None for the recalibrated one
        noise_source: the model whose noise is used; None for `start`

    Returns: start points by candidate; and the reason for each candidate of which no value gives a possible car
    """
    state, starts, impossible = _open_problems[token], {}, {}
    scan = state.grid_scan(start, noise_source)
    for name in names:
        try:
            starts[name] = scan.find_start(state.candidates[name].free)
        except InputError as error:  # the vehicle model allows no point of its grid
            impossible[name] = error.message
    return starts, impossible


def fit_candidates(
    token: str, starts: Mapping[str, StartPoint], start: Fit | None, min_gain: float, noise_source: Fit | None
) -> Generator[int, None, tuple[dict[str, FitSummary], dict[str, str]]]:
    """Fit each candidate by itself; yields how many are done.

    Args:
        starts: start points by candidate
        start: the model that they are added to; None for the recalibrated one
        min_gain: a candidate that gains less gets one step only
        noise_source: the model whose noise is used; None for `start`

    Returns: fits by candidate; and the reason for each candidate whose fit leaves the possible cars
    """
    state = _open_problems[token]
    scan = state.grid_scan(start, noise_source)
    fits, impossible = {}, {}
    for done, (name, begin) in enumerate(starts.items()):
        yield done
        try:
            fit = fit_candidate(scan, name, state.candidates[name].free, begin, min_gain)
            fits[name] = _summarise(state.residual_model, fit)
        except InputError as error:  # a step leaves the possible cars
            impossible[name] = error.message
    return fits, impossible


def refine_fits(token: str, fits: Sequence[Fit]) -> list[FitSummary]:
    """Refine models until nothing is gained, before others are compared with them."""
    state = _open_problems[token]
    return [_summarise(state.residual_model, refine_fit(state.problem, state.restore_residuals(fit))) for fit in fits]


def fit_without_effects(token: str, fit: Fit, names: Sequence[str]) -> dict[str, FitSummary]:
    """The model without each of these effects, by effect, the rest refitted."""
    state = _open_problems[token]
    return {name: _summarise(state.residual_model, fit_without_effect(state.problem, fit, name)) for name in names}


def assess_lack_of_fit(token: str, fits: Sequence[Fit], blocks: Array) -> list[dict[str, LackOfFit]]:
    """What could still be explained of each model's residuals, by target."""
    model = _open_problems[token].residual_model
    targets = [comparison.targets for comparison in model.comparisons]
    return [
        measure_lack_of_fit(
            model.spec.drives, targets, model.simulate_residuals(fit.values), model.target_blocks, blocks
        )
        for fit in fits
    ]


def describe_residual(token: str, fit: Fit, target: str) -> tuple[list[Region], Shape | None]:
    """Where in the drives a target is missed, and the shape of its residual, outside holdout blocks."""
    model = _open_problems[token].residual_model
    residual = model.simulate_residuals(fit.values)[target]
    dt_s = model.target_properties[target].dt_s
    shape = fit_shape(residual, model.measured_values(target), model.non_holdout_rows(target), dt_s)
    return find_regions(model, target, residual), shape


def measure_sensitivity(token: str, fit: Fit, key: str, delta_u: float) -> dict[str, float]:
    """RMS change of each target, in its unit, when one free parameter moves, outside holdout blocks.

    Args:
        delta_u: change to either side, in u; the result is the mean of both, or of the one that is a possible car
    """
    model, changes = _open_problems[token].residual_model, list[dict[str, float]]()
    i = fit.keys.index(key)
    free = next(parameter for parameter in fit.free if parameter.key == key)
    reference = model.simulate_residuals(fit.values)
    for u in (fit.z[i] - delta_u, fit.z[i] + delta_u):
        value = free.value_from_u(float(np.clip(u, free.u_min, free.u_max)))
        try:
            residuals = model.simulate_residuals({**fit.values, key: value})
        except InputError:
            continue
        changes.append(
            {
                name: rms_difference(pieces, residuals[name], model.non_holdout_rows(name))
                for name, pieces in reference.items()
            }
        )
    return {name: float(np.mean([change[name] for change in changes])) for name in reference} if changes else {}


def find_bursts(token: str, fits: Sequence[Fit], blocks: Array) -> list[dict[str, Burst]]:
    """The largest short residuals of each model, by target."""
    model = _open_problems[token].residual_model
    return [
        {
            name: measure_burst(
                TargetRows(residual, model.measured_values(name), model.valid_rows(name), model.target_blocks[name]),
                blocks,
                model.target_properties[name].dt_s,
            )
            for name, residual in model.simulate_residuals(fit.values).items()
        }
        for fit in fits
    ]


def close_problem(token: str) -> bool:
    """Close a problem. Returns: whether it was open."""
    return _open_problems.pop(token, None) is not None


def _summarise(model: ResidualModel, fit: Fit) -> FitSummary:
    squared, averaged = {}, {}
    for name, residual in fit.residuals.items():
        window_rows = max(round(AVERAGING_S / model.target_properties[name].dt_s), 1)
        squared[name] = _block_squares(model, name, residual, 1)
        averaged[name] = _block_squares(model, name, residual, window_rows)
    return FitSummary(fit._replace(residuals={}), squared, averaged)


def _block_squares(model: ResidualModel, name: str, residual: Sequence[Array], window_rows: int) -> tuple[Array, Array]:
    """Sums of squared window means, and numbers of windows, by block, each of shape (n_blocks,)."""
    sums, counts = np.zeros(model.blocks.count), np.zeros(model.blocks.count)
    for values, valid, block in zip(residual, model.valid_rows(name), model.target_blocks[name], strict=True):
        windows, window_blocks = cut_windows(values, valid, block, window_rows)
        np.add.at(sums, window_blocks, windows.mean(axis=1) ** 2)
        np.add.at(counts, window_blocks, 1.0)
    return sums, counts
