"""Oscillation of steering, pedals, acceleration and speed: the largest swing that a drive sustains, and where.

A signal oscillates with the amplitude that all of several half cycles in a row reach (peak to peak, 0.5 to 5 Hz), in
what the reference does not explain (residual.py). So one correction of the wheel is none, nor is what dies out within
three cycles, after the start or a re-plan as anywhere; re-plans that follow one another so fast that the wheel never
rests shake it. The value is continuous, also below its limit, as a search under constraints needs it. Pedals also
alternate: throttle and brake in turn more often than the reference accelerates and slows down.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.kernel import BATCH
from tunefree_hil.grade.metrics import MetricSamples
from tunefree_hil.grade.oscillation.report import (
    CRITERIA,
    METRIC_SIGNALS,
    DrivePlace,
    OscillationCriteria,
    OscillationFinding,
    OscillationReport,
    OscillationSignal,
)
from tunefree_hil.grade.oscillation.residual import PAD_S, BandResiduals, ExplainedSignals, band_residuals
from tunefree_hil.grade.oscillation.swings import (
    SustainedSwing,
    SwingBuffers,
    SwingRules,
    SwingSamples,
    find_sustained_swing_fast,
)

Array = np.ndarray


class SteeringResidual(NamedTuple):
    """The steering wheel and what the reference does not explain of it: shape (n_steps,), every dt_s."""

    signal: OscillationSignal
    wheel_rad: Array
    residual_rad: Array
    dt_s: float


class _SignalSource(NamedTuple):
    """Column of a signal and unit of its amplitude."""

    column: str
    unit: str


SOURCES = {
    OscillationSignal.STEER_COMMAND: _SignalSource("cmd_steer_rad", "rad"),
    OscillationSignal.STEER_MEASURED: _SignalSource("out_steer_rad", "rad"),
    OscillationSignal.ACCEL: _SignalSource("accel_mps2", "m/s2"),
    OscillationSignal.THROTTLE: _SignalSource("cmd_throttle_frac", "duty"),
    OscillationSignal.BRAKE: _SignalSource("cmd_brake_frac", "duty"),
    OscillationSignal.SPEED: _SignalSource("speed_mps", "m/s"),
}
NO_SWING_RATIO = 1e-6  # of its limit, which is the rounding of the transform
MIN_DRIVE_S = PAD_S + 1.0  # a shorter drive has no findings
_REFERENCES = ("ref_speed_mps", "ref_accel_mps2", "ref_curvature_1pm")
# what the reference asks of a signal; the wheel angle of a curvature grows with speed^2 by the understeer
_EXPLAINED_BY = (
    (("cmd_steer_rad", "out_steer_rad"), ("ref_curvature_1pm", "lateral_accel")),
    (("accel_mps2", "cmd_throttle_frac", "cmd_brake_frac"), ("accel_up", "accel_down")),
    (("speed_mps",), ("ref_speed_mps",)),
)


def find_oscillations(
    columns: Mapping[str, Array],
    dt_s: float,
    *,
    rest_pedal_frac: float = 0.0,
    criteria: OscillationCriteria = CRITERIA,
) -> OscillationReport:
    """The worst oscillation of each signal of a drive.

    Args:
        columns: Columns of a recording (docs/reference/files.md); a gap is bridged by a straight line. Signals that are
            absent have no finding; references that are absent explain nothing.
        rest_pedal_frac: Duty of a released pedal.
    """
    known = _finite_columns(columns)
    ticks = len(next(iter(known.values()), ()))
    if ticks * dt_s < MIN_DRIVE_S:
        return OscillationReport()
    findings = _find_swings(known, dt_s, criteria)
    alternation = _find_alternation(known, dt_s, rest_pedal_frac, criteria)
    return OscillationReport((*findings, *alternation))


def steering_residual(columns: Mapping[str, Array], dt_s: float) -> SteeringResidual | None:
    """The measured wheel, else its command; None where there is neither, or the drive is too short."""
    known = _finite_columns(columns)
    signals = (OscillationSignal.STEER_MEASURED, OscillationSignal.STEER_COMMAND)
    signal = next((one for one in signals if SOURCES[one].column in known), None)
    if signal is None or len(known[SOURCES[signal].column]) * dt_s < MIN_DRIVE_S:
        return None
    name = SOURCES[signal].column
    residuals = _residuals({**known, **_reference_columns(known)}, dt_s)
    assert residuals is not None
    residual = residuals.values[residuals.signals.index(name)]
    return SteeringResidual(signal, known[name][:: residuals.stride], residual, residuals.dt_s)


def with_references(columns: Mapping[str, Array], samples: MetricSamples) -> dict[str, Array]:
    """The columns of a recording with the reference of these samples: a re-plan's path would contain the swing."""
    known = {name: values for name in _REFERENCES if (values := getattr(samples, name)) is not None}
    return {**columns, **known}


def oscillation_metrics(report: OscillationReport, columns: Mapping[str, Array], dt_s: float) -> dict[str, float]:
    """Values of the rows of METRIC_SIGNALS that a recording with these columns has: amplitude / limit.

    None of them for a drive that is too short.
    """
    if len(next(iter(columns.values()))) * dt_s < MIN_DRIVE_S:
        return {}
    columns_of: dict[OscillationSignal, tuple[str, ...]] = {
        signal: (source.column,) for signal, source in SOURCES.items()
    }
    columns_of[OscillationSignal.PEDAL_ALTERNATION] = ("cmd_throttle_frac", "cmd_brake_frac")
    return {
        name: report.ratio_of(*signals)
        for name, signals in METRIC_SIGNALS.items()
        if any(columns.keys() >= set(columns_of[signal]) for signal in signals)
    }


def _finite_columns(columns: Mapping[str, Array]) -> dict[str, Array]:
    """The columns that are used, gaps bridged; one without any number is left out."""
    finite = {}
    for name in (*(source.column for source in SOURCES.values()), *_REFERENCES):
        values = columns.get(name)
        if values is None:
            continue
        is_known = np.isfinite(values)
        if not is_known.all():
            rows = np.flatnonzero(is_known)
            if len(rows) == 0:
                continue
            values = np.interp(np.arange(len(values)), rows, values[rows])
        finite[name] = values
    return finite


def _reference_columns(known: Mapping[str, Array]) -> dict[str, Array]:
    """What the reference asks for, beside its own columns."""
    speed, accel, curvature = (known.get(name) for name in _REFERENCES)
    columns = {}
    if accel is not None:
        columns |= {"accel_up": np.maximum(accel, 0.0), "accel_down": np.minimum(accel, 0.0)}
    if speed is not None and curvature is not None:
        columns["lateral_accel"] = curvature * speed * speed
    return columns


def _residuals(columns: Mapping[str, Array], dt_s: float) -> BandResiduals | None:
    """The residuals of all signals that there are. columns: with those of `_reference_columns`."""
    groups = [
        ExplainedSignals(present, [name for name in references if name in columns])
        for signals, references in _EXPLAINED_BY
        if (present := [name for name in signals if name in columns])
    ]
    return band_residuals(columns, groups, dt_s) if groups else None


def _find_swings(known: Mapping[str, Array], dt_s: float, criteria: OscillationCriteria) -> list[OscillationFinding]:
    columns = {**known, **_reference_columns(known)}
    residuals = _residuals(columns, dt_s)
    if residuals is None:
        return []
    limits = _limits(known, residuals.stride, criteria)
    duration_s = len(residuals.values[0]) * residuals.dt_s
    half_cycles, begin_s = criteria.half_cycles, criteria.start_s
    if duration_s < criteria.early_end_s:
        half_cycles, begin_s = criteria.early_half_cycles, 0.0
    rules = SwingRules(half_cycles, criteria.max_half_cycle_s, begin_s, criteria.run_share, criteria.motion_share)
    findings = []
    for signal, source in SOURCES.items():
        if source.column not in residuals.signals:
            continue
        i = residuals.signals.index(source.column)
        limit = limits[signal] + criteria.explained_share * residuals.explained_range[i]
        measured, explained = known[source.column][:: residuals.stride], residuals.explained[i]
        swing = _sustained(residuals.values[i] / limit, (measured - explained) / limit, residuals.dt_s, rules)
        if swing.largest.range > NO_SWING_RATIO:
            # a reference explains swings away; those of the explanation itself are none of the signal
            band = (residuals.values[i] + explained) / limit
            swing = min(swing, _sustained(band, measured / limit, residuals.dt_s, rules), key=_range_of)
        run = swing.largest
        if run.range <= NO_SWING_RATIO:
            continue
        steps = slice(round(run.start_s / residuals.dt_s), round(run.end_s / residuals.dt_s) + 1)
        limit_there = float(np.mean(limit[steps]))
        around = swing.around
        frequency_hz = 0.5 * around.half_cycles / (around.end_s - around.start_s)
        setting = _setting(columns, slice(*(round(s / dt_s) for s in (run.start_s, run.end_s))), criteria)
        spread = (around.start_s, around.end_s)
        amplitude = run.range * limit_there
        findings.append(
            OscillationFinding(signal, amplitude, limit_there, source.unit, frequency_hz, *spread, *setting)
        )
    return findings


def _range_of(swing: SustainedSwing) -> float:
    return swing.largest.range


class _DriveSetting(NamedTuple):
    place: DrivePlace
    speed_mps: float


def _setting(columns: Mapping[str, Array], rows: slice, criteria: OscillationCriteria) -> _DriveSetting:
    """Place and mean speed of these rows by the reference, or by the measured speed where there is none."""
    speed = columns.get("ref_speed_mps", columns.get("speed_mps"))
    speed_mps = 0.0 if speed is None else float(np.mean(speed[rows]))
    if speed is not None and abs(speed_mps) < criteria.rest_speed_mps:
        return _DriveSetting(DrivePlace.AT_REST, speed_mps)
    lateral = columns.get("lateral_accel")
    in_turn = lateral is not None and float(np.mean(np.abs(lateral[rows]))) > criteria.turn_accel_mps2
    return _DriveSetting(DrivePlace.IN_TURN if in_turn else DrivePlace.STRAIGHT, speed_mps)


def _limits(known: Mapping[str, Array], stride: int, criteria: OscillationCriteria) -> dict[OscillationSignal, Array]:
    """Limit of each signal: at every step of the residuals for the steering, else one number."""
    speed = known.get("speed_mps", known.get("ref_speed_mps"))
    steer = np.array(criteria.steer_rad)
    if speed is not None:
        slower = criteria.steer_speed_mps / np.maximum(np.abs(speed[::stride]), 1e-3)
        steer = np.clip(criteria.steer_rad * slower * slower, criteria.steer_rad, criteria.max_steer_rad)
    pedal = np.array(criteria.pedal_frac)
    return {
        OscillationSignal.STEER_COMMAND: steer,
        OscillationSignal.STEER_MEASURED: steer,
        OscillationSignal.ACCEL: np.array(criteria.accel_mps2),
        OscillationSignal.THROTTLE: pedal,
        OscillationSignal.BRAKE: pedal,
        OscillationSignal.SPEED: np.array(criteria.speed_mps),
    }


def _sustained(values: Array, motions: Array, dt_s: float, rules: SwingRules) -> SustainedSwing:
    count = len(values)
    if BATCH:
        samples = SwingSamples(values, motions, count, dt_s)
        return find_sustained_swing_fast(samples, rules, SwingBuffers(*np.empty((4, count + 1))))
    buffers = SwingBuffers(*([0.0] * (count + 1) for _ in range(4)))  # lists are faster to index in plain Python
    return find_sustained_swing_fast(SwingSamples(values.tolist(), motions.tolist(), count, dt_s), rules, buffers)


def _find_alternation(
    known: Mapping[str, Array], dt_s: float, rest_frac: float, criteria: OscillationCriteria
) -> list[OscillationFinding]:
    """The largest rate at which throttle and brake take turns `criteria.switches` times, beyond the reference's own."""
    throttle, brake = known.get("cmd_throttle_frac"), known.get("cmd_brake_frac")
    if throttle is None or brake is None:
        return []
    active = rest_frac + criteria.active_frac
    rows = _switch_rows(throttle > active, brake > active)
    if len(rows) < criteria.switches:
        return []
    first, last = rows[: len(rows) - criteria.switches + 1], rows[criteria.switches - 1 :]
    accel = known.get("ref_accel_mps2")
    reference_rows = np.empty(0, dtype=int)
    if accel is not None:
        reference_rows = _switch_rows(accel > criteria.asked_accel_mps2, accel < -criteria.asked_accel_mps2)
    margin = round(criteria.asked_margin_s / dt_s)
    explained = np.searchsorted(reference_rows, last + margin, side="right") - np.searchsorted(
        reference_rows, first - margin
    )
    rates = np.maximum(criteria.switches - 1 - explained, 0) / ((last - first) * dt_s)
    worst = int(np.argmax(rates))
    rate = float(rates[worst])
    if rate == 0.0:
        return []
    start_s, end_s = float(first[worst]) * dt_s, float(last[worst]) * dt_s
    setting = _setting({**known, **_reference_columns(known)}, slice(int(first[worst]), int(last[worst])), criteria)
    signal, limit = OscillationSignal.PEDAL_ALTERNATION, criteria.switches_per_s
    return [OscillationFinding(signal, rate, limit, "1/s", 0.5 * rate, start_s, end_s, *setting)]


def _switch_rows(up: Array, down: Array) -> Array:
    """Rows at which `up` follows `down` or the other way round, whatever lies between; `down` wins where both are."""
    sides = np.where(down, -1, np.where(up, 1, 0))
    rows = np.flatnonzero(sides)
    return rows[1:][np.diff(sides[rows]) != 0]
