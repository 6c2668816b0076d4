"""Profile of a drive: all metrics of table.py with their sample counts, and the combination of several drives.

A metric that is not available is None with a reason, never 0. The weighed metrics equal those of grade/score.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.control.schedule import PULL_AWAY_MPS2, STOPPED_MPS
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.metrics import (
    AS_PUBLISHED,
    MetricEvaluator,
    MetricFormula,
    MetricScales,
    is_formula_planned,
    samples_from_plan,
    samples_from_recording,
)
from tunefree_hil.grade.original_reference import samples_against_original
from tunefree_hil.grade.oscillation.detection import (
    MIN_DRIVE_S,
    SteeringResidual,
    find_oscillations,
    oscillation_metrics,
    steering_residual,
    with_references,
)
from tunefree_hil.grade.oscillation.report import METRIC_SIGNALS, OscillationReport
from tunefree_hil.grade.path_projection import rear_axle_stations
from tunefree_hil.grade.score import CONTROL_ERRORS, GradeVehicle
from tunefree_hil.grade.signals import FormulaContext
from tunefree_hil.grade.table import FORMULAS, TABLE, Aggregation, MetricRow

Array = np.ndarray

NO_BENCH = "no bench log, so errors of the controller are not known"
NO_SWING = f"the signal was not recorded, or for less than {MIN_DRIVE_S:g} s"
NO_TIMES = "compute times of the controller were not recorded"


class MetricValue(NamedTuple):
    """A metric of one or several drives. n: number of samples. why: the reason where value is None."""

    value: float | None
    n: int = 0
    why: str = ""


class DriveExtras(NamedTuple):
    """Data of a drive beside its columns. error: name of what ended it, '' for nothing, None where not known."""

    control_time_s: Array | None = None
    error: str | None = None


class ProfileSettings(NamedTuple):
    """How metrics are computed, as weights say.

    Attributes:
        against: Reference of the errors, the 'original' or the 'current' trajectory.
        as_published: Whether the source's slip in heading_err_rate_std_harsh is kept.
    """

    against: str = "original"
    as_published: bool = False


NO_EXTRAS, DEFAULT_SETTINGS = DriveExtras(), ProfileSettings()


def profile_drive(
    recording: Recording,
    course: Course,
    vehicle: GradeVehicle,
    settings: ProfileSettings = DEFAULT_SETTINGS,
    extras: DriveExtras = NO_EXTRAS,
) -> dict[str, MetricValue]:
    """All metrics of TABLE."""
    scales = MetricScales(vehicle.wheelbase_m, vehicle.steer_rad, vehicle.steer_rate_radps, recording.dt_s)
    if settings.against == "original":
        samples = samples_against_original(recording, course, vehicle.rear_axle_m)
    else:
        samples = samples_from_recording(recording)
    evaluator, plan = MetricEvaluator(samples, scales), samples_from_plan(course)
    signals = _signals(recording, course, extras)
    oscillation = find_drive_oscillations(recording, course, vehicle)
    ratios = oscillation_metrics(oscillation, recording.columns, recording.dt_s)
    signals |= {name: np.array([ratio]) for name, ratio in ratios.items()}
    for name, series in samples._asdict().items():  # a recorded error may have no counterpart against the path
        signals.pop(name, None)
        signals |= {} if series is None else {name: series}
    context = FormulaContext(scales, vehicle.rest_pedal_frac, planned_stops(course))
    values = {}
    for name, row in TABLE.items():
        missing = next((need for need in row.needs if need not in signals), "")
        if missing:
            values[name] = MetricValue(None, why=_why_missing(missing, extras))
        elif row.formula is not None:
            values[name] = summarise_series(row, row.formula(signals, context))
        else:
            formula = AS_PUBLISHED.get(name, FORMULAS[name]) if settings.as_published else FORMULAS[name]
            if is_formula_planned(formula, plan):
                values[name] = _evaluate_formula(formula, evaluator)
            else:
                values[name] = MetricValue(None, why="this course plans no such samples")
    return values


def find_drive_oscillations(recording: Recording, course: Course, vehicle: GradeVehicle) -> OscillationReport:
    """The oscillations of a drive, against the original path whatever its errors are against."""
    columns = with_references(recording.columns, samples_against_original(recording, course, vehicle.rear_axle_m))
    return find_oscillations(columns, recording.dt_s, rest_pedal_frac=vehicle.rest_pedal_frac)


def find_steering_residual(recording: Recording, course: Course, vehicle: GradeVehicle) -> SteeringResidual | None:
    """The steering wheel of a drive and what the original path does not explain of it, for a figure."""
    columns = with_references(recording.columns, samples_against_original(recording, course, vehicle.rear_axle_m))
    return steering_residual(columns, recording.dt_s)


def summarise_series(row: MetricRow, series: Array) -> MetricValue:
    """Aggregate a series to one value; non-finite samples do not count."""
    finite = series[np.isfinite(series)]
    n = len(finite)
    if n < row.min_samples:
        return MetricValue(None, n, _too_few(n))
    if row.aggregation == "std":
        return MetricValue(math.sqrt(float(finite @ finite) / (n - 1)), n)
    if row.aggregation == "peak":
        return MetricValue(float(np.abs(finite).max()), n)
    if row.aggregation == "share":
        return MetricValue(float(np.count_nonzero(finite >= row.limit)) / n, n)
    return MetricValue(float(finite.mean()), n)


def combine_values(aggregation: Aggregation, values: Sequence[MetricValue]) -> MetricValue:
    """Combine one metric's values of several drives; None values do not count. None where all are None."""
    known = [one for one in values if one.value is not None]
    if not known:
        return MetricValue(None, 0, values[0].why if values else "no drive")
    total = sum(one.n for one in known)
    numbers = [(one.value or 0.0, one.n) for one in known]
    if aggregation == "peak":
        return MetricValue(max(value for value, _ in numbers), total)
    if aggregation == "std":
        return MetricValue(math.sqrt(sum(value * value * (n - 1) for value, n in numbers) / (total - 1)), total)
    return MetricValue(sum(value * n for value, n in numbers) / total, total)


def combine_profiles(profiles: Sequence[Mapping[str, MetricValue]]) -> dict[str, MetricValue]:
    """The profile of several drives combined."""
    return {name: combine_values(row.aggregation, [one[name] for one in profiles]) for name, row in TABLE.items()}


def planned_stops(course: Course) -> Array:
    """Stations at which the plan stands still (control/schedule.py's rule), ascending."""
    speed, accel = np.asarray(course.speed_mps), np.asarray(course.accel_mps2)
    return np.unique(np.asarray(course.station_m)[(np.abs(speed) < STOPPED_MPS) & (accel <= PULL_AWAY_MPS2)])


def _signals(recording: Recording, course: Course, extras: DriveExtras) -> dict[str, Array]:
    """All available signals that a formula may use."""
    signals = dict(recording.columns)
    station = rear_axle_stations(recording, course)
    if station is not None:
        signals["station_m"] = station
    if extras.control_time_s is not None:
        signals["control_time_s"] = np.asarray(extras.control_time_s, dtype=float)
    if extras.error is not None:
        control_error = np.zeros(recording.ticks)
        control_error[-1:] = 1.0 if extras.error in CONTROL_ERRORS else 0.0
        signals["control_error"] = control_error
    return signals


def _evaluate_formula(formula: MetricFormula, evaluator: MetricEvaluator) -> MetricValue:
    """Value and sample count of a formula of grade/metrics.py."""
    series, value = evaluator.series(formula), evaluator.value(formula)
    n = 0 if series is None else int(np.count_nonzero(np.isfinite(series)))
    return MetricValue(value, n, "" if value is not None else _too_few(n))


def _too_few(n: int) -> str:
    return "no such samples in this drive" if n == 0 else f"only {n} such samples in this drive"


def _why_missing(name: str, extras: DriveExtras) -> str:
    if name == "control_error":
        return NO_BENCH
    if name == "control_time_s":
        return NO_TIMES
    if name in METRIC_SIGNALS:
        return NO_SWING
    return f"no {name} in the recording"
