"""Free-run windows: recorded actuator outputs in, single-track motion out, to be compared with the recorded motion."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.kernel import kept, kernel
from tunefree_hil.base.records import GEAR_DRIVE, Actuation, Disturbance, Motion
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.effects._signals import SoftState, soft, step_soft
from tunefree_hil.learn.actuators.model import ActuatorModel, simulate_commands
from tunefree_hil.learn.actuators.samples import read_accel_command, read_actuation
from tunefree_hil.learn.drives.drive import INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES, Array, Drive, DrivePart
from tunefree_hil.learn.drives.road_slope import ACCEL_OFFSET, estimate_accel_offset
from tunefree_hil.learn.drives.runs import find_runs, sample_interval_ticks
from tunefree_hil.learn.drives.smoothing import (
    estimate_mean_noise,
    estimate_rate,
    interpolate_fresh,
    interpolate_from_first,
    shift_earlier,
    smooth_signal,
    yaw_rate_from_wheels,
)
from tunefree_hil.learn.estimate import ActuatorFit
from tunefree_hil.plant.actuation.acceleration_interface import FULL_MPS2
from tunefree_hil.plant.data_sheet import constants_of
from tunefree_hil.plant.single_track import SingleTrackState, step_single_track
from tunefree_hil.plant.types import ChassisInput, ChassisParams

WINDOW_S = 8.0
ROW_SPACING_S = 0.1  # between compared rows
THROTTLE_HISTORY_S = 2.0  # before a window: longer than the slowest powertrain lag
START_FILTER_S = 0.21  # local polynomial that gives the start of a window
SLOPE_FILTER_S = 2.0  # mean over which an accelerometer must resolve a slope
ACCEL_FILTER_S = 0.5  # window of the rate of speed that is compared with the specific force


class FreeRunWindowCriteria(NamedTuple):
    """Which rows and windows are used (docs/results/criteria.md)."""

    max_silence_s: float = 0.2  # longest gap between reports of an output or of the speed
    min_speed_mps: float = 0.5  # a window whose speed stays below it is a standstill, which identifies no constant
    # mean slope above which a window is left out: the slope is an input that was not recorded
    max_slope_rad: float = 0.02
    max_accel_bias_g: float = 0.01  # of the accelerometer, where the drive does not separate it from a slope
    min_slope_speed_mps: float = 1.0  # below it stiction and pitch dominate the accelerometer
    min_slope_rows: int = 10  # moving rows needed to judge a slope


CRITERIA = FreeRunWindowCriteria()

# The compared signals, in this order, and the drive fields that give them, best first.
TARGETS = ("speed_mps", "yaw_rate_radps", "heading_rad", "lateral_accel_mps2", "x_m", "y_m")
N_TARGETS = len(TARGETS)
SOURCES = {
    "speed_mps": INS_FIRST_SPEEDS,
    "yaw_rate_radps": INS_FIRST_YAW_RATES,
    "heading_rad": ("ins.heading_rad",),
    "lateral_accel_mps2": ("report.lateral_accel_mps2",),
    "x_m": ("ins.x_m",),
    "y_m": ("ins.y_m",),
}
INPUTS = ("throttle_frac", "brake_frac", "steer_rad")


class FreeRunWindow(NamedTuple):
    """A stretch of a drive for one free run.

    Attributes:
        name: Drive.
        begin: Row of the drive.
        inputs: Throttle, brake (duty), steer (rad) and gear in the tick that ends at the row, shape (n_rows, 4); row 0
            is not used.
        throttle_history: Throttle duty up to row 0, newest last; at least one row, at most THROTTLE_HISTORY_S.
        start: x, y, heading, speed and yaw rate at row 0.
        rows: The compared rows, shape (n_compared,).
        targets: TARGETS at `rows`, shape (n_compared, 6), NaN where not measured; heading continuous.
        dt_s: Tick.
        sensed_slope: Sine of a slope that the accelerometer reports over the whole drive
            (learn/drives/road_slope.py); 0 within the usual sensor offset.
    """

    name: str
    begin: int
    inputs: Array
    throttle_history: Array
    start: tuple[float, float, float, float, float]
    rows: Array
    targets: Array
    dt_s: float
    sensed_slope: float = 0.0


class WindowSet(NamedTuple):
    """Free-run windows of drives.

    Attributes:
        is_steered: Whether the steering output is known.
        has_pedals: Whether the pedal outputs are known.
        notes: What was left out.
    """

    windows: tuple[FreeRunWindow, ...]
    is_steered: bool
    has_pedals: bool
    notes: tuple[str, ...]


def extract_windows(
    parts: Iterable[DrivePart],
    vehicle: VehicleSpec,
    window_s: float = WINDOW_S,
    channels: Mapping[str, ActuatorFit] | None = None,
) -> WindowSet:
    """Consecutive windows of all parts, where outputs and motion are known and the gear is drive.

    Args:
        parts: Parts of drives.
        vehicle: Vehicle folder.
        window_s: Length of a window.
        channels: Identified channels; one without a reported output is simulated from its command, where that acts.
    """
    windows: list[FreeRunWindow] = []
    is_steered = has_pedals = False
    n_still = n_slopes = 0
    for part in parts:
        signals = WindowSignals(part.drive, vehicle, channels or {})
        if signals.inputs is None:
            continue
        is_steered, has_pedals = is_steered or signals.is_steered, has_pedals or signals.has_pedals
        rows = round(window_s / part.drive.dt_s)
        for begin, end in find_runs(signals.is_good[part.begin : part.end], rows, part.begin):
            for first in range(begin, end - rows, rows):
                span = slice(first, first + rows + 1)
                if np.nanmax(signals.speed[span]) < CRITERIA.min_speed_mps:
                    n_still += 1
                elif signals.is_on_slope(span):
                    n_slopes += 1
                else:
                    windows.append(signals.cut_window(span))
    notes = [f"{_count_text(n_still)} at a standstill left out"] if n_still else []
    notes += [f"{_count_text(n_slopes)} on a slope left out: its grade was not recorded"] if n_slopes else []
    return WindowSet(tuple(windows), is_steered, has_pedals, tuple(notes))


def _count_text(count: int) -> str:
    return "1 window" if count == 1 else f"{count} windows"


class WindowSignals:
    """Inputs and targets of a drive on every tick, in one time frame.

    Attributes:
        inputs: Shape (n_rows, 4), None where neither steering nor pedals, or no speed, are known.
        targets: Shape (n_rows, 6).
        is_good: Rows that a window may contain, shape (n_rows,).
    """

    def __init__(self, drive: Drive, vehicle: VehicleSpec, channels: Mapping[str, ActuatorFit]) -> None:
        self.drive, self.vehicle, self.channels = drive, vehicle, channels
        self.dt_s = drive.dt_s
        self.ins_delay_rows = round(vehicle.ins_frame.latency_s / drive.dt_s)
        self.start_window = max(round(START_FILTER_S / drive.dt_s) | 1, 5)
        rest = vehicle.nominal.rest_pedal_frac
        columns = self._inputs_from_accel(rest) or [self._input(name, rest) for name in INPUTS]
        self.has_pedals = bool(np.isfinite(columns[0]).any() and np.isfinite(columns[1]).any())
        self.is_steered = bool(np.isfinite(columns[2]).any())
        self.targets = np.stack([self._target(name) for name in TARGETS], axis=1)
        self.speed = self.targets[:, 0]
        self.inputs: Array | None = None
        if (not self.is_steered and not self.has_pedals) or not np.isfinite(self.speed).any():
            return
        if not self.has_pedals:
            columns[0] = columns[1] = np.full(drive.n_rows, rest)
        if not self.is_steered:
            columns[2] = np.zeros(drive.n_rows)
        gear = drive.get("report.gear")
        known = gear is not None and np.isfinite(gear).any()
        columns.append(gear if known and gear is not None else np.full(drive.n_rows, GEAR_DRIVE))
        self.inputs = np.stack(columns, axis=1)
        in_drive = self.inputs[:, 3] >= GEAR_DRIVE
        self.is_good = np.isfinite(self.inputs).all(axis=1) & np.isfinite(self.speed) & in_drive
        is_reported = self._rows_without_silence()
        self.is_good &= is_reported
        self.throttle_known = np.isfinite(self.inputs[:, 0]) & is_reported
        if not self.has_pedals:
            self.is_good &= self.speed > CRITERIA.min_speed_mps
        self.sensed_slope = estimate_accel_offset(drive, vehicle)
        self.slope = self._estimate_slope()

    def _input(self, name: str, rest: float) -> Array:
        values = self.drive.get(f"report.{name}")
        if values is None or not np.isfinite(values).any():
            return self._input_from_command(name, rest)
        even = interpolate_fresh(values, self.drive.fresh[f"report.{name}"])
        even[: int(np.argmax(np.isfinite(values)))] = np.nan
        return even

    def _input_from_command(self, name: str, rest: float) -> Array:
        """The simulated output of a channel that reports none; rest where the vehicle has no such pedal."""
        channel, fields = name.partition("_")[0], (self.vehicle.command, self.vehicle.report)
        if channel == "brake" and not any(name in keys for keys in fields):
            return np.full(self.drive.n_rows, rest)
        idle = 0.0 if channel == "steer" else rest
        command, _, follows_command = read_actuation(self.drive, channel, idle)
        if channel not in self.channels or self.drive.get(f"command.{name}") is None:
            return np.full(self.drive.n_rows, np.nan)
        return self._simulate_channel(channel, command, follows_command, idle)

    def _inputs_from_accel(self, rest: float) -> list[Array]:
        """Pedals and steering of a vehicle with commanded acceleration; empty for any other."""
        demand = read_accel_command(self.drive)
        if demand is None or "accel" not in self.channels:
            return []
        accel = self._simulate_channel("accel", demand, np.isfinite(demand) & self.drive.enabled, 0.0)
        pedals = (rest + np.maximum(sign * accel, 0.0) / FULL_MPS2 for sign in (1.0, -1.0))
        return [*pedals, self._input("steer_rad", 0.0)]

    def _simulate_channel(self, channel: str, command: Array, follows_command: Array, idle: float) -> Array:
        """The output for a command where the channel follows it, NaN elsewhere."""
        output = np.full(self.drive.n_rows, np.nan)
        params = self.channels[channel].params(idle)
        for begin, end in find_runs(follows_command, 2):
            output[begin:end] = simulate_commands(ActuatorModel(params), command[begin:end], self.dt_s)
        return output

    def _target(self, name: str) -> Array:
        """A measured signal, interpolated between fresh values; INS signals are shifted by the INS delay."""
        for source in self._sources(name):
            even = interpolate_from_first(self.drive, source)
            return shift_earlier(even, self.ins_delay_rows) if source.startswith("ins.") else even
        wheels = yaw_rate_from_wheels(self.drive, self.vehicle.nominal) if name == "yaw_rate_radps" else None
        if wheels is not None:
            return interpolate_fresh(*wheels)
        return np.full(self.drive.n_rows, np.nan)

    def _rows_without_silence(self) -> Array:
        """Rows at which outputs and speed were reported within max_silence_s."""
        good = np.ones(self.drive.n_rows, dtype=bool)
        names = [*(f"report.{name}" for name in INPUTS), *self._sources("speed_mps")[:1]]
        for name in names:
            fresh = self.drive.fresh.get(name)
            if fresh is None or not fresh.any():
                continue
            rows = np.append(np.flatnonzero(fresh), self.drive.n_rows)  # a signal may stop before the end of the drive
            gaps = np.flatnonzero(np.diff(rows) * self.dt_s > CRITERIA.max_silence_s)
            for i in gaps:
                good[rows[i] + 1 : rows[i + 1]] = False
        return good

    def _sources(self, target: str) -> list[str]:
        """Fields with values of a target, best first; those with long intervals last."""
        fields = [name for name in SOURCES[target] if np.isfinite(self.drive.fields.get(name, np.nan)).any()]
        max_interval_s = 0.5 * CRITERIA.max_silence_s
        slow = [name for name in fields if sample_interval_ticks(self.drive.fresh[name]) * self.dt_s > max_interval_s]
        return [name for name in fields if name not in slow] + slow

    def _estimate_slope(self) -> Array | None:
        """sin(slope): specific force minus rate of speed; None where no usable accelerometer is reported."""
        force = self.drive.get("report.accel_mps2")
        if force is None or not np.isfinite(force).any():
            return None
        window = max(round(ACCEL_FILTER_S / self.dt_s) | 1, 5)
        rate = estimate_rate(self.speed, np.isfinite(self.speed), window, self.dt_s)
        fresh = self.drive.fresh["report.accel_mps2"]
        slope = (interpolate_fresh(force, fresh) - rate) / G_MPS2
        if estimate_mean_noise(slope, fresh, round(SLOPE_FILTER_S / self.dt_s)) > 0.5 * CRITERIA.max_slope_rad:
            return None
        limit = CRITERIA.max_accel_bias_g
        return slope - (self.sensed_slope or float(np.clip(np.nanmedian(slope), -limit, limit)))

    def is_on_slope(self, span: slice) -> bool:
        """Whether the road under a window is not level."""
        if self.slope is None:
            return False
        moving = self.slope[span][self.speed[span] > CRITERIA.min_slope_speed_mps]
        moving = moving[np.isfinite(moving)]
        return len(moving) > CRITERIA.min_slope_rows and abs(float(np.median(moving))) > CRITERIA.max_slope_rad

    def cut_window(self, span: slice) -> FreeRunWindow:
        """Inputs, start and targets of a window."""
        assert self.inputs is not None
        spacing = max(round(ROW_SPACING_S / self.dt_s), 1)
        rows = np.arange(spacing, span.stop - span.start, spacing)
        targets = self.targets[span].copy()
        start = tuple(self._smoothed_target(i, span.start) for i in (4, 5, 2, 0, 1))
        x, y, heading, speed, yaw = (0.0 if not np.isfinite(value) else value for value in start)
        return FreeRunWindow(
            name=self.drive.name,
            begin=span.start,
            inputs=self.inputs[span],
            throttle_history=self._throttle_history(span.start),
            start=(x, y, heading, max(speed, 0.0), yaw),
            rows=rows,
            targets=targets[rows],
            dt_s=self.dt_s,
            sensed_slope=self.sensed_slope if abs(self.sensed_slope) > ACCEL_OFFSET.min_reported_g else 0.0,
        )

    def _throttle_history(self, row: int) -> Array:
        """Throttle up to a row, as far back as it is known without a gap, at most THROTTLE_HISTORY_S."""
        assert self.inputs is not None
        first = max(row - round(THROTTLE_HISTORY_S / self.dt_s), 0)
        unknown = np.flatnonzero(~self.throttle_known[first:row])
        return self.inputs[first + (int(unknown[-1]) + 1 if len(unknown) else 0) : row + 1, 0]

    def _smoothed_target(self, target: int, row: int) -> float:
        """A target at a row, by a local polynomial."""
        half = self.start_window // 2
        first = max(row - half, 0)
        values = self.targets[first : row + half + 1, target]
        if not np.isfinite(values).all():
            return float(self.targets[row, target])
        if len(values) < 5:
            return float(values[0])
        return float(smooth_signal(values, len(values) if len(values) % 2 else len(values) - 1)[row - first])


class OutputCorrection(NamedTuple):
    """Corrections between the reported outputs and the vehicle.

    Attributes:
        steer_rad: Added to the steering wheel angle.
        brake_frac: Dead band, subtracted from the brake duty.
        road_share: Share of `FreeRunWindow.sensed_slope` that is a slope of the road.
        throttle_lag_s: First-order lag of the throttle.
    """

    steer_rad: float = 0.0
    brake_frac: float = 0.0
    road_share: float = 0.0
    throttle_lag_s: float = 0.0


class FreeRunStart(NamedTuple):
    """State at row 0, state of the throttle lag before the throttle history, and slope of the road."""

    state: SingleTrackState
    throttle_lag: SoftState
    grade_rad: float


@kernel
def run_single_track(
    params: ChassisParams,
    start: FreeRunStart,
    throttle_history: Any,
    inputs: Any,
    correction: OutputCorrection,
    outputs: Any,
    dt_s: float,
) -> int:
    """Simulate the single track with flat rows of (throttle, brake, steer, gear) from row 1 on; returns their number.

    Args:
        params: Constants.
        start: Of the run.
        throttle_history: Throttle up to row 0.
        inputs: Shape (n_rows * 4,).
        correction: Between outputs and vehicle.
        outputs: Receives TARGETS, shape (n_rows * 6,).
    """
    state, throttle_lag = start.state, start.throttle_lag
    road = Disturbance(start.grade_rad, 1.0, 0.0, 0.0)
    for i in range(len(throttle_history)):
        throttle_lag, _ = step_soft(0.0, throttle_lag, float(throttle_history[i]), dt_s)
    rows = len(inputs) // 4
    idle = params.constants.rest_frac
    for i in range(1, rows):
        brake = float(inputs[4 * i + 1]) - correction.brake_frac
        if brake < idle:
            brake = idle
        steer = float(inputs[4 * i + 2]) + correction.steer_rad
        throttle_lag, throttle = step_soft(0.0, throttle_lag, float(inputs[4 * i]), dt_s)
        act = Actuation(throttle, brake, steer, float(inputs[4 * i + 3]))
        state, motion = step_single_track(params, state, ChassisInput(act, road), dt_s)
        outputs[6 * i] = motion.speed_mps
        outputs[6 * i + 1] = motion.yaw_rate_radps
        outputs[6 * i + 2] = motion.heading_rad
        outputs[6 * i + 3] = motion.lateral_accel_mps2
        outputs[6 * i + 4] = motion.x_m
        outputs[6 * i + 5] = motion.y_m
    return rows


kept(run_single_track)


def simulate_window(params: ChassisParams, window: FreeRunWindow, correction: OutputCorrection) -> Array:
    """TARGETS of a free run at the rows of a window, shape (n_compared, 6)."""
    x_m, y_m, heading, speed, yaw = window.start
    p = params.constants
    grip = p.rear_stiffness * (p.front_axle_m + p.rear_axle_m)
    mass_kg = p.mass_kg * p.front_axle_m
    side = p.rear_axle_m * yaw - mass_kg * speed * speed * yaw / grip  # side speed of a steady turn
    first = Motion(x_m, y_m, heading, speed, side, yaw, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    outputs = np.zeros(len(window.inputs) * N_TARGETS)
    flat = np.ascontiguousarray(window.inputs).ravel()
    grade_rad = math.asin(max(-1.0, min(correction.road_share * window.sensed_slope, 1.0)))
    lag = soft(correction.throttle_lag_s, float(window.throttle_history[0]))  # settled at the first known throttle
    lag_state, history = lag.init(lag.params, window.dt_s), np.ascontiguousarray(window.throttle_history)
    start = FreeRunStart(SingleTrackState(first, 0.0), lag_state, grade_rad)
    run_single_track(params, start, history, flat, correction, outputs, window.dt_s)
    return outputs.reshape(-1, N_TARGETS)[window.rows]


def compute_errors(
    params: Mapping[str, float], correction: OutputCorrection, windows: Sequence[FreeRunWindow]
) -> Array:
    """Simulated minus measured TARGETS, shape (n_windows, n_compared, 6); NaN where nothing was measured."""
    chassis = ChassisParams(constants_of(params, BodyChange()))
    return np.stack([simulate_window(chassis, window, correction) - window.targets for window in windows])


def compute_target_rms(errors: Array) -> dict[str, float]:
    """Root mean square error of each measured target; errors as from `compute_errors`."""
    rms = {}
    for i, name in enumerate(TARGETS):
        measured = errors[:, :, i][np.isfinite(errors[:, :, i])]
        if len(measured):
            rms[name] = float(np.sqrt(np.mean(measured * measured)))
    return rms
