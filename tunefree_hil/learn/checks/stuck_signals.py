"""Signals that repeat one value for seconds while the quantity that drives them changes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tunefree_hil.learn.actuators.samples import ECHOES
from tunefree_hil.learn.checks.problem import LogProblem
from tunefree_hil.learn.drives.drive import (
    CHASSIS_FIRST_SPEEDS,
    CHASSIS_FIRST_YAW_RATES,
    STEER_FIELDS,
    Array,
    Drive,
    first_field_name,
    first_field_values,
    moving_rows,
)
from tunefree_hil.learn.drives.smoothing import estimate_quantum, estimate_rate

# A stuck echo has a separate code: commands may not have arrived, an effect that `gap` identifies.
STUCK, ECHO_STUCK = "stuck", "echo_stuck"
ECHO_FIELDS = frozenset(f"report.{name}" for name in ECHOES.values())
# Driving quantities that are computed: a signal is expected to change with its driving quantity.
STEERING_TIMES_SPEED, YAW_RATE_TIMES_SPEED = "steering times speed", "yaw rate times speed"
SPEED_RATE, DISTANCE, TURNED_ANGLE = "the rate of the speed", "the distance by the speed", "the angle by the yaw rate"
COMPUTED = (STEERING_TIMES_SPEED, YAW_RATE_TIMES_SPEED, SPEED_RATE, DISTANCE, TURNED_ANGLE)
ACCELERATIONS = (YAW_RATE_TIMES_SPEED, SPEED_RATE)
POSE_FIELDS = ("ins.heading_rad", "ins.x_m")


class StuckCriteria(NamedTuple):
    """When a signal counts as stuck; every value is an engineering choice."""

    min_duration_s: float = 2.0  # of a constant stretch
    min_frames: int = 10  # received within it
    settling_s: float = 0.5  # at each end of the stretch, left out of the driving quantity because signals lag
    rate_window_s: float = 0.5  # of the filter that gives the rate of the speed
    min_signal_quanta: float = 2.0  # of an accelerometer, by which its driving quantity moves at least
    min_speed_quanta: float = 4.0  # per rate_window_s, by which the rate of a coarse speed moves at least
    min_levels: int = 20  # different values of a sensor that may saturate; a defective one has fewer
    max_frozen_pose_share: float = 0.5  # of the moving time


CRITERIA = StuckCriteria()


class DrivingSignal(NamedTuple):
    """The quantity that moves a signal: fields, best first, or one of COMPUTED."""

    names: tuple[str, ...]
    min_range: float  # by which it must change, in its own unit
    min_range_share: float = 0.3  # the same as a share of its range in the whole drive


_YAW = (STEERING_TIMES_SPEED,)
_LONGITUDINAL = (DrivingSignal((SPEED_RATE,), 1.0),)
DRIVING_SIGNALS: dict[str, tuple[DrivingSignal, ...]] = {
    "report.steer_rad": (DrivingSignal(("report.steer_command_rad", "command.steer_rad"), 0.1),),
    "report.steer_command_rad": (DrivingSignal(("command.steer_rad",), 0.1),),
    "report.throttle_frac": (DrivingSignal(("report.throttle_command_frac", "command.throttle_frac"), 0.04),),
    "report.throttle_command_frac": (DrivingSignal(("command.throttle_frac",), 0.04),),
    "report.brake_frac": (DrivingSignal(("report.brake_command_frac", "command.brake_frac"), 0.04),),
    "report.brake_command_frac": (DrivingSignal(("command.brake_frac",), 0.04),),
    "report.steer_torque_nm": (DrivingSignal(("report.steer_torque_command_nm", "command.steer_torque_nm"), 0.0),),
    "report.yaw_rate_radps": (DrivingSignal(("ins.yaw_rate_radps",), 0.1), DrivingSignal(_YAW, 5.0)),
    "ins.yaw_rate_radps": (DrivingSignal(("report.yaw_rate_radps",), 0.1), DrivingSignal(_YAW, 5.0)),
    "report.speed_mps": (DrivingSignal(("ins.speed_mps", "report.wheel_rl_radps"), 1.5),),
    "ins.speed_mps": (DrivingSignal(("report.speed_mps",), 1.5),),
    **{f"report.wheel_{at}_radps": (DrivingSignal(CHASSIS_FIRST_SPEEDS, 1.5),) for at in ("fl", "fr", "rl", "rr")},
    "report.accel_mps2": _LONGITUDINAL,
    "ins.accel_mps2": _LONGITUDINAL,
    "report.lateral_accel_mps2": (DrivingSignal((YAW_RATE_TIMES_SPEED,), 1.0),),
    # Integrals grow with the drive, so their share is 0. On a straight road a gyro drifts by far less than 0.5 rad.
    "ins.heading_rad": (DrivingSignal((TURNED_ANGLE,), 0.5, 0.0),),
    "ins.x_m": (DrivingSignal((DISTANCE,), 5.0, 0.0),),  # together with y, as either may stay constant
}


def check_stuck_signals(drive: Drive) -> Iterator[LogProblem]:
    """For each stuck signal its longest stretch."""
    for name, driving_signals in DRIVING_SIGNALS.items():
        if name in drive.fields:
            problems = (_check_signal(drive, name, driving) for driving in driving_signals)
            problem = next((problem for problem in problems if problem is not None), None)
            if problem is not None:
                yield problem


def _check_signal(drive: Drive, name: str, driving: DrivingSignal) -> LogProblem | None:
    source, values = _driving_values(drive, driving.names)
    if values is None:
        return None
    is_usable = np.isfinite(values) & (drive.enabled if source.startswith("command.") else True)
    if not is_usable.any():
        return None
    min_range = max(driving.min_range, driving.min_range_share * float(np.ptp(values[is_usable])))
    min_range = max(min_range, _quantisation_range(drive, name, source))
    settling_rows = round(CRITERIA.settling_s / drive.dt_s)
    for begin, end in _constant_stretches(drive, name, source):
        inner_rows = slice(begin + settling_rows, end - settling_rows)
        driving_values = values[inner_rows][is_usable[inner_rows]]
        if driving_values.size and np.ptp(driving_values) > 0.0 and np.ptp(driving_values) >= min_range:
            message = (
                f"{drive.path}: {name} is stuck at {drive.fields[name][begin]:.4g} from {begin * drive.dt_s:.2f} to "
                f"{end * drive.dt_s:.2f} s while {source} changes by {np.ptp(driving_values):.3g}, and is expected to "
                "follow; repair the sensor, or cut this stretch out"
            )
            return LogProblem("refuse", ECHO_STUCK if name in ECHO_FIELDS else STUCK, drive.name, name, message)
    return None


def _quantisation_range(drive: Drive, name: str, source: str) -> float:
    """By how much a driving acceleration may move within the quantisation of an accelerometer and of the speed."""
    min_range = 0.0
    if source in ACCELERATIONS:
        signal_quantum = estimate_quantum(drive.fields[name][drive.fresh[name]])
        min_range = max(min_range, CRITERIA.min_signal_quanta * signal_quantum)
    if source == SPEED_RATE:
        speed = first_field_name(drive, CHASSIS_FIRST_SPEEDS) or ""
        speed_quantum = estimate_quantum(drive.fields[speed][drive.fresh[speed]])
        min_range = max(min_range, CRITERIA.min_speed_quanta * speed_quantum / CRITERIA.rate_window_s)
    return min_range


def _constant_stretches(drive: Drive, name: str, source: str) -> list[tuple[int, int]]:
    """Stretches in which a field repeats one value although it should change, longest first.

    A saturated accelerometer is not stuck (gap/measured/signals.py leaves this out). An INS repeats its pose while it
    has no satellites; it is stuck if it does so for most of the driving.
    """
    values, fresh = _signal_values(drive, name)
    stretches = _find_constant(values, fresh, round(CRITERIA.min_duration_s / drive.dt_s))
    if source in ACCELERATIONS:
        measured = values[fresh & np.isfinite(values)]
        range_ends = (measured.min(), measured.max()) if len(np.unique(measured)) > CRITERIA.min_levels else ()
        return [stretch for stretch in stretches if values[stretch[0]] not in range_ends]
    if name in POSE_FIELDS:
        is_moving = moving_rows(drive)
        frozen_rows = sum(is_moving[begin:end].sum() for begin, end in stretches)
        return stretches if frozen_rows > CRITERIA.max_frozen_pose_share * is_moving.sum() else []
    return stretches


def _signal_values(drive: Drive, name: str) -> tuple[Array, Array]:
    """(values, fresh) of a field; both axes of a position as one complex number."""
    if name == "ins.x_m" and "ins.y_m" in drive.fields:
        fresh = drive.fresh["ins.x_m"] | drive.fresh["ins.y_m"]
        return drive.fields["ins.x_m"] + 1j * drive.fields["ins.y_m"], fresh
    return drive.fields[name], drive.fresh[name]


def _driving_values(drive: Drive, names: tuple[str, ...]) -> tuple[str, Array | None]:
    """(name, values) of the first driving quantity that the drive has."""
    if names[0] in COMPUTED:
        return names[0], _compute_driving_values(drive, names[0])
    name = first_field_name(drive, names)
    return name or "", None if name is None else drive.fields[name]


def _compute_driving_values(drive: Drive, quantity: str) -> Array | None:
    """One of COMPUTED, shape (n_rows,); None where the drive lacks a field that it needs."""
    speed, steer = first_field_values(drive, CHASSIS_FIRST_SPEEDS), first_field_values(drive, STEER_FIELDS)
    yaw_rate = first_field_values(drive, CHASSIS_FIRST_YAW_RATES)
    if speed is None:
        return None
    if quantity == SPEED_RATE:
        name = first_field_name(drive, CHASSIS_FIRST_SPEEDS) or ""
        window = 2 * round(CRITERIA.rate_window_s / drive.dt_s / 2.0) + 1
        return estimate_rate(speed, drive.fresh[name], window, drive.dt_s)
    if quantity == DISTANCE:
        return np.cumsum(np.where(moving_rows(drive), np.abs(speed), 0.0)) * drive.dt_s
    if quantity == STEERING_TIMES_SPEED:
        return None if steer is None else steer * speed
    if yaw_rate is None:
        return None
    if quantity == YAW_RATE_TIMES_SPEED:
        return yaw_rate * speed
    # at standstill a gyro drifts, but a heading is constant
    return np.cumsum(np.where(moving_rows(drive), np.nan_to_num(yaw_rate), 0.0)) * drive.dt_s


def _find_constant(values: Array, fresh: Array, min_rows: int) -> list[tuple[int, int]]:
    """Rows [begin, end) of stretches in which fresh frames repeat one value, longest first."""
    rows = np.flatnonzero(fresh)
    if not len(rows):
        return []
    changes = np.flatnonzero(np.diff(values[rows]) != 0.0) + 1
    firsts = np.concatenate([[0], changes])
    lasts = np.concatenate([changes, [len(rows)]]) - 1
    is_long = (rows[lasts] - rows[firsts] >= min_rows) & (lasts - firsts >= CRITERIA.min_frames)
    stretches = [
        (int(rows[first]), int(rows[last]) + 1) for first, last in zip(firsts[is_long], lasts[is_long], strict=True)
    ]
    return sorted(stretches, key=lambda stretch: stretch[0] - stretch[1])
