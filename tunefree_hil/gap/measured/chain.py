"""A drive split at its measured intermediates: command, echo, reported output, motion as chassis and INS measure it.

    command -> echo -> actuator -> reported output -> car -> chassis reports, INS

Each link is judged by what was measured before it, so that a broken link does not break those after it. For what a log
does not hold, each link has a reason (observability.py).

An INS that gives pose but no speed or yaw rate (motion capture, a receiver with two antennas) has these made from the
slopes of its pose. In such a recording that is the only second opinion on wheels and gyro.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Link
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import GEAR_DRIVE
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.gap.measured.observability import OUTPUT_FIELDS, find_missing_links, find_unknown_channels
from tunefree_hil.gap.measured.signals import (
    INS_PREFIX,
    Signal,
    drop_sparse_ins,
    find_valid_command_rows,
    is_ins_sparse,
    read_signals,
    signal_from_values,
)
from tunefree_hil.gap.model.graph import CHANNELS, DriveInputs
from tunefree_hil.learn.actuators.samples import ECHOES, pedals_from_accel_command, read_accel_command, read_actuation
from tunefree_hil.learn.data_sheet import com_to_rear_axle_m
from tunefree_hil.learn.drives.drive import CHASSIS_FIRST_YAW_RATES, Drive
from tunefree_hil.learn.drives.runs import find_runs, sample_interval_ticks
from tunefree_hil.learn.drives.smoothing import estimate_rate, interpolate_fresh, smooth_signal, yaw_rate_from_wheels

Array = np.ndarray

ROAD_CAR_WHEELBASE_M = 2.7
EMPTY: Mapping[str, int] = {}


class ChainCriteria(NamedTuple):
    """How a drive is split (docs/results/criteria.md)."""

    motion_window_s: float = 0.21  # of the polynomial through the measured motion that the chassis is set to
    min_curvature_speed_mps: float = 0.5  # slower wheels give no curvature
    model_car_scale: float = 0.5  # wheelbase as a share of a road car's: no road car is shorter
    settling_s: float = 1.0  # after a stretch in which commands did not act, the output is still another's


class PoseCriteria(NamedTuple):
    """When the slopes of a pose are rates (docs/results/criteria.md)."""

    slope_values: int = 5  # values under a slope: more would smooth away what a quick car does
    max_interval_s: float = 0.06  # between two values: a slope over more than a quarter of a second is no rate
    min_values: int = 20  # of each field; with fewer there are no slopes
    typical_quantile: float = 0.99  # of the steps, that counts as a typical step
    jump_ratio: float = 5.0  # of a step to a typical one: a longer step is no motion


CHAIN_CRITERIA, POSE_CRITERIA = ChainCriteria(), PoseCriteria()


class MeasuredDrive(NamedTuple):
    """One drive, split at its measured intermediates.

    Args:
        name: of the drive.
        log_hash: of the log.
        dt_s: length of a tick.
        inputs: what the graph takes.
        signals: by field name.
        command_active: (ticks, 3), 1 where the commands of a channel acted.
        is_moving: (ticks,), in gear, with all that the chassis takes known.
        unobservable_links: why the log cannot show a link.
        size_scale: a model car's wheelbase as a share of a road car's, else 1; speeds are compared in wheelbases per s.
        derived_ticks: fields of `signals` that were made of others, with the ticks under a slope (1: no slope).
        max_steer_rad: the vehicle's greatest steering angle.
        omissions: what was left out, as texts.
        wheelbase_m: of the vehicle.
        command_active_s: by channel, how long its commands acted.
        unknown_channels: channels of which the log holds nothing (observability.py).
    """

    name: str
    log_hash: str
    dt_s: float
    inputs: DriveInputs
    signals: Mapping[str, Signal]
    command_active: Array
    is_moving: Array
    unobservable_links: Mapping[Link, str]
    size_scale: float = 1.0
    derived_ticks: Mapping[str, int] = EMPTY
    max_steer_rad: float = 8.0
    omissions: tuple[str, ...] = ()
    wheelbase_m: float = ROAD_CAR_WHEELBASE_M
    command_active_s: Mapping[str, float] = EMPTY
    unknown_channels: frozenset[str] = frozenset()

    @property
    def ticks(self) -> int:
        """Number of rows."""
        return len(self.is_moving)

    @property
    def has_wheel_yaw_rate(self) -> bool:
        """Whether the chassis's yaw rate is made from wheel speeds, for want of a gyro."""
        return CHASSIS_FIRST_YAW_RATES[0] in self.derived_ticks

    @property
    def kinematic_steer_rad(self) -> Array:
        """Curvature of the path times wheelbase, (ticks,): about the angle of the road wheels."""
        speed = np.maximum(self.inputs.speed_mps, CHAIN_CRITERIA.min_curvature_speed_mps)
        return self.wheelbase_m * self.inputs.yaw_rate_radps / speed

    def has_signals(self, *names: str) -> bool:
        """Whether all of these fields were measured."""
        return all(name in self.signals for name in names)


class _DriveSignals(NamedTuple):
    """Signals of a drive; derived_ticks, omissions: as in MeasuredDrive; speed_source: field of the speed."""

    signals: Mapping[str, Signal]
    derived_ticks: Mapping[str, int]
    omissions: tuple[str, ...]
    speed_source: str


class _ChainInputs(NamedTuple):
    """inputs; command_active: (ticks, 3); is_known: (ticks,), all that the chassis takes is known."""

    inputs: DriveInputs
    command_active: Array
    is_known: Array


def build_measured_drive(drive: Drive, vehicle: VehicleSpec) -> MeasuredDrive:
    """Split a drive.

    Raises:
        InputError: neither INS nor chassis gives the speed, so the motion is not known.
    """
    collected = _collect_signals(drive, vehicle)
    signals, speed_source = collected.signals, collected.speed_source
    if speed_source not in signals:
        raise InputError(
            "the log holds no speed",
            code="no_motion",
            file=drive.name,
            key="report.speed_mps",
            hint="speed is needed, from the chassis or from an INS",
        )
    inputs, command_active, is_known = _build_inputs(drive, vehicle, signals, speed_source)
    return MeasuredDrive(
        name=drive.name,
        log_hash=drive.log_hash,
        dt_s=drive.dt_s,
        inputs=inputs,
        signals=signals,
        command_active=command_active,
        is_moving=is_known & signals[speed_source].is_valid & (inputs.gear >= GEAR_DRIVE),
        unobservable_links=find_missing_links(signals, speed_source.startswith(INS_PREFIX)),
        size_scale=size_scale_from_vehicle(vehicle),
        derived_ticks=collected.derived_ticks,
        max_steer_rad=vehicle.limits.steer_rad,
        omissions=collected.omissions,
        wheelbase_m=vehicle.nominal.wheelbase_m or ROAD_CAR_WHEELBASE_M,
        command_active_s={name: float(drive.dt_s * command_active[:, i].sum()) for i, name in enumerate(CHANNELS)},
        unknown_channels=find_unknown_channels(drive, vehicle),
    )


def has_speed(drive: Drive, vehicle: VehicleSpec) -> bool:
    """Whether a drive holds a speed."""
    collected = _collect_signals(drive, vehicle)
    return collected.speed_source in collected.signals


def _collect_signals(drive: Drive, vehicle: VehicleSpec) -> _DriveSignals:
    """The measured signals, and those that are made of them."""
    measured = read_signals(drive, vehicle.ins_frame.latency_s / drive.dt_s)
    derived = _derive_missing_signals(drive, vehicle, measured)
    signals, omissions = drop_sparse_ins(measured | derived, drive.name)
    derived_ticks = {
        name: 1 if name.startswith("report.") else slope_window_ticks(measured[HEADING].fresh)
        for name in derived
        if name in signals
    }
    speed_source = "ins.speed_mps" if "ins.speed_mps" in signals else "report.speed_mps"
    return _DriveSignals(signals, derived_ticks, omissions + _describe_pose_jumps(drive, measured), speed_source)


def find_commanded_channels(drive: MeasuredDrive) -> Array:
    """(3,), of throttle, brake, steer: whether commands acted anywhere in a drive."""
    return np.asarray((drive.command_active > 0.5).any(axis=0))


def is_replayable(drive: MeasuredDrive, rows: slice) -> bool:
    """Whether a stretch can be run freely: in gear, inputs known, and the commands of all used channels acting."""
    is_active = (drive.command_active[rows] > 0.5)[:, find_commanded_channels(drive)]
    return bool(drive.is_moving[rows].all() and is_active.all())


def size_scale_from_vehicle(vehicle: VehicleSpec) -> float:
    """A model car's wheelbase as a share of a road car's; 1 for a road car."""
    share = (vehicle.nominal.wheelbase_m or ROAD_CAR_WHEELBASE_M) / ROAD_CAR_WHEELBASE_M
    return share if share < CHAIN_CRITERIA.model_car_scale else 1.0


def _derive_missing_signals(drive: Drive, vehicle: VehicleSpec, signals: Mapping[str, Signal]) -> dict[str, Signal]:
    """Signals that are not measured: an INS's rates from its pose, and a missing yaw rate from the wheels."""
    derived = {}
    for name, rate in rates_from_pose(_values(signals), _fresh(signals), drive.dt_s).items():
        is_valid = np.all([signals[source].is_valid for source in POSE_SOURCES[name]], axis=0)
        derived[name] = signals[HEADING]._replace(values=np.nan_to_num(rate), is_valid=is_valid)
    wheels = yaw_rate_from_wheels(drive, vehicle.nominal)
    chassis_yaw, ins_yaw = CHASSIS_FIRST_YAW_RATES
    if chassis_yaw in signals or wheels is None or (wheels[1] & np.isfinite(wheels[0])).sum() < 2:
        return derived
    wheel_yaw = signal_from_values(*wheels, drive.dt_s)
    available = {**signals, **derived, chassis_yaw: wheel_yaw}
    if ins_yaw not in available or is_ins_sparse(available, ins_yaw, chassis_yaw):
        derived[chassis_yaw] = wheel_yaw
    return derived


def _describe_pose_jumps(drive: Drive, signals: Mapping[str, Signal]) -> tuple[str, ...]:
    jumps = find_pose_jumps(_values(signals), _fresh(signals), drive.dt_s)
    return (f"{drive.name}: {', '.join(jumps)} jumps, so no rate is made from it",) if jumps else ()


def _values(signals: Mapping[str, Signal]) -> dict[str, Array]:
    return {name: signal.values for name, signal in signals.items()}


def _fresh(signals: Mapping[str, Signal]) -> dict[str, Array]:
    return {name: signal.fresh for name, signal in signals.items()}


class _ChannelInputs(NamedTuple):
    """What _ChainInputs has of one channel, each (ticks,); has_output, is_echoed: as in DriveInputs."""

    command: Array
    output: Array
    command_active: Array
    is_known: Array
    has_output: bool
    is_echoed: bool


def _build_inputs(drive: Drive, vehicle: VehicleSpec, signals: Mapping[str, Signal], speed_source: str) -> _ChainInputs:
    rest, n_rows = vehicle.nominal.rest_pedal_frac, drive.n_rows
    accel = read_accel_command(drive)
    pedals = [] if accel is None else pedals_from_accel_command(accel, drive.enabled, rest)
    channels = []
    for i, name in enumerate(CHANNELS):
        idle = 0.0 if name == "steer" else rest
        has_accel = i < len(pedals)
        command, _, acts = pedals[i] if has_accel else read_actuation(drive, name, idle)
        is_echoed = f"report.{ECHOES['accel' if has_accel else name]}" in signals
        filled = np.nan_to_num(command, nan=idle)
        channel = _build_channel(drive, signals, name, filled, acts & np.isfinite(command))
        channels.append(channel._replace(is_echoed=is_echoed))
    gear = signals.get("report.gear")
    gears = np.full(n_rows, GEAR_DRIVE) if gear is None else np.round(_hold_last_value(drive, "report.gear"))
    window = max(round(CHAIN_CRITERIA.motion_window_s / drive.dt_s) | 1, 5)
    speed = np.maximum(smooth_signal(signals[speed_source].values, window), 0.0)
    yaw_source = "ins.yaw_rate_radps" if "ins.yaw_rate_radps" in signals else "report.yaw_rate_radps"
    yaw = smooth_signal(signals[yaw_source].values, window) if yaw_source in signals else np.zeros(n_rows)
    throttle, brake, steer = channels
    inputs = DriveInputs(
        commands=np.stack([channel.command for channel in channels], axis=1),
        outputs=np.stack([channel.output for channel in channels], axis=1),
        gear=gears,
        speed_mps=speed,
        yaw_rate_radps=yaw,
        side_speed_mps=com_to_rear_axle_m(vehicle.nominal) * yaw,
        speed_rate_mps2=np.nan_to_num(estimate_rate(speed, np.ones(n_rows, dtype=bool), window, drive.dt_s)),
        is_pinned=np.ones(n_rows),
        has_output=(throttle.has_output, brake.has_output, steer.has_output),
        is_echoed=(throttle.is_echoed, brake.is_echoed, steer.is_echoed),
        uses_ins_speed=speed_source.startswith(INS_PREFIX),
        dt_s=drive.dt_s,
    )
    command_active = np.stack([channel.command_active for channel in channels], axis=1)
    return _ChainInputs(inputs, command_active, np.all([channel.is_known for channel in channels], axis=0))


def _build_channel(
    drive: Drive, signals: Mapping[str, Signal], name: str, command: Array, acts: Array
) -> _ChannelInputs:
    """A channel's inputs; is_echoed is left False.

    Args:
        drive, signals: the drive.
        name: of the channel.
        command: (ticks,), at rest where it is not known.
        acts: (ticks,), whether the command acts.
    """
    acts = acts & drive.enabled & find_valid_command_rows(signals, _command_sources(name), drive.n_rows)
    report = signals.get(f"report.{OUTPUT_FIELDS[name]}")
    output = command if report is None else report.values
    command_active = _find_settled_rows(acts, drive.dt_s)
    return _ChannelInputs(
        command=np.where(acts, command, output),
        output=output,
        command_active=command_active,
        is_known=command_active if report is None else report.is_valid,
        has_output=report is not None,
        is_echoed=False,
    )


def _command_sources(channel: str) -> tuple[str, ...]:
    """Fields with a channel's commands, the best first; in a gap of them the command is not known."""
    own = (f"report.{ECHOES[channel]}", f"command.{OUTPUT_FIELDS[channel]}")
    return own if channel == "steer" else (*own, f"report.{ECHOES['accel']}", "command.accel_mps2")


def _hold_last_value(drive: Drive, name: str) -> Array:
    """A signal of steps, (ticks,): the newest value, the first one before it."""
    values = drive.fields[name].copy()
    finite = np.flatnonzero(np.isfinite(values))
    values[: finite[0]] = values[finite[0]]
    return np.nan_to_num(values, nan=GEAR_DRIVE)


def _find_settled_rows(acts: Array, dt_s: float) -> Array:
    """(ticks,): rows that lie settling_s after the beginning of a stretch in which commands act."""
    settled = np.zeros(len(acts), dtype=bool)
    settling = round(CHAIN_CRITERIA.settling_s / dt_s)
    for begin, end in find_runs(acts, settling + 1):
        settled[begin + settling : end] = True
    return settled


X, Y, HEADING, SPEED, YAW_RATE = "ins.x_m", "ins.y_m", "ins.heading_rad", "ins.speed_mps", "ins.yaw_rate_radps"
POSE_SOURCES = {YAW_RATE: (HEADING,), SPEED: (HEADING, X, Y)}


def rates_from_pose(fields: Mapping[str, Array], fresh: Mapping[str, Array], dt_s: float) -> dict[str, Array]:
    """The speed and yaw rate that an INS does not give, as slopes of its pose.

    Empty where it gives them, where its values are too far apart, and where the pose jumps (lost tracking, a
    correction).

    Args:
        fields: by name, (ticks,).
        fresh: by name, (ticks,), whether a new value came.
        dt_s: length of a tick.

    Returns:
        By field name, (ticks,), m/s along the heading and rad/s, new where the heading is; NaN before the first pose.
    """
    rates: dict[str, Array] = {}
    jumps = find_pose_jumps(fields, fresh, dt_s)
    if not _is_frequent(fresh, (HEADING,), dt_s) or HEADING in jumps:
        return rates
    heading = _unwrap(fields[HEADING], fresh[HEADING])
    if YAW_RATE not in fields:
        rates[YAW_RATE] = _fit_slope(heading, fresh[HEADING], dt_s)
    if SPEED not in fields and _is_frequent(fresh, (X, Y), dt_s) and not jumps:
        interpolated = interpolate_fresh(heading, fresh[HEADING])
        east, north = (_fit_slope(fields[name], fresh[name], dt_s) for name in (X, Y))
        rates[SPEED] = east * np.cos(interpolated) + north * np.sin(interpolated)
    return rates


def find_pose_jumps(fields: Mapping[str, Array], fresh: Mapping[str, Array], dt_s: float) -> tuple[str, ...]:
    """The fields of a pose that jump, of those whose slopes are needed."""
    if not _is_frequent(fresh, (HEADING,), dt_s):
        return ()
    needed = ((HEADING,) if YAW_RATE not in fields else ()) + ((HEADING, X, Y) if SPEED not in fields else ())
    return tuple(
        name
        for name in dict.fromkeys(needed)
        if _is_frequent(fresh, (name,), dt_s)
        and _has_jump(_unwrap(fields[name], fresh[name]) if name == HEADING else fields[name], fresh[name])
    )


def slope_window_ticks(fresh: Array) -> int:
    """Ticks under a slope."""
    return (POSE_CRITERIA.slope_values - 1) * round(sample_interval_ticks(fresh)) | 1


def _has_jump(values: Array, fresh: Array) -> bool:
    """Whether a step is too long for the time that it took; over lost frames a car goes on."""
    rows = np.flatnonzero(fresh & np.isfinite(values))
    rate = np.abs(np.diff(values[rows])) / np.diff(rows)
    typical = max(float(np.quantile(rate, POSE_CRITERIA.typical_quantile)), 1e-12)
    return bool(rate.max() > POSE_CRITERIA.jump_ratio * typical)


def _is_frequent(fresh: Mapping[str, Array], names: tuple[str, ...], dt_s: float) -> bool:
    """Whether all of these fields have values, close enough for slopes."""
    if any(name not in fresh or fresh[name].sum() < POSE_CRITERIA.min_values for name in names):
        return False
    return all(round(sample_interval_ticks(fresh[name])) * dt_s <= POSE_CRITERIA.max_interval_s for name in names)


def _unwrap(values: Array, fresh: Array) -> Array:
    """A heading without steps of a full turn."""
    unwrapped, rows = values.copy(), np.flatnonzero(fresh & np.isfinite(values))
    unwrapped[rows] = np.unwrap(values[rows])
    return unwrapped


def _fit_slope(values: Array, fresh: Array, dt_s: float) -> Array:
    """Rate per s, (ticks,); NaN before the first value."""
    return estimate_rate(values, fresh, slope_window_ticks(fresh), dt_s)
