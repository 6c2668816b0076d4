"""The profile of a drive: all metrics of table.py with their sample counts, and what several drives make together.

A metric that cannot be had is None with the reason in words, never 0. The values of metrics that a score weighs are
those of grade/score.py bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.control.schedule import PULL_AWAY_MPS2, STOPPED_MPS
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.metrics import AS_PUBLISHED, Row, Scales, Sharing, is_planned_row, samples_of, samples_of_plan
from tunefree_hil.grade.original_reference import samples_against_original
from tunefree_hil.grade.path_projection import stations_of
from tunefree_hil.grade.score import CONTROL_ERRORS, GradeVehicle
from tunefree_hil.grade.signals import Context
from tunefree_hil.grade.table import ROWS, TABLE, How, Metric

Array = np.ndarray

NO_BENCH = "no bench log: what the controller said is not known"
NO_TIMES = "the controller's compute times were not recorded"


class Value(NamedTuple):
    """A metric of one drive or of several. n: samples in it. why: not empty where value is None."""

    value: float | None
    n: int = 0
    why: str = ""


class Beside(NamedTuple):
    """What is known of a drive beside its columns. error: what ended it, '' for nothing, None where not known."""

    control_time_s: Array | None = None
    error: str | None = None


def profile(
    recording: Recording,
    course: Course,
    vehicle: GradeVehicle,
    *,
    against: str = "original",
    as_published: bool = False,
    beside: Beside | None = None,
) -> dict[str, Value]:
    """All metrics of TABLE. against: the trajectory that errors are taken against, 'original' or 'current'."""
    beside = beside or Beside()
    scales = Scales(vehicle.wheelbase_m, vehicle.steer_rad, vehicle.steer_rate_radps, recording.dt_s)
    original = against == "original"
    samples = samples_against_original(recording, course, vehicle.rear_axle_m) if original else samples_of(recording)
    sharing, plan = Sharing(samples, scales), samples_of_plan(course)
    signals = _signals(recording, course, beside)
    for name, values in samples._asdict().items():  # a column may be there and its error against the path not
        signals.pop(name, None)
        signals |= {} if values is None else {name: values}
    context = Context(scales, vehicle.rest_pedal_frac, stops_of(course))
    found = {}
    for name, row in TABLE.items():
        missing = next((need for need in row.needs if need not in signals), "")
        if missing:
            found[name] = Value(None, why=_why_missing(missing, beside))
        elif row.formula is not None:
            found[name] = summed(row, row.formula(signals, context))
        else:
            weighed = AS_PUBLISHED.get(name, ROWS[name]) if as_published else ROWS[name]
            planned = is_planned_row(weighed, plan)
            found[name] = _weighed(weighed, sharing) if planned else Value(None, why="not in this course's plan")
    return found


def summed(row: Metric, series: Array) -> Value:
    """A series of samples as one value, by the row's way; samples that are not finite do not count."""
    kept = series[np.isfinite(series)]
    n = len(kept)
    if n < row.least:
        return Value(None, n, _too_few(n))
    if row.how == "std":
        return Value(math.sqrt(float(kept @ kept) / (n - 1)), n)
    if row.how == "peak":
        return Value(float(np.abs(kept).max()), n)
    if row.how == "share":
        return Value(float(np.count_nonzero(kept >= row.limit)) / n, n)
    return Value(float(kept.mean()), n)


def combine_values(how: How, values: Sequence[Value]) -> Value:
    """Several drives' values of one metric as one (6.1); those that are None do not count. None where all are."""
    known = [one for one in values if one.value is not None]
    if not known:
        return Value(None, 0, values[0].why if values else "no drive")
    total = sum(one.n for one in known)
    numbers = [(one.value or 0.0, one.n) for one in known]
    if how == "peak":
        return Value(max(value for value, _ in numbers), total)
    if how == "std":
        return Value(math.sqrt(sum(value * value * (n - 1) for value, n in numbers) / (total - 1)), total)
    return Value(sum(value * n for value, n in numbers) / total, total)


def combine_profiles(profiles: Sequence[Mapping[str, Value]]) -> dict[str, Value]:
    """The profile of several drives taken together."""
    return {name: combine_values(row.how, [one[name] for one in profiles]) for name, row in TABLE.items()}


def stops_of(course: Course) -> Array:
    """Stations at which the plan stands still (control/schedule.py's rule), ascending."""
    speed, accel = np.asarray(course.speed_mps), np.asarray(course.accel_mps2)
    return np.unique(np.asarray(course.station_m)[(np.abs(speed) < STOPPED_MPS) & (accel <= PULL_AWAY_MPS2)])


def _signals(recording: Recording, course: Course, beside: Beside) -> dict[str, Array]:
    """Everything that the formulas may ask for, as far as it can be had."""
    signals = dict(recording.columns)
    station = stations_of(recording, course)
    if station is not None:
        signals["station_m"] = station
    if beside.control_time_s is not None:
        signals["control_time_s"] = np.asarray(beside.control_time_s, dtype=float)
    if beside.error is not None:
        wrong = np.zeros(recording.ticks)
        wrong[-1:] = 1.0 if beside.error in CONTROL_ERRORS else 0.0
        signals["control_error"] = wrong
    return signals


def _weighed(row: Row, sharing: Sharing) -> Value:
    """A row of grade/metrics.py: its own value, and how many samples are in it."""
    series, value = sharing.series(row), sharing.metric(row)
    n = 0 if series is None else int(np.count_nonzero(np.isfinite(series)))
    return Value(value, n, "" if value is not None else _too_few(n))


def _too_few(n: int) -> str:
    return "no such samples in this drive" if n == 0 else f"only {n} such samples in this drive"


def _why_missing(name: str, beside: Beside) -> str:
    if name == "control_error":
        return NO_BENCH
    if name == "control_time_s":
        return NO_TIMES
    return f"no {name} in the recording"
