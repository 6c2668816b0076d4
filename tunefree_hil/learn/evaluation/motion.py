"""Aligned motion and commands of a stretch of a drive: the data of training and free runs.

Row k of a track is one instant: the motion reported in tick k, and the commands that acted from row k - 1 to row k, in
the time frame of learn/actuators/samples.py.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from tunefree_hil.base import parts
from tunefree_hil.base.contracts import BodyChange, make_effect
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block, series
from tunefree_hil.base.records import GEAR_DRIVE
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.schema import ActuatorSpec, ModelSpec, VehicleSpec, value_of
from tunefree_hil.learn.actuators.samples import pedals_from_accel_command, read_accel_command, read_actuation
from tunefree_hil.learn.data_sheet import com_to_rear_axle_m
from tunefree_hil.learn.drives.drive import INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES, Array, Drive, DrivePart
from tunefree_hil.learn.drives.road_slope import estimate_accel_offset
from tunefree_hil.learn.drives.runs import find_runs
from tunefree_hil.learn.drives.smoothing import (
    estimate_mean_noise,
    interpolate_first_field,
    interpolate_fresh,
    shift_earlier,
    yaw_rate_from_wheels,
)
from tunefree_hil.learn.drives.validity import (
    DRIVING_CHANNELS,
    POSE_FIELDS,
    actuation_valid_rows,
    interpolate_pose,
    motion_valid_rows,
)
from tunefree_hil.plant.actuation.acceleration_interface import pedals_of
from tunefree_hil.plant.actuation.actuators import ActuatorParams, actuator

SMOOTHING_ROWS, SMOOTHING_ORDER = 51, 3  # Savitzky-Golay filter of the labels, as in Apollo's data pipeline
SETTLING_S = 10.0  # time for which an effect behind an actuator gets its first value, so that it starts settled


class SlopeCriteria(NamedTuple):
    """When an accelerometer shows a slope (docs/results/criteria.md)."""

    filter_rows: int = 201  # rows of the moving mean: an accelerometer resolves a slope over 2 s
    min_hill_rad: float = 0.015  # slope above which a road counts as a hill; more than a sensor offset
    # noise of the filtered slope above which the accelerometer is not used: half of a hill
    max_noise_rad: float = 0.5 * 0.015
    min_speed_mps: float = 1.0  # below it stiction, pitch and brakes dominate the accelerometer
    min_usable_share: float = 0.25  # of the rows of the moving mean


class StartCriteria(NamedTuple):
    """Speeds at which a track is used."""

    min_speed_mps: float = -0.1  # lowest speed of a usable row; noise around standstill is allowed
    min_mean_speed_mps: float = 0.3  # mean speed ahead of a start: a standing vehicle shows no error


SLOPE = SlopeCriteria()
START = StartCriteria()


class MotionTrack(NamedTuple):
    """A stretch of a drive. Arrays have a row a tick; those of channels are throttle, brake (duty), steer (rad).

    Attributes:
        name: Drive.
        log_hash: Of its log.
        begin: Row of the drive.
        speed_mps: Smoothed (Savitzky-Golay), like yaw rate and acceleration.
        accel_mps2: Rate of speed, smoothed.
        heading_rad: Continuous.
        x_m: Position of the rear axle.
        y_m: Position of the rear axle.
        grade_rad: Slope of the road by the accelerometer, 0 where it counts as level.
        commands: Shape (n_rows, 3).
        recorded: Reported outputs, shape (n_rows, 3), NaN where none are reported.
        follows_command: Whether the command acted, shape (n_rows, 3); else only the recorded output is known.
        is_good: Usable rows.
        accel_demand_mps2: Of a vehicle with commanded acceleration; its pedals in `commands` are those of
            plant/actuation/acceleration_interface.py.
    """

    name: str
    log_hash: str
    begin: int
    dt_s: float
    speed_mps: Array
    yaw_rate_radps: Array
    accel_mps2: Array
    heading_rad: Array
    x_m: Array
    y_m: Array
    grade_rad: Array
    commands: Array
    recorded: Array
    follows_command: Array
    is_good: Array
    accel_demand_mps2: Array | None = None

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return len(self.speed_mps)


class _Motion(NamedTuple):
    """Smoothed motion of a stretch."""

    speed: Array
    yaw: Array
    accel: Array


class _Pose(NamedTuple):
    heading: Array
    x: Array
    y: Array
    is_measured: bool


def make_motion_tracks(
    parts: Iterable[DrivePart], vehicle: VehicleSpec, min_rows: int = 0, road_share: float = 0.0
) -> list[MotionTrack]:
    """A track of every part of at least `min_rows` and SMOOTHING_ROWS rows.

    Args:
        parts: Parts of drives.
        vehicle: Vehicle folder.
        min_rows: Least length.
        road_share: Share of the constant accelerometer offset that is a slope (learn/drives/road_slope.py).

    Raises:
        InputError: No speed or no yaw rate is reported.
    """
    shortest = max(min_rows, SMOOTHING_ROWS)
    return [make_motion_track(part, vehicle, road_share) for part in parts if part.end - part.begin >= shortest]


def make_motion_track(part: DrivePart, vehicle: VehicleSpec, road_share: float = 0.0) -> MotionTrack:
    """The track of one part; see `make_motion_tracks`."""
    drive, cut = part.drive, slice(part.begin, part.end)
    ins_delay_rows = round(vehicle.ins_frame.latency_s / drive.dt_s)
    motion = _smoothed_motion(part, vehicle, ins_delay_rows)
    pose = _pose_or_dead_reckoning(drive, cut, ins_delay_rows, motion)
    rest = vehicle.nominal.rest_pedal_frac
    channels = [read_actuation(drive, name, 0.0 if name == "steer" else rest) for name in DRIVING_CHANNELS]
    demand = read_accel_command(drive)
    if demand is not None:
        channels[:2] = pedals_from_accel_command(demand, drive.enabled, rest)
    commands, recorded, is_actuated = (np.stack([channel[i][cut] for channel in channels], axis=1) for i in range(3))
    usable = np.where(is_actuated, commands, recorded)
    good = np.isfinite(np.stack([*motion, pose.heading, pose.x, pose.y], axis=1)).all(axis=1)
    good &= np.isfinite(usable).all(axis=1) & (motion.speed > START.min_speed_mps)
    is_valid = motion_valid_rows(drive, ins_delay_rows, pose.is_measured)
    good &= (is_valid & actuation_valid_rows(drive, [channel[2] for channel in channels]))[cut]
    gear = drive.get("report.gear")
    if gear is not None and not np.isnan(gear).all():
        good &= gear[cut] == GEAR_DRIVE
    offset_g = (1.0 - road_share) * estimate_accel_offset(drive, vehicle)
    return MotionTrack(
        name=drive.name,
        log_hash=drive.log_hash,
        begin=part.begin,
        dt_s=drive.dt_s,
        speed_mps=np.maximum(motion.speed, 0.0),
        yaw_rate_radps=motion.yaw,
        accel_mps2=motion.accel,
        heading_rad=pose.heading,
        x_m=pose.x,
        y_m=pose.y,
        grade_rad=_estimate_grade(part, motion, vehicle, offset_g),
        commands=commands,
        recorded=recorded,
        follows_command=is_actuated,
        is_good=good,
        accel_demand_mps2=None if demand is None else demand[cut],
    )


def _smoothed_motion(part: DrivePart, vehicle: VehicleSpec, ins_delay_rows: int) -> _Motion:
    drive, cut = part.drive, slice(part.begin, part.end)
    speed = _first_signal(drive, INS_FIRST_SPEEDS, ins_delay_rows)[cut]
    yaw = smooth_motion_signal(_yaw_rate(drive, vehicle, ins_delay_rows)[cut])
    return _Motion(smooth_motion_signal(speed), yaw, smooth_motion_signal(speed, drive.dt_s))


def smooth_motion_signal(values: Array, dt_s: float = 0.0) -> Array:
    """Savitzky-Golay filter over finite rows, or with dt_s their rate per s; NaN in runs below SMOOTHING_ROWS."""
    smoothed = np.full(len(values), np.nan)
    for begin, end in find_runs(np.isfinite(values)):
        if end - begin >= SMOOTHING_ROWS:
            derivative = {"deriv": 1, "delta": dt_s} if dt_s else {}
            smoothed[begin:end] = savgol_filter(values[begin:end], SMOOTHING_ROWS, SMOOTHING_ORDER, **derivative)
    return smoothed


def _first_signal(drive: Drive, names: Sequence[str], ins_delay_rows: int) -> Array:
    """The first of these fields with values; INS fields are shifted by the INS delay."""
    even = interpolate_first_field(drive, names, ins_delay_rows)
    if even is not None:
        return even
    raise InputError(
        f"the logs have no {' or '.join(names)}",
        code="no_motion",
        file=drive.name,
        key=names[0],
        hint="speed and yaw rate are needed, from the chassis or from an INS",
    )


def _yaw_rate(drive: Drive, vehicle: VehicleSpec, ins_delay_rows: int) -> Array:
    """Of the INS or the chassis; from the rear wheels where neither reports it."""
    wheels = yaw_rate_from_wheels(drive, vehicle.nominal)
    if wheels is not None and all(drive.get(name) is None for name in INS_FIRST_YAW_RATES):
        return interpolate_fresh(*wheels)
    return _first_signal(drive, INS_FIRST_YAW_RATES, ins_delay_rows)


def _pose_or_dead_reckoning(drive: Drive, cut: slice, ins_delay_rows: int, motion: _Motion) -> _Pose:
    """The smoothed pose of the INS, or speed and yaw rate integrated where it reports none."""
    fields = [drive.get(name) for name in POSE_FIELDS]
    if all(values is not None and not np.isnan(values).all() for values in fields):
        heading, x, y = (shift_earlier(values, ins_delay_rows)[cut] for values in interpolate_pose(drive))
        return _Pose(smooth_motion_signal(heading), smooth_motion_signal(x), smooth_motion_signal(y), True)
    speed, yaw = motion.speed, motion.yaw
    mean_yaw = 0.5 * (yaw[1:] + yaw[:-1])
    heading = np.concatenate([[0.0], np.cumsum(np.nan_to_num(mean_yaw) * drive.dt_s)])
    middle, along = 0.5 * (heading[1:] + heading[:-1]), np.nan_to_num(0.5 * (speed[1:] + speed[:-1])) * drive.dt_s
    x = np.concatenate([[0.0], np.cumsum(along * np.cos(middle))])
    y = np.concatenate([[0.0], np.cumsum(along * np.sin(middle))])
    return _Pose(heading, x, y, False)


def _estimate_grade(part: DrivePart, motion: _Motion, vehicle: VehicleSpec, offset_g: float) -> Array:
    """Slope of the road, rad: specific force beyond the rate of speed; 0 where level, slow or not measured.

    Args:
        part: Part of a drive.
        motion: Of the part.
        vehicle: Vehicle folder.
        offset_g: Offset of the accelerometer, in g.
    """
    drive, cut, speed = part.drive, slice(part.begin, part.end), motion.speed
    force = drive.get("report.accel_mps2")
    flat = np.zeros(len(speed))
    if force is None or len(speed) < SLOPE.filter_rows:
        return flat
    outwards_mps2 = com_to_rear_axle_m(vehicle.nominal) * motion.yaw * motion.yaw  # at the centre of mass
    sine = (force[cut] - motion.accel + outwards_mps2) / G_MPS2
    sine -= offset_g
    usable = np.isfinite(sine) & (speed > SLOPE.min_speed_mps)
    fresh = drive.fresh["report.accel_mps2"][cut]
    if estimate_mean_noise(np.where(usable, sine, np.nan), fresh, SLOPE.filter_rows) > SLOPE.max_noise_rad:
        return flat
    weight = np.convolve(usable, np.ones(SLOPE.filter_rows), "same")
    total = np.convolve(np.where(usable, sine, 0.0), np.ones(SLOPE.filter_rows), "same")
    mean = total / np.maximum(weight, 1.0)
    slope = np.arcsin(np.clip(mean, -0.5, 0.5))
    is_hill = (weight > SLOPE.min_usable_share * SLOPE.filter_rows) & (abs(slope) >= SLOPE.min_hill_rad)
    return np.where(is_hill, slope, flat)


def actuator_params(spec: ActuatorSpec, rest: float, initial: float) -> ActuatorParams:
    """Kernel parameters of a channel of [actuators], settled at the command `initial`."""
    values = {
        name: float(value_of(getattr(spec, name))) for name in spec.__struct_fields__ if name in ActuatorParams._fields
    }
    return ActuatorParams(**values)._replace(rest=rest, initial=initial)


def simulate_actuators(track: MotionTrack, model: ModelSpec, rest: float, takes_commands: bool = False) -> Array:
    """Outputs of a model's actuators, with its effects before and behind them, shape (n_rows, 3).

    Where commands did not act, the recorded output replaces that of the actuator; the effects behind
    the actuator still apply.

    Args:
        track: The commands.
        model: Model folder.
        rest: Duty of a released pedal.
        takes_commands: The plant takes commands and has no actuators (kind paper).
    """
    outputs = np.empty((track.n_rows, len(DRIVING_CHANNELS)))
    by_accel = track.accel_demand_mps2 is not None and not takes_commands
    for column, name in enumerate(DRIVING_CHANNELS):
        idle = 0.0 if name == "steer" else rest
        outputs[:, column] = _recorded_outputs(track, model, column, idle)
        if by_accel and name != "steer":
            continue
        for begin, end in find_runs(track.follows_command[:, column]):
            commands = track.commands[begin:end, column]
            block = _make_channel_block(model, name, idle, float(commands[0]), takes_commands)
            outputs[begin:end, column] = _run_block(block, commands, track.dt_s)
    if by_accel:
        _fill_pedals_from_accel(track, model, rest, outputs)
    return outputs


def _recorded_outputs(track: MotionTrack, model: ModelSpec, column: int, idle: float) -> Array:
    """Recorded outputs of a channel, with the effects behind the actuator where the command did not act."""
    outputs = np.array(track.recorded[:, column], dtype=np.float64)
    if behind := _load_effects_at(model, f"{DRIVING_CHANNELS[column]} B", idle):
        n_settling = math.ceil(SETTLING_S / track.dt_s)
        for begin, end in find_runs(~track.follows_command[:, column] & np.isfinite(outputs)):
            inputs = np.concatenate([np.full(n_settling, outputs[begin]), outputs[begin:end]])
            outputs[begin:end] = _run_block(_connect_in_series(behind), inputs, track.dt_s)[n_settling:]
    return outputs


def _fill_pedals_from_accel(track: MotionTrack, model: ModelSpec, rest: float, outputs: Array) -> None:
    """Fill in the pedals of a vehicle with commanded acceleration, through its channel 'accel'."""
    assert track.accel_demand_mps2 is not None
    for begin, end in find_runs(track.follows_command[:, 0]):
        demand = track.accel_demand_mps2[begin:end]
        block = _make_channel_block(model, "accel", 0.0, float(demand[0]), False)
        accels = _run_block(block, demand, track.dt_s)
        outputs[begin:end, :2] = [pedals_of(accel_mps2, rest) for accel_mps2 in accels]


def body_change(model: ModelSpec) -> BodyChange:
    """Changes of body and forces by the effects of a model."""
    change = BodyChange()
    for spec in model.effects:
        effect = make_effect(parts.load("tunefree_hil.effects", spec.name, "EFFECT"), spec.params, name=spec.name)
        if not isinstance(effect, Block):
            change = effect(change)
    return change


def _make_channel_block(model: ModelSpec, name: str, rest: float, initial: float, takes_commands: bool) -> Block:
    """Effects A, actuator, effects on its output, effects B of one channel, in series."""
    before, ends, behind = (_load_effects_at(model, f"{name} {place}", rest) for place in ("A", "out A", "B"))
    spec = model.actuators.get(name, ActuatorSpec())
    ideal = ActuatorParams(rest=rest, initial=initial)
    params = ideal if takes_commands else actuator_params(spec, rest, initial)
    return _connect_in_series([*before, actuator(params), *ends, *behind])


def _load_effects_at(model: ModelSpec, port: str, rest: float) -> list[Block]:
    """The effects of a model at a port, in their order."""
    blocks = []
    for spec in model.effects:
        effect = parts.load("tunefree_hil.effects", spec.name, "EFFECT")
        block = make_effect(effect, spec.params, rest=rest, name=spec.name) if effect.port.value == port else None
        if isinstance(block, Block):
            blocks.append(block)
    return blocks


def _connect_in_series(chain: Sequence[Block]) -> Block:
    block = chain[0]
    for following in chain[1:]:
        block = series(block, following)
    return block


def _run_block(block: Block, commands: Array, dt_s: float) -> list[float]:
    step, params, outputs = block.step, block.params, []
    state = block.init(params, dt_s)
    for command in commands.tolist():
        state, output = step(params, state, command, dt_s)
        outputs.append(output)
    return outputs


def find_starts(track: MotionTrack, warm_up_rows: int, free_rows: int, spacing_rows: int) -> list[int]:
    """Rows at which a free run can begin: usable from `warm_up_rows` before to `free_rows` behind, and moving."""
    starts = []
    for begin, end in find_runs(track.is_good):
        for row in range(begin + warm_up_rows, end - free_rows, spacing_rows):
            if float(track.speed_mps[row : row + free_rows + 1].mean()) > START.min_mean_speed_mps:
                starts.append(row)
    return starts


def is_hilly(track: MotionTrack, row: int, free_rows: int) -> bool:
    """Whether the road ahead of a start is not level."""
    return bool(np.any(track.grade_rad[row : row + free_rows + 1]))


def wrap_angle(angle_rad: Array) -> Array:
    """The same angles within [-pi, pi)."""
    return (np.asarray(angle_rad) + math.pi) % (2.0 * math.pi) - math.pi
