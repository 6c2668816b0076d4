"""Free-run errors of model folders: the plant simulates 1, 3, 10, 30 s of a drive from recorded commands alone.

For one second the plant receives the measured motion at every tick, so that its memory fills; then it runs freely. The
commands pass the actuators of the model. On hills the slope is an input (learn/evaluation/motion.py). Errors are
tabulated with intervals over whole drives, since starts within a drive are correlated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base import parts
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import buffer, kernel, table
from tunefree_hil.base.records import GEAR_DRIVE, Actuation, Disturbance, Motion
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.learn.data_sheet import com_to_rear_axle_m
from tunefree_hil.learn.drives.drive import Array
from tunefree_hil.learn.evaluation.motion import (
    MotionTrack,
    body_change,
    find_starts,
    is_hilly,
    simulate_actuators,
    wrap_angle,
)
from tunefree_hil.plant.types import ChassisInput, Plant

WARM_UP_S = 1.0
HORIZONS_S = (1.0, 3.0, 10.0, 30.0)
HILL_AHEAD_S = 10.0  # a start is on a hill if the road is not level within this time
N_MEASURED, N_INPUTS, N_OUTPUTS = 7, 4, 5  # numbers in a row of the free-run kernel
N_RESAMPLES = 1000
MIN_BOOTSTRAP_DRIVES = 15  # with fewer drives the interval is Student's t
MIN_DISTANCE_M = 1.0  # with a shorter distance there is no error per metre
QUANTITIES = ("position_m", "heading_rad", "speed_mps")


class EvaluationOptions(NamedTuple):
    """Which starts are evaluated.

    Attributes:
        every_s: Spacing of the starts.
        max_starts: At most so many, evenly spread; 0: all.
        horizons_s: Times at which errors are taken.
        min_free_s: Usable time that a start must have ahead; longer horizons are evaluated where it is enough.
    """

    every_s: float = 1.0
    max_starts: int = 0
    horizons_s: tuple[float, ...] = HORIZONS_S
    min_free_s: float = 10.0


DEFAULT_OPTIONS = EvaluationOptions()


class FreeRunErrors(NamedTuple):
    """Absolute errors of one model, shape (n_starts, n_horizons); NaN where the drive ends before.

    Attributes:
        kind: [plant] kind.
        horizons_s: The columns.
        drive_names: Drive of each start.
        is_on_hill: Of each start.
        position_m: Error.
        heading_rad: Error.
        speed_mps: Error.
        distance_m: Driven since the start.
        accel_mps2: RMS one-step error of the rate of speed.
        yaw_rate_radps: RMS one-step error of the yaw rate.
    """

    kind: str
    horizons_s: tuple[float, ...]
    drive_names: tuple[str, ...]
    is_on_hill: Array
    position_m: Array
    heading_rad: Array
    speed_mps: Array
    distance_m: Array
    accel_mps2: float
    yaw_rate_radps: float


class RunnableModel(NamedTuple):
    """The chassis of a model, ready to run.

    Attributes:
        takes_commands: The plant has no actuators (kind paper).
        rest_frac: Duty of a released pedal.
        com_to_rear_m: Distance from the centre of mass to the rear axle.
    """

    block: Any
    run: Callable[..., int]
    model: ModelSpec
    takes_commands: bool
    rest_frac: float
    com_to_rear_m: float

    def actuator_outputs(self, track: MotionTrack) -> Array:
        """As from `simulate_actuators`."""
        return simulate_actuators(track, self.model, self.rest_frac, self.takes_commands)


class RunSpan(NamedTuple):
    """Rows of a track for one free run: warm-up from `first_row`, then `free_rows` of free run."""

    first_row: int
    warm_up_rows: int
    free_rows: int

    @property
    def rows(self) -> slice:
        """Rows of the track."""
        return slice(self.first_row, self.first_row + self.warm_up_rows + self.free_rows + 1)


def open_plant(model: ModelSpec) -> Plant:
    """The plant of a model folder.

    Raises:
        InputError: The kind cannot start from a measured motion.
    """
    kind = model.plant.kind
    plant = parts.load("tunefree_hil.plant", "single_track" if kind == "physics" else kind, "PLANT")
    if plant.observe is None:
        raise InputError(
            f"a plant of kind {kind!r} cannot take over a measured motion",
            code="no_free_run",
            file=f"{model.folder}/model.toml",
            key="plant.kind",
            hint="physics, hybrid, lstm, mlp, rule_based or paper",
        )
    if plant.open is not None:
        return plant.open(Path(model.folder) / (model.plant.file or plant.file))
    return plant


def make_runnable(model: ModelSpec, vehicle: VehicleSpec) -> RunnableModel:
    """The chassis of a model folder, with its effects on the body."""
    plant = open_plant(model)
    block = plant.make(model.plant.params, body_change(model))
    run = make_free_run_loop(block.step, plant.observe)
    rest_frac, com_to_rear_m = vehicle.nominal.rest_pedal_frac, com_to_rear_axle_m(vehicle.nominal)
    return RunnableModel(block, run, model, plant.actuators is not None, rest_frac, com_to_rear_m)


@kernel
def unpack_motion(measured: Any, i: int) -> Motion:
    """The motion at a row of `measured` that begins at i: x, y, heading, speed, side speed, yaw rate, rate of speed."""
    x_m, y_m, heading_rad = float(measured[i]), float(measured[i + 1]), float(measured[i + 2])
    speed_mps, side_mps, yaw_rate_radps = float(measured[i + 3]), float(measured[i + 4]), float(measured[i + 5])
    accel_mps2 = float(measured[i + 6])
    return Motion(x_m, y_m, heading_rad, speed_mps, side_mps, yaw_rate_radps, 0.0, 0.0, accel_mps2, 0.0, 0.0, 0.0, 0.0)


def make_free_run_loop(step: Any, observe: Any) -> Callable[..., int]:
    """The loop over a chassis: measured motion in rows 0 to the end of the warm-up, then free."""

    @kernel
    def free_run_kernel(
        params: Any, state: Any, measured: Any, inputs: Any, warm_up_rows: int, outputs: Any, dt_s: float
    ) -> int:
        """Run over flat rows.

        Args:
            params: Of the chassis.
            state: Of the chassis.
            measured: Rows as for `unpack_motion`.
            inputs: Throttle, brake, steer, slope during the step to a row.
            warm_up_rows: The last row whose measured motion is used.
            outputs: Receives x, y, heading, speed, yaw rate of a row.
            dt_s: Tick.

        Returns:
            The number of rows.
        """
        rows = len(inputs) // N_INPUTS
        for k in range(1, rows):
            if k - 1 <= warm_up_rows:
                state = observe(state, unpack_motion(measured, (k - 1) * N_MEASURED))
            i = k * N_INPUTS
            act = Actuation(float(inputs[i]), float(inputs[i + 1]), float(inputs[i + 2]), GEAR_DRIVE)
            road = Disturbance(float(inputs[i + 3]), 1.0, 0.0, 0.0)
            state, motion = step(params, state, ChassisInput(act, road), dt_s)
            i = k * N_OUTPUTS
            outputs[i] = motion.x_m
            outputs[i + 1] = motion.y_m
            outputs[i + 2] = motion.heading_rad
            outputs[i + 3] = motion.speed_mps
            outputs[i + 4] = motion.yaw_rate_radps
        return rows

    return free_run_kernel


def run_free(runnable: RunnableModel, track: MotionTrack, actuator_outputs: Array, span: RunSpan) -> Array:
    """Free run over the rows of a span.

    Args:
        runnable: The model.
        track: The measured motion.
        actuator_outputs: As from `simulate_actuators`.
        span: Rows of the track.

    Returns:
        x, y, heading, speed, yaw rate, shape (n_rows, N_OUTPUTS); row 0 is measured.
    """
    rows = span.rows
    motion = [track.x_m, track.y_m, track.heading_rad, track.speed_mps, track.yaw_rate_radps]
    measured = np.stack(motion, axis=1)[rows]
    side_speed = (
        runnable.com_to_rear_m * track.yaw_rate_radps[rows]
    )  # of the centre of mass, without slip at the rear axle
    kernel_motion = np.column_stack([measured[:, :4], side_speed, measured[:, 4], track.accel_mps2[rows]])
    inputs = np.column_stack([actuator_outputs[rows], track.grade_rad[rows]])
    start = Start(*(float(value) for value in measured[0, :4]))
    params = runnable.block.params._replace(start=start)
    outputs = buffer(len(measured) * N_OUTPUTS)
    state = runnable.block.init(params, track.dt_s)
    flat_motion, flat_inputs = table(kernel_motion.ravel()), table(inputs.ravel())
    runnable.run(params, state, flat_motion, flat_inputs, span.warm_up_rows, outputs, track.dt_s)
    simulated = np.asarray(outputs).reshape(-1, N_OUTPUTS)
    simulated[0] = measured[0]
    return simulated


def evaluate_free_run(
    model: ModelSpec,
    vehicle: VehicleSpec,
    tracks: Sequence[MotionTrack],
    options: EvaluationOptions = DEFAULT_OPTIONS,
) -> FreeRunErrors:
    """Errors of a model over all starts of the tracks.

    Raises:
        InputError: There is no start.
    """
    runnable = make_runnable(model, vehicle)
    starts = _select_starts(tracks, options)
    outputs = {i: runnable.actuator_outputs(tracks[i]) for i in {i for i, _ in starts}}
    errors, one_step = [], []
    for i, row in starts:
        track = tracks[i]
        span = span_from_start(track, row, max(options.horizons_s))
        simulated = run_free(runnable, track, outputs[i], span)
        horizons = [round(horizon_s / track.dt_s) for horizon_s in options.horizons_s]
        errors.append(_errors_at_horizons(track, simulated[span.warm_up_rows :], row, horizons))
        one_step.append(_one_step_errors(track, simulated, span))
    by_quantity = np.array(errors)  # shape (n_starts, 4, n_horizons)
    accel_mps2, yaw_rate_radps = np.sqrt((np.concatenate(one_step) ** 2).mean(axis=0)).tolist()
    on_hill = [is_hilly(tracks[i], row, round(HILL_AHEAD_S / tracks[i].dt_s)) for i, row in starts]
    return FreeRunErrors(
        kind=model.plant.kind,
        horizons_s=tuple(options.horizons_s),
        drive_names=tuple(tracks[i].name for i, _ in starts),
        is_on_hill=np.array(on_hill),
        position_m=by_quantity[:, 0],
        heading_rad=by_quantity[:, 1],
        speed_mps=by_quantity[:, 2],
        distance_m=by_quantity[:, 3],
        accel_mps2=accel_mps2,
        yaw_rate_radps=yaw_rate_radps,
    )


def _select_starts(tracks: Sequence[MotionTrack], options: EvaluationOptions) -> list[tuple[int, int]]:
    """(track, row) of every start."""
    starts = []
    for i, track in enumerate(tracks):
        warm_up_rows, free_rows = round(WARM_UP_S / track.dt_s), round(options.min_free_s / track.dt_s)
        spacing_rows = max(round(options.every_s / track.dt_s), 1)
        starts += [(i, row) for row in find_starts(track, warm_up_rows, free_rows, spacing_rows)]
    if not starts:
        raise InputError(
            f"no drive has {WARM_UP_S + options.min_free_s:g} s without a gap, in drive gear and moving",
            code="too_short",
            key="LOG",
            hint="record longer drives for the evaluation",
        )
    if options.max_starts and len(starts) > options.max_starts:
        starts = [starts[k] for k in np.linspace(0, len(starts) - 1, options.max_starts).astype(int)]
    return starts


def span_from_start(track: MotionTrack, row: int, horizon_s: float) -> RunSpan:
    """The free run from a row on, up to the horizon or the last usable row."""
    warm_up_rows = round(WARM_UP_S / track.dt_s)
    good = track.is_good[row : row + round(horizon_s / track.dt_s) + 1]
    free_rows = len(good) - 1 if good.all() else int(np.argmin(good)) - 1
    return RunSpan(row - warm_up_rows, warm_up_rows, free_rows)


def _errors_at_horizons(track: MotionTrack, simulated: Array, row: int, horizons: Sequence[int]) -> list[list[float]]:
    """Errors of position, heading and speed, and the distance, by horizon. simulated: from the start on."""
    errors = [[np.nan] * len(horizons) for _ in range(4)]
    cut = slice(row, row + len(simulated))
    steps = np.hypot(np.diff(track.x_m[cut]), np.diff(track.y_m[cut]))
    for column, ahead in enumerate(horizons):
        if ahead < len(simulated):
            x, y, heading, speed, _ = simulated[ahead]
            k = row + ahead
            errors[0][column] = float(np.hypot(x - track.x_m[k], y - track.y_m[k]))
            errors[1][column] = float(abs(wrap_angle(heading - track.heading_rad[k])))
            errors[2][column] = float(abs(speed - track.speed_mps[k]))
            errors[3][column] = float(steps[:ahead].sum())
    return errors


def _one_step_errors(track: MotionTrack, simulated: Array, span: RunSpan) -> Array:
    """Errors of rate of speed and yaw rate one tick after a measured motion, shape (n_rows, 2).

    Rows are those of the second half of the warm-up, in which the memory is filled.
    """
    rows = np.arange(span.warm_up_rows // 2, span.warm_up_rows + 1)
    k = span.first_row + rows
    rate = (simulated[rows, 3] - track.speed_mps[k - 1]) / track.dt_s
    return np.stack([rate - track.accel_mps2[k], simulated[rows, 4] - track.yaw_rate_radps[k]], axis=1)


def evaluate_models(
    models: Mapping[str, ModelSpec],
    vehicle: VehicleSpec,
    tracks: Sequence[MotionTrack],
    options: EvaluationOptions = DEFAULT_OPTIONS,
) -> Generator[str, None, dict[str, FreeRunErrors]]:
    """Evaluate models in turn; yields each name when it is done, returns the errors by name."""
    errors = {}
    for name, model in models.items():
        errors[name] = evaluate_free_run(model, vehicle, tracks, options)
        yield name
    return errors


def run_headings(
    models: Mapping[str, ModelSpec], vehicle: VehicleSpec, track: MotionTrack, row: int, seconds: float
) -> dict[str, Array]:
    """Heading of each model in a free run from a start, rad, one value a tick (Fig. 3b of the Baidu paper)."""
    span = span_from_start(track, row, seconds)
    headings = {}
    for name, model in models.items():
        runnable = make_runnable(model, vehicle)
        headings[name] = run_free(runnable, track, runnable.actuator_outputs(track), span)[span.warm_up_rows :, 2]
    return headings


def table_from_errors(errors: FreeRunErrors, seed: int = 1) -> dict[str, Any]:
    """Plain data: rows 'level' and 'hills' (None without such starts), and the one-step errors.

    A row has the numbers of starts and drives, and by horizon ('10') and quantity the mean, its 95 % interval (None
    where all starts are of one drive) and the 95th percentile; also the position error per metre driven.
    """
    data: dict[str, Any] = {
        "kind": errors.kind,
        "one_step": {"accel_mps2": errors.accel_mps2, "yaw_rate_radps": errors.yaw_rate_radps},
    }
    for name, rows in (("level", ~errors.is_on_hill), ("hills", errors.is_on_hill)):
        data[name] = _summarize_starts(errors, rows, seed) if rows.any() else None
    return data


def _summarize_starts(errors: FreeRunErrors, rows: Array, seed: int) -> dict[str, Any]:
    drives = np.array(errors.drive_names)[rows]
    row: dict[str, Any] = {"starts": int(rows.sum()), "drives": len(set(drives.tolist()))}
    for column, seconds in enumerate(errors.horizons_s):
        values = {name: getattr(errors, name)[rows, column] for name in QUANTITIES}
        distance_m = errors.distance_m[rows, column]
        with np.errstate(invalid="ignore"):
            per_metre = values["position_m"] / np.maximum(distance_m, MIN_DISTANCE_M)
            values["position_per_m"] = np.where(distance_m > MIN_DISTANCE_M, per_metre, np.nan)
        if np.isfinite(values["position_m"]).any():
            row[f"{seconds:g}"] = {name: _summarize_values(value, drives, seed) for name, value in values.items()}
    return row


def _summarize_values(values: Array, drives: Array, seed: int) -> dict[str, Any]:
    known = np.isfinite(values)
    if not known.any():
        return {"n": 0, "mean": None, "p95": None, "low": None, "high": None}
    low, high = (None if math.isnan(end) else end for end in mean_interval(values[known], drives[known], seed))
    mean, p95 = float(values[known].mean()), float(np.percentile(values[known], 95))
    return {"n": int(known.sum()), "mean": mean, "p95": p95, "low": low, "high": high}


def mean_interval(values: Array, drives: Array, seed: int = 1) -> tuple[float, float]:
    """95 % interval of the mean: bootstrap over whole drives; Student's t below MIN_BOOTSTRAP_DRIVES."""
    totals, counts = _sum_by_drive(values, drives)
    if len(totals) < MIN_BOOTSTRAP_DRIVES:
        return ratio_interval(totals, counts)
    low, high = np.percentile(_resample_ratio(totals, counts, seed), [2.5, 97.5])
    return float(low), float(high)


def _resample_ratio(parts: Array, wholes: Array, seed: int) -> Array:
    """sum(parts) / sum(wholes) of drives that are drawn with replacement, shape (N_RESAMPLES,)."""
    picks = np.random.default_rng(seed).integers(0, len(parts), (N_RESAMPLES, len(parts)))
    return parts[picks].sum(axis=1) / wholes[picks].sum(axis=1)


def ratio_interval(parts: Array, wholes: Array) -> tuple[float, float]:
    """95 % interval of sum(parts) / sum(wholes), one of each a drive, by Student's t.

    With few drives a bootstrap interval, or their range, contains the true value far too seldom.

    Returns:
        NaN for a single drive, which has no scatter between drives.
    """
    from scipy.stats import t as student

    n, ratio = len(parts), float(parts.sum() / wholes.sum())
    if n < 2:
        return math.nan, math.nan
    residuals = parts - ratio * wholes
    std_error = math.sqrt(n / (n - 1.0) * float(residuals @ residuals)) / abs(float(wholes.sum()))
    half = float(student.ppf(0.975, n - 1)) * std_error
    floor = 0.0 if (parts >= 0.0).all() else -math.inf  # errors are not negative
    return max(ratio - half, floor), ratio + half


def _sum_by_drive(values: Array, drives: Array) -> tuple[Array, Array]:
    """Sum and count of each drive."""
    _, index = np.unique(drives, return_inverse=True)
    return np.bincount(index, weights=values), np.bincount(index).astype(np.float64)


def error_reduction(
    errors: FreeRunErrors, reference: FreeRunErrors, seconds: float, *, hills: bool = False, seed: int = 1
) -> dict[str, Any]:
    """Reduction of the mean position error against a reference model on the same starts, in percent.

    Returns:
        'value', 'low', 'high' (95 % interval over whole drives, None for a single one), and 'n' starts.
    """
    column = errors.horizons_s.index(seconds)
    position_m, reference_m = errors.position_m[:, column], reference.position_m[:, column]
    rows = np.isfinite(position_m) & np.isfinite(reference_m) & (errors.is_on_hill == hills)
    drives = np.array(errors.drive_names)[rows]
    sums, _ = _sum_by_drive(position_m[rows], drives)
    reference_sums, counts = _sum_by_drive(reference_m[rows], drives)
    value = 100.0 * (1.0 - float(sums.sum()) / float(reference_sums.sum()))
    if len(counts) < MIN_BOOTSTRAP_DRIVES:
        ends = [100.0 * (1.0 - end) for end in ratio_interval(sums, reference_sums)[::-1]]
    else:
        resampled = 100.0 * (1.0 - _resample_ratio(sums, reference_sums, seed))
        ends = np.percentile(resampled, [2.5, 97.5]).tolist()
    low, high = (None if math.isnan(end) else end for end in ends)
    return {"value": value, "low": low, "high": high, "n": int(rows.sum())}
