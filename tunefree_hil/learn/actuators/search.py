"""The search for structure and parameters of one by-wire channel (learn/actuators/identify.py)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.learn.actuators.model import (
    ActuatorModel,
    ActuatorScale,
    ActuatorStructure,
    estimate_peak_rate,
    exclude_rate_limited,
    model_from_unknowns,
    output_residuals,
    time_at_rate_limit_s,
    unknown_bounds,
    unknowns_from_values,
)
from tunefree_hil.learn.actuators.samples import ActuatorSamples, ChannelSamples
from tunefree_hil.learn.data_sheet import ChannelSheet
from tunefree_hil.learn.drives.smoothing import estimate_noise, estimate_quantum
from tunefree_hil.learn.robust_least_squares import RobustFit, SolverOptions, fit_robustly

Array = np.ndarray

GRID_DEAD_TIMES_S = (0.0, 0.02, 0.04, 0.07, 0.1, 0.14, 0.18, 0.25, 0.35, 0.5)
GRID_LAGS_S = (0.01, 0.03, 0.06, 0.12, 0.25, 0.5)


class SearchCriteria(NamedTuple):
    """Settings of the search; every value is an engineering choice."""

    starts: int = 2  # the best points of the grid, from which least squares start
    max_error_ratio: float = 0.995  # of the error of a richer structure to that of a simpler one, at most
    min_limit_s: float = 0.2  # time at the rate limit, for a structure with this unknown
    min_calm_rows: int = 500  # compared rows far from the rate limit, to fit on these alone
    onset_lags: float = 2.0  # time before the rate limit is reached in which it acts, in multiples of the lag
    release_lags: float = 6.0  # multiples of the lag for which it shows afterwards
    block_s: float = 2.0  # rows of one block count as correlated (robust_least_squares.py)
    soft_l1_sigmas: float = 4.0  # residuals beyond this weigh less
    min_span_rate: float = 0.05  # least peak rate, in spans of the command per s
    min_sigma_span: float = 1e-5  # least standard deviation, in spans of the command


SEARCH = SearchCriteria()


class SearchStart(NamedTuple):
    """A start of least squares."""

    dead_time_s: float
    lag_s: float


class StructureFit(NamedTuple):
    """A fitted structure."""

    structure: ActuatorStructure
    solution: RobustFit
    model: ActuatorModel
    error: float  # RMS in sigmas on the held-out segments, or on the training segments where there are none


class IdentificationCase(NamedTuple):
    """The data of a search."""

    training: Sequence[ActuatorSamples]
    held_out: Sequence[ActuatorSamples]
    scale: ActuatorScale
    blocks: Array  # the block of every compared training row, shape (n_compared,)
    rate_limit: float = math.inf  # of structures without this unknown


def build_case(training: ChannelSamples, held_out: ChannelSamples, sheet: ChannelSheet) -> IdentificationCase:
    """The samples of a channel with their scale."""
    command = np.concatenate([segment.command for segment in training.segments])
    outputs = [segment.output[segment.is_compared] for segment in training.segments]
    quantum = estimate_quantum(np.concatenate(outputs))
    noise = float(np.sqrt(np.mean([estimate_noise(output, quantum) ** 2 for output in outputs])))
    span = float(np.ptp(command))
    sigma = math.sqrt(noise * noise + quantum * quantum / 12.0 + (SEARCH.min_sigma_span * span) ** 2)
    rate = max(estimate_peak_rate(training.segments), SEARCH.min_span_rate * span)
    scale = ActuatorScale(sheet.rest, span, rate, sigma)
    return IdentificationCase(training.segments, held_out.segments, scale, _assign_blocks(training.segments))


def _assign_blocks(segments: Sequence[ActuatorSamples]) -> Array:
    blocks, first = [], 0
    for segment in segments:
        row_blocks = first + np.arange(len(segment.command)) // round(SEARCH.block_s / segment.dt_s)
        first = int(row_blocks[-1]) + 1
        blocks.append(row_blocks[segment.is_compared])
    return np.concatenate(blocks)


def without_rate_limited_rows(case: IdentificationCase, limited: StructureFit) -> IdentificationCase | None:
    """The case without rows near the rate limit, with a fixed rate limit; None where too few rows are left.

    Near its rate limit a real motor differs from the bench's actuator. Dead time and lag are those of small commands.
    """
    params = limited.model.params
    lag_s = params.lag_s if params.order == 1.0 else params.damping / (math.pi * max(params.natural_hz, 0.1))
    times_s = SEARCH.onset_lags * lag_s, params.dead_time_s + SEARCH.release_lags * lag_s
    training = exclude_rate_limited(limited.model, case.training, *times_s)
    held_out = exclude_rate_limited(limited.model, case.held_out, *times_s)
    n_compared = sum(int(segment.is_compared.sum()) for segment in training)
    if n_compared < SEARCH.min_calm_rows or (case.held_out and not held_out):
        return None
    return IdentificationCase(training, held_out, case.scale, _assign_blocks(training), params.rate_limit)


def search_start_grid(case: IdentificationCase) -> list[SearchStart]:
    """The best points of a grid, with neutral gain and offset and the output's peak rate as the rate limit."""
    points = []
    for lag_s in GRID_LAGS_S:
        for dead_time_s in GRID_DEAD_TIMES_S:
            start = SearchStart(dead_time_s, lag_s)
            residuals = _residuals_at_start(case, start)
            points.append((float(np.mean(np.minimum(np.abs(residuals), 1e6))), start))
    return [start for _, start in sorted(points)[: SEARCH.starts]]


def _residuals_at_start(case: IdentificationCase, start: SearchStart) -> Array:
    structure = ActuatorStructure(1, True)
    x = unknowns_from_values(structure, start._asdict(), case.scale)
    return output_residuals(model_from_unknowns(structure, x, case.scale), case.training, case.scale.sigma)


def scale_sigma_to_residuals(case: IdentificationCase, start: SearchStart) -> IdentificationCase:
    """The case with the residuals at a start as sigma, because a car's motion has other causes too.

    The noise of the sensor is far smaller. Relative to it every row would be an outlier, above all the steps of the
    command, which carry most of the information.
    """
    residuals = _residuals_at_start(case, start)
    ratio = max(float(np.sqrt(np.mean(residuals * residuals))), 1.0)
    return case._replace(scale=case.scale._replace(sigma=ratio * case.scale.sigma))


def fit_from_starts(
    case: IdentificationCase, structure: ActuatorStructure, starts: Sequence[SearchStart]
) -> StructureFit:
    """The best fit of a structure from all starts."""
    fits = [fit_structure(case, structure, start_values) for start_values in _start_values(structure, starts)]
    return min(fits, key=lambda fit: fit.solution.rms)


def _start_values(structure: ActuatorStructure, starts: Sequence[SearchStart]) -> list[dict[str, float]]:
    """For order 2: critically damped with the same delay, once with the same and once with a shorter dead time."""
    if structure.order < 2:
        return [start._asdict() for start in starts]
    values = []
    for start in starts[:1]:
        for dead_time_lags in (0.0, 0.5):
            dead_time_s = max(start.dead_time_s - dead_time_lags * start.lag_s, 0.0)
            delay_s = start.dead_time_s - dead_time_s + start.lag_s  # of two equal lags, half of it each
            values.append({"dead_time_s": dead_time_s, "natural_hz": 1.0 / (math.pi * delay_s)})
    return values


def fit_structure(case: IdentificationCase, structure: ActuatorStructure, values: dict[str, float]) -> StructureFit:
    """Fit a structure by least squares, starting at these values."""
    scale = case.scale
    low, high = unknown_bounds(structure, scale)

    def residuals(x: Array) -> Array:
        return output_residuals(model_from_unknowns(structure, x, scale, case.rate_limit), case.training, scale.sigma)

    start = unknowns_from_values(structure, values, scale)
    solution = fit_robustly(residuals, start, (low, high), case.blocks, SolverOptions(SEARCH.soft_l1_sigmas))
    model = model_from_unknowns(structure, solution.x, scale, case.rate_limit)
    return StructureFit(structure, solution, model, rms_error(case, model))


def rms_error(case: IdentificationCase, model: ActuatorModel) -> float:
    """RMS of the residuals in sigmas on the held-out segments, or on the training segments where there are none."""
    residuals = output_residuals(model, case.held_out or case.training, case.scale.sigma)
    return float(np.sqrt(np.mean(residuals * residuals)))


def choose_structure(case: IdentificationCase, candidates: Sequence[StructureFit]) -> StructureFit:
    """The first structure that no later, richer one improves; without a lag that is shorter than a tick."""
    usable = [
        fit
        for fit in candidates
        if not fit.structure.has_rate_limit or time_at_rate_limit_s(fit.model, case.training) >= SEARCH.min_limit_s
    ]
    best = usable[0]
    for fit in usable[1:]:
        if fit.error < SEARCH.max_error_ratio * best.error:
            best = fit
    dt_s = case.training[0].dt_s
    params = best.model.params
    if best.structure.order == 1 and params.lag_s < dt_s:
        structure = best.structure._replace(order=0, is_asymmetric=False)
        dead_times_s = (params.dead_time_s, max(params.dead_time_s - dt_s, 0.0))
        fits = [fit_structure(case, structure, {"dead_time_s": dead_time_s}) for dead_time_s in dead_times_s]
        without_lag = min(fits, key=lambda fit: fit.solution.rms)
        return without_lag if without_lag.error <= best.error / SEARCH.max_error_ratio else best
    return best


def explained_variance_share(case: IdentificationCase, model: ActuatorModel) -> float:
    """The share of the output's variance that the simulated channel explains."""
    residuals = output_residuals(model, case.training, case.scale.sigma) * case.scale.sigma
    output = np.concatenate([segment.output[segment.is_compared] for segment in case.training])
    return 1.0 - float(np.mean(residuals * residuals)) / max(float(np.var(output)), 1e-12)
