"""Identifies a by-wire channel: dead time, lag of order 1 or 2, rate limit, dead band, gain and offset.

The actuator kernel of the bench is simulated with the recorded commands and compared with the recorded outputs: first a
coarse grid of dead time and lag, then least squares. Order and rate limit follow from the error on held-out parts. If
the rate limit was reached, dead time and lag are fitted again far from it. A value that the logs do not identify is
taken from the data sheet, with a wider interval and the reason.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.actuators.model import (
    BOUNDS,
    ActuatorScale,
    ActuatorStructure,
    output_residuals,
    value_from_unknown,
)
from tunefree_hil.learn.actuators.samples import CHANNELS, ChannelSamples, clip_to_stops, collect_samples
from tunefree_hil.learn.actuators.samples_from_motion import MotionLaw, fit_motion_law, samples_from_motion
from tunefree_hil.learn.actuators.search import (
    SEARCH,
    IdentificationCase,
    SearchStart,
    StructureFit,
    build_case,
    choose_structure,
    explained_variance_share,
    fit_from_starts,
    fit_structure,
    rms_error,
    scale_sigma_to_residuals,
    search_start_grid,
    without_rate_limited_rows,
)
from tunefree_hil.learn.data_sheet import ChannelSheet, is_accel_commanded
from tunefree_hil.learn.drives.drive import DriveSplit
from tunefree_hil.learn.drives.smoothing import estimate_noise, estimate_quantum
from tunefree_hil.learn.drives.validity import DRIVING_CHANNELS
from tunefree_hil.learn.estimate import (
    HALF_WIDTH_95,
    ActuatorFit,
    Estimate,
    make_exact_estimate,
    make_unidentified_estimate,
)

TIMES = ("dead_time_s", "lag_s")
BASIC_STRUCTURES = (
    ActuatorStructure(1, False),
    ActuatorStructure(1, False, is_asymmetric=True),
    ActuatorStructure(2, False),
)
LIMITED_STRUCTURES = (ActuatorStructure(1, True), ActuatorStructure(2, True))
MOTION_STRUCTURES = (ActuatorStructure(1, False), ActuatorStructure(2, False))  # the motion identifies no more


class IdentificationCriteria(NamedTuple):
    """When the logs identify a channel or one of its values; every value is an engineering choice."""

    min_reports: int = 300  # of the output, that can be compared
    min_changes: int = 8  # of the command, each by min_change_share of its span
    min_change_share: float = 0.02  # of the span of the command: what counts as a change
    change_interval_s: float = 0.2  # between two compared commands, so that a ramp is a change too
    min_span_steps: float = 5.0  # quantisation steps that the command covers
    min_explained_share: float = 0.5  # of the output's variance, by the command
    min_small_reports: int = 100  # with small commands, for a dead band
    small_share: float = 0.1  # of the span, that counts as a small command
    rest_share: float = 0.002  # of the span, that counts as at rest
    start_dead_band_share: float = 0.02  # of the span, where the fit of a dead band starts
    time_resolution_ticks: float = 0.1  # least half width of the interval of a time
    max_scaled_unknown: float = 200.0  # limit of an interval; wider ones have no meaning
    max_dead_time_half_width_s: float = 0.1  # of the interval of a known dead time
    max_interval_ratio: float = 10.0  # of the ends of the interval of a known lag, frequency or damping ...
    min_wide_end: float = 0.1  # ... whose upper end exceeds this (s, Hz or 1)
    max_unknown_end: float = 1e3  # upper end of the interval of an unknown value
    max_lag_share: float = 0.95  # of the longest lag in the search; a longer one is slow motion of the car


IDENTIFICATION = IdentificationCriteria()


class DataSheetIntervals(NamedTuple):
    """Intervals of values that only the data sheet gives; every value is an engineering choice."""

    max_time_ratio: float = 2.0  # upper end of a dead time or a lag, in multiples of the stated one ...
    extra_time_s: float = 0.1  # ... plus this
    min_rate_ratio: float = 0.5  # lower end of a rate limit, in multiples of the stated one
    max_dead_band: float = 0.02  # in the channel's unit, as the next
    max_offset: float = 0.02
    max_gain_error: float = 0.1


DATA_SHEET = DataSheetIntervals()


class ChannelSources(NamedTuple):
    """The samples of a channel; law: the motion law that they were made with, None for a reported output."""

    training: ChannelSamples
    held_out: ChannelSamples
    law: MotionLaw | None


class _IdentifiedChannel(NamedTuple):
    """The result of a search: full_case has all rows, case only those far from a rate limit that was reached."""

    case: IdentificationCase
    full_case: IdentificationCase
    chosen: StructureFit
    rate_limit: Estimate
    dead_band: Estimate


def fit(
    training: ChannelSamples, held_out: ChannelSamples, sheet: ChannelSheet, has_echo: bool = True
) -> Generator[Any, None, ActuatorFit]:
    """Identify one channel; yields (done, total) steps.

    A channel that is not excited, or whose output does not follow, gets the values of its data sheet.

    Args:
        has_echo: whether command and output come from the same report.
    """
    problem = excitation_problem(training)
    if problem:
        return fit_from_data_sheet(sheet, problem)
    case = build_case(training, held_out, sheet)
    is_from_motion = any(segment.filter_ticks for segment in training.segments)
    structures = MOTION_STRUCTURES if is_from_motion else (*BASIC_STRUCTURES, *LIMITED_STRUCTURES)
    total = len(structures) + 3
    yield 0, total
    starts = search_start_grid(case)
    if is_from_motion:
        case = scale_sigma_to_residuals(case, starts[0])
    candidates = yield from _fit_structures(case, structures, starts, total)
    chosen = choose_structure(case, candidates)
    share = explained_variance_share(case, chosen.model)
    if share < IDENTIFICATION.min_explained_share:
        reason = f"the output does not follow the command, which explains {max(share, 0.0):.0%} of it"
        return fit_from_data_sheet(sheet, reason)
    rate_limit = unreached_rate_limit(sheet, case.scale.rate)
    full_case = case
    if chosen.structure.has_rate_limit:
        rate_limit = _estimate_unknown(chosen, "rate_limit", case.scale)
        calm_case = without_rate_limited_rows(case, chosen)
        if calm_case is not None:
            yield total - 2, total
            case, chosen = calm_case, _refit_without_limit(calm_case, chosen)
    yield total - 1, total
    chosen, dead_band = _fit_dead_band(case, chosen)
    yield total, total
    result = _as_actuator_fit(_IdentifiedChannel(case, full_case, chosen, rate_limit, dead_band), training)
    return result if has_echo else widen_without_echo(result, training.segments[0].dt_s)


def _fit_structures(
    case: IdentificationCase, structures: Sequence[ActuatorStructure], starts: Sequence[SearchStart], total: int
) -> Generator[Any, None, list[StructureFit]]:
    """Fit each structure; yields (done, total) steps."""
    candidates = []
    for i, structure in enumerate(structures):
        yield i + 1, total
        candidates.append(fit_from_starts(case, structure, starts))
    return candidates


def _refit_without_limit(calm_case: IdentificationCase, limited: StructureFit) -> StructureFit:
    """Dead time and lag from the rows far from the rate limit."""
    params = limited.model.params
    lag_s = params.lag_s if params.order == 1.0 else 1.0 / (math.pi * params.natural_hz)
    starts = [SearchStart(params.dead_time_s, lag_s)]
    return choose_structure(calm_case, [fit_from_starts(calm_case, basic, starts) for basic in BASIC_STRUCTURES])


def _fit_dead_band(case: IdentificationCase, chosen: StructureFit) -> tuple[StructureFit, Estimate]:
    """(the fit, with a dead band where the logs show one; the dead band)."""
    n_small = _count_small_commands(case)
    max_band = IDENTIFICATION.small_share * case.scale.span
    if n_small < IDENTIFICATION.min_small_reports:
        reason = f"{n_small} reports have a small command off rest, {IDENTIFICATION.min_small_reports} are needed"
        return chosen, Estimate(0.0, 0.0, max_band, False, f"{reason}; neutral value")
    structure = chosen.structure._replace(has_dead_band=True)
    params = {**chosen.model.params._asdict(), "asymmetry": chosen.model.asymmetry}
    values = {name: params[name] for name in chosen.structure.unknown_names()}
    start_band = IDENTIFICATION.start_dead_band_share * case.scale.span
    with_dead_band = fit_structure(case, structure, {**values, "dead_band": start_band})
    estimate = _estimate_unknown(with_dead_band, "dead_band", case.scale)
    if estimate.low > 0.0 and with_dead_band.error < SEARCH.max_error_ratio * chosen.error:
        return with_dead_band, estimate
    if estimate.high <= max_band:
        return chosen, Estimate(0.0, 0.0, max(estimate.high, 0.0), True, "the logs show none")
    reason = "small commands do not distinguish it from the offset; neutral value"
    return chosen, Estimate(0.0, 0.0, max_band, False, reason)


def _count_small_commands(case: IdentificationCase) -> int:
    """Reports whose command is near rest, but not at rest."""
    rest, span = case.scale.rest, case.scale.span
    count = 0
    for segment in case.training:
        distance = np.abs(segment.command - rest)
        is_small = (distance < IDENTIFICATION.small_share * span) & (distance > IDENTIFICATION.rest_share * span)
        count += int(np.sum(segment.is_compared & is_small))
    return count


def _as_actuator_fit(identified: _IdentifiedChannel, training: ChannelSamples) -> ActuatorFit:
    """The values with their intervals, in the form of a model."""
    case, chosen = identified.case, identified.chosen
    structure, sigma = chosen.structure, case.scale.sigma
    output = np.concatenate([segment.output[segment.is_compared] for segment in case.training])
    quantum = estimate_quantum(output)
    values = _estimate_values(case, chosen)
    age_half_width_s = HALF_WIDTH_95 * training.command_age_std_s
    dead_time_s = clip_interval_at_zero(widen_interval(values["dead_time_s"], age_half_width_s))
    lag_s = values.get("lag_s", make_exact_estimate(0.0))
    if structure.order == 0:
        dead_time_s, lag_s = _times_without_lag(case, dead_time_s)
    elif structure.is_asymmetric:
        lag_s = _mean_lag(chosen, lag_s)
    # unlike the output, its residuals have no corners
    residuals = [output_residuals(chosen.model, [segment], 1.0) for segment in case.training]
    noise = math.sqrt(float(np.mean([estimate_noise(piece, quantum) ** 2 for piece in residuals])))
    model = chosen.model.symmetric_model()
    model = model._replace(params=model.params._replace(rate_limit=identified.rate_limit.value))
    return ActuatorFit(
        dead_time_s=dead_time_s,
        order=max(structure.order, 1),
        lag_s=lag_s,
        natural_hz=values.get("natural_hz", make_exact_estimate(0.0)),
        damping=values.get("damping", make_exact_estimate(1.0)),
        rate_limit=identified.rate_limit,
        dead_band=identified.dead_band,
        gain=values["gain"],
        offset=widen_interval(values["offset"], 0.5 * quantum),
        noise=noise,
        quantum=quantum,
        error=rms_error(identified.full_case, model) * sigma if case.held_out else math.nan,
        rows=training.n_rows,
        report=training.description,
    )


def _estimate_values(case: IdentificationCase, chosen: StructureFit) -> dict[str, Estimate]:
    """The fitted values by the names of ActuatorFit."""
    values: dict[str, Estimate] = {}
    for name in chosen.structure.unknown_names():
        if name in ActuatorFit._fields:
            estimate = _estimate_unknown(chosen, name, case.scale)
            if name in TIMES:
                resolution_s = IDENTIFICATION.time_resolution_ticks * case.training[0].dt_s
                estimate = clip_interval_at_zero(widen_interval(estimate, resolution_s))
            values[name] = mark_uncertain(name, estimate)
    return values


def _times_without_lag(case: IdentificationCase, dead_time_s: Estimate) -> tuple[Estimate, Estimate]:
    """(dead time, lag) of a channel whose lag is too short to be seen."""
    half_tick_s = 0.5 * case.training[0].dt_s
    reason = "too short for the reports to distinguish it from dead time"
    dead_time_s = clip_interval_at_zero(widen_interval(dead_time_s, half_tick_s, reason))
    if any(segment.filter_ticks for segment in case.training):
        reason = "the motion does not distinguish it from dead time"
        return dead_time_s, Estimate(0.0, 0.0, dead_time_s.high, False, reason)
    return dead_time_s, Estimate(0.0, 0.0, half_tick_s, True, reason)


def _mean_lag(chosen: StructureFit, lag_s: Estimate) -> Estimate:
    """The lag for the bench's actuator, of a channel with different lags upwards and downwards."""
    asymmetry = chosen.model.asymmetry
    ratio = math.cosh(asymmetry)
    up_ms, down_ms = (1e3 * lag_s.value * math.exp(sign * asymmetry) for sign in (1.0, -1.0))
    reason = f"the mean of {up_ms:.0f} ms upwards and {down_ms:.0f} ms downwards"
    return Estimate(lag_s.value * ratio, lag_s.low * ratio, lag_s.high * ratio, lag_s.known, reason)


def _estimate_unknown(structure_fit: StructureFit, name: str, scale: ActuatorScale) -> Estimate:
    """A parameter of the fitted model with its interval."""
    low, high = structure_fit.solution.interval(structure_fit.structure.unknown_names().index(name))
    limit = IDENTIFICATION.max_scaled_unknown
    low, high = value_from_unknown(name, max(low, -limit), scale), value_from_unknown(name, min(high, limit), scale)
    return Estimate(getattr(structure_fit.model.params, name), low, high)


def model_channels(vehicle: VehicleSpec) -> list[str]:
    """The channels of a vehicle's model: the inputs of its plant, and all others that are commanded."""
    needed = ("accel", "steer") if is_accel_commanded(vehicle) else DRIVING_CHANNELS
    return [name for name in CHANNELS if name in needed or CHANNELS[name] in vehicle.command]


def collect_channel(split: DriveSplit, channel: str, vehicle: VehicleSpec) -> ChannelSources:
    """Training and held-out samples of a channel from its reported output, or else from the car's motion."""
    training, held_out = collect_samples(split.training, channel), collect_samples(split.held_out, channel)
    has_output = training.segments or held_out.segments
    law = None if has_output else fit_motion_law(split.training, channel, vehicle)
    if law is None:
        return ChannelSources(*clip_to_stops(training, held_out), None)
    training = samples_from_motion(split.training, law, vehicle)
    return ChannelSources(training, samples_from_motion(split.held_out, law, vehicle), law)


def excitation_problem(samples: ChannelSamples) -> str:
    """The reason why these samples cannot identify a channel, '' where they can."""
    criteria = IDENTIFICATION
    if not samples.segments:
        return "the logs hold no samples of both command and output"
    if samples.n_rows < criteria.min_reports:
        return f"only {samples.n_rows} reports can be compared, {criteria.min_reports} are needed"
    command = np.concatenate([segment.command for segment in samples.segments])
    span = float(np.ptp(command))
    step = max(estimate_quantum(command), 1e-9)
    compared_commands = [
        segment.command[:: max(round(criteria.change_interval_s / segment.dt_s), 1)] for segment in samples.segments
    ]
    min_change = criteria.min_change_share * span
    n_changes = sum(int(np.sum(np.abs(np.diff(commands)) > min_change)) for commands in compared_commands)
    if span <= criteria.min_span_steps * step or n_changes < criteria.min_changes:
        low, high = float(command.min()), float(command.max())
        return f"its command is constant, or nearly so ({low:.4g} to {high:.4g}, {n_changes} changes)"
    return ""


def fit_from_data_sheet(sheet: ChannelSheet, reason: str) -> ActuatorFit:
    """The data sheet values of a channel, with wide intervals. reason: why the logs do not identify it."""
    reason = f"{reason}; {'data sheet' if sheet.is_stated else 'neutral value, none is stated'}"

    def widened(value: float, low: float, high: float) -> Estimate:
        return Estimate(value, low, high, False, reason)

    def widened_time(value: float) -> Estimate:
        return widened(value, 0.0, DATA_SHEET.max_time_ratio * value + DATA_SHEET.extra_time_s)

    rate_limit = sheet.rate_limit
    return ActuatorFit(
        dead_time_s=widened_time(sheet.dead_time_s),
        order=1,
        lag_s=widened_time(sheet.lag_s),
        natural_hz=make_exact_estimate(0.0),
        damping=make_exact_estimate(1.0),
        rate_limit=widened(
            rate_limit, DATA_SHEET.min_rate_ratio * rate_limit if math.isfinite(rate_limit) else 0.0, math.inf
        ),
        dead_band=widened(0.0, 0.0, DATA_SHEET.max_dead_band),
        gain=widened(1.0, 1.0 - DATA_SHEET.max_gain_error, 1.0 + DATA_SHEET.max_gain_error),
        offset=widened(0.0, -DATA_SHEET.max_offset, DATA_SHEET.max_offset),
        report=reason,
    )


def unreached_rate_limit(sheet: ChannelSheet, peak_rate: float) -> Estimate:
    """A rate limit that the drives did not reach: the data sheet's, unless the output was faster."""
    reason = f"not reached: the output moved at {peak_rate:.3g} per s at most"
    if sheet.rate_limit >= peak_rate and math.isfinite(sheet.rate_limit):
        return make_unidentified_estimate(sheet.rate_limit, f"{reason}; data sheet", low=peak_rate, high=math.inf)
    return make_unidentified_estimate(math.inf, f"{reason}; none is stated", low=peak_rate, high=math.inf)


def mark_uncertain(name: str, estimate: Estimate) -> Estimate:
    """The same number, marked as unknown if its interval is too wide to mean anything."""
    criteria = IDENTIFICATION
    low, high = max(estimate.low, 0.0 if name in TIMES else estimate.low), estimate.high
    if name == "dead_time_s":
        is_too_wide = high - low > 2.0 * criteria.max_dead_time_half_width_s
    elif name in ("lag_s", "natural_hz", "damping"):
        is_too_wide = high > criteria.max_interval_ratio * max(low, 1e-9) and high > criteria.min_wide_end
    else:
        return estimate
    if not is_too_wide:
        return estimate
    return Estimate(estimate.value, low, min(high, criteria.max_unknown_end), False, "these logs hardly show it")


def widen_interval(estimate: Estimate, margin: float, reason: str = "") -> Estimate:
    """The same value with an interval that is wider by the margin on both sides."""
    return estimate._replace(low=estimate.low - margin, high=estimate.high + margin, why=reason or estimate.why)


def clip_interval_at_zero(estimate: Estimate) -> Estimate:
    """The same value with an interval that does not go below 0."""
    return estimate._replace(low=max(estimate.low, 0.0))


def restrict_to_motion(channel: ActuatorFit, sheet: ChannelSheet) -> ActuatorFit:
    """Keep only the times of a channel that was identified from the motion alone.

    The effect of a command belongs to the plant, and the lag may include the car's own response. If the motion shows
    neither dead time nor lag, all values are those of the data sheet.
    """
    if not _has_times(channel):
        return fit_from_data_sheet(sheet, "the motion hardly shows it, and no output is reported")
    reason = "known from the motion only: the effect of a command is fitted as a constant of the plant"
    lag_reason = "known from the motion only: it includes the car's own response"
    times: dict[str, Estimate] = {}
    if channel.order == 1:
        times["lag_s"] = channel.lag_s._replace(low=0.0, why=channel.lag_s.why or lag_reason)
    else:
        high, why = IDENTIFICATION.max_unknown_end, channel.natural_hz.why or lag_reason
        times["natural_hz"] = channel.natural_hz._replace(high=high, why=why)
    return channel._replace(
        rate_limit=Estimate(math.inf, 0.0, math.inf, False, reason),
        dead_band=make_exact_estimate(0.0, reason),
        gain=make_exact_estimate(1.0, reason),
        offset=make_exact_estimate(0.0, reason),
        **times,
    )


def _has_times(channel: ActuatorFit) -> bool:
    """Whether the motion shows a time of a channel.

    A lag near the longest in the search does not count: it may be slow motion of the car under a constant command.
    """
    lag = channel.lag_s if channel.order == 1 else channel.natural_hz
    max_lag_s = IDENTIFICATION.max_lag_share * BOUNDS.lag_s[1]
    is_too_long = channel.order == 1 and channel.lag_s.value > max_lag_s
    return not is_too_long and (channel.dead_time_s.known or lag.known)


def widen_without_echo(channel: ActuatorFit, dt_s: float) -> ActuatorFit:
    """Widen the dead time by a tick each way, because without an echo the delay of the bus is not known."""
    reason = "without an echo of the command the bench's bus delay is assumed, with one tick of doubt in each direction"
    return channel._replace(dead_time_s=clip_interval_at_zero(widen_interval(channel.dead_time_s, 2.0 * dt_s, reason)))
