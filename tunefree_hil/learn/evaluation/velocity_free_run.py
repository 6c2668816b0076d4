"""Free-run errors of speed and yaw rate, for vehicles whose position was not measured.

All models run from the same starts and are compared with the simplest prediction: constant speed and yaw rate.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.learn.drives.drive import Array
from tunefree_hil.learn.evaluation.free_run import WARM_UP_S, RunnableModel, make_runnable, run_free, span_from_start
from tunefree_hil.learn.evaluation.motion import MotionTrack, find_starts

SPEED, YAW = 3, 4  # columns of `run_free`
CONSTANT_SPEED = "keeps its speed"
HORIZONS_S = (1.0, 3.0, 10.0)


class VelocityTrace(NamedTuple):
    """One free run to its end; arrays of shape (n_rows,).

    Attributes:
        name: Drive.
        speed_mps: Measured.
        yaw_rate_radps: Measured.
        speeds: By model.
        yaw_rates: By model.
    """

    name: str
    time_s: Array
    speed_mps: Array
    yaw_rate_radps: Array
    speeds: Mapping[str, Array]
    yaw_rates: Mapping[str, Array]


class VelocityErrors(NamedTuple):
    """Absolute errors by model, shape (n_starts, n_horizons); NaN where the stretch ends before.

    Attributes:
        horizons_s: The columns.
        drive_names: Drive of each start.
        speed_mps: By model.
        yaw_rate_radps: By model.
        traces: The longest run of each stretch.
    """

    horizons_s: tuple[float, ...]
    drive_names: tuple[str, ...]
    speed_mps: Mapping[str, Array]
    yaw_rate_radps: Mapping[str, Array]
    traces: tuple[VelocityTrace, ...]


def evaluate_velocities(
    models: Mapping[str, ModelSpec],
    vehicle: VehicleSpec,
    tracks: Sequence[MotionTrack],
    every_s: float = 0.5,
) -> Generator[str, None, VelocityErrors]:
    """Run all models from all starts, `every_s` apart; yields the name of each stretch when it is done.

    Raises:
        InputError: No stretch has a start with room for the shortest horizon.
    """
    drive_names: list[str] = []
    longest: list[VelocityTrace] = []
    errors: dict[str, list[Array]] = {name: [] for name in (*models, CONSTANT_SPEED)}
    runnables = {name: make_runnable(model, vehicle) for name, model in models.items()}
    for track in tracks:
        traces = _run_track(runnables, track, every_s)
        for trace in traces:
            drive_names.append(track.name)
            for name in errors:
                errors[name].append(_trace_errors(trace, name, track.dt_s))
        if traces:
            longest.append(max(traces, key=lambda trace: len(trace.time_s)))
        yield track.name
    if not drive_names:
        raise InputError(
            f"no stretch has {WARM_UP_S + min(HORIZONS_S):g} s without a gap, in motion with known inputs",
            code="too_short",
            key="LOG",
            hint="record longer drives for the evaluation",
        )
    by_model = {name: np.array(rows) for name, rows in errors.items()}  # shape (n_starts, 2, n_horizons)
    return VelocityErrors(
        horizons_s=HORIZONS_S,
        drive_names=tuple(drive_names),
        speed_mps={name: array[:, 0] for name, array in by_model.items()},
        yaw_rate_radps={name: array[:, 1] for name, array in by_model.items()},
        traces=tuple(longest),
    )


def _run_track(runnables: Mapping[str, RunnableModel], track: MotionTrack, every_s: float) -> list[VelocityTrace]:
    """The free runs of all models from each start of a stretch."""
    warm_up_rows, min_rows = round(WARM_UP_S / track.dt_s), round(min(HORIZONS_S) / track.dt_s)
    outputs = {name: runnable.actuator_outputs(track) for name, runnable in runnables.items()}
    traces = []
    for row in find_starts(track, warm_up_rows, min_rows, max(round(every_s / track.dt_s), 1)):
        span = span_from_start(track, row, max(HORIZONS_S))
        runs = {
            name: run_free(runnable, track, outputs[name], span)[warm_up_rows:] for name, runnable in runnables.items()
        }
        traces.append(make_trace(track, row, span.free_rows, runs))
    return traces


def make_trace(track: MotionTrack, row: int, free_rows: int, runs: Mapping[str, Array]) -> VelocityTrace:
    """Measured and simulated motion from a row on. runs: rows of `run_free` from the start on, by name."""
    cut = slice(row, row + free_rows + 1)
    speed, yaw = track.speed_mps[cut], track.yaw_rate_radps[cut]
    speeds = {name: run[:, SPEED] for name, run in runs.items()} | {CONSTANT_SPEED: np.full(free_rows + 1, speed[0])}
    yaws = {name: run[:, YAW] for name, run in runs.items()} | {CONSTANT_SPEED: np.full(free_rows + 1, yaw[0])}
    time_s = track.dt_s * np.arange(free_rows + 1)
    return VelocityTrace(track.name, time_s, speed, yaw, speeds, yaws)


def _trace_errors(trace: VelocityTrace, name: str, dt_s: float) -> Array:
    """Absolute errors of speed and yaw rate, shape (2, n_horizons)."""
    errors = np.full((2, len(HORIZONS_S)), np.nan)
    for column, seconds in enumerate(HORIZONS_S):
        k = round(seconds / dt_s)
        if k < len(trace.time_s):
            errors[0, column] = abs(trace.speeds[name][k] - trace.speed_mps[k])
            errors[1, column] = abs(trace.yaw_rates[name][k] - trace.yaw_rate_radps[k])
    return errors
