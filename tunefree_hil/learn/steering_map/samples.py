"""Samples of nearly steady cornering from drives: wheel angle, speed, yaw rate, and slip angle of the rear axle.

All signals are means over the same window, which keeps a linear relation between them. What a slow change of the turn
adds (yaw inertia, tyre relaxation, late reports) is in first order proportional to the yaw acceleration, which is a
sample's own column: the fit (fit.py) takes it out, so that gentle transients count and not only held turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.drives.drive import (
    INS_FIRST_SPEEDS,
    INS_FIRST_YAW_RATES,
    Array,
    Drive,
    first_valid_field,
    reversing_rows,
)
from tunefree_hil.learn.drives.runs import true_throughout
from tunefree_hil.learn.drives.smoothing import interpolate_first_field, shift_earlier
from tunefree_hil.learn.drives.validity import POSE_FIELDS, interpolate_pose, valid_rows

WHEEL_FIELDS = ("report.steer_rad",)


class SteadySampleCriteria(NamedTuple):
    """Which rows of a drive count as nearly steady cornering; every value is an engineering choice."""

    window_s: float = 0.4  # s, of the means: several periods of the slowest report, a quarter of a steering ramp
    spacing_s: float = 0.1  # s, between samples: closer ones share most of their window
    min_speed_mps: float = 2.0  # m/s, below it the speed sensor's noise is a few percent of the curvature
    max_wheel_rate_radps: float = 0.5  # rad/s of steering wheel: 10 ms of unknown delay are then 0.005 rad
    max_yaw_accel_radps2: float = 0.15  # rad/s2: an evasion has five times as much
    max_accel_mps2: float = 1.5  # m/s2: more braking or throttle moves load and side force between the axles
    block_s: float = 5.0  # s, of one block: longer than the correlation of road, wind and driver
    min_displacement_m: float = 0.8  # m, over a window: a centimetre of position noise is then 0.012 rad of course


CRITERIA = SteadySampleCriteria()


class SteadySamples(NamedTuple):
    """Means over windows, each of shape (n_samples,).

    wheel_rad: steering wheel, output of the actuator. yaw_accel_radps2: rate of the yaw rate. rear_slip_rad: course
    minus heading at the rear axle, NaN without a position. block: number of the stretch of driving.
    """

    wheel_rad: Array
    speed_mps: Array
    yaw_rate_radps: Array
    yaw_accel_radps2: Array
    rear_slip_rad: Array
    block: Array

    def select(self, rows: Array) -> SteadySamples:
        """These samples."""
        return SteadySamples(*(column[rows] for column in self))


def collect_steady_samples(drives: Sequence[Drive], vehicle: VehicleSpec) -> SteadySamples:
    """The samples of all drives. There may be none.

    Raises:
        InputError: A drive has no steering-wheel angle, no speed or no yaw rate.
    """
    parts = []
    first_block = 0
    for drive in drives:
        samples = sample_drive(drive, vehicle)
        parts.append(samples._replace(block=samples.block + first_block))
        first_block += int(drive.n_rows * drive.dt_s / CRITERIA.block_s) + 1
    if not parts:
        raise InputError("no drive is given", code="no_log", key="LOG", hint="name one log or more")
    return SteadySamples(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def sample_drive(drive: Drive, vehicle: VehicleSpec) -> SteadySamples:
    """The samples of one drive. Raises InputError as `collect_steady_samples`."""
    everywhere = np.ones(drive.n_rows, dtype=bool)  # without `fresh` a drive has every field in each row
    drive = drive._replace(fresh={name: drive.fresh.get(name, everywhere) for name in drive.fields})
    rows = round(CRITERIA.window_s / drive.dt_s)
    half = max(rows // 2, 1)
    delay_rows = round(vehicle.ins_frame.latency_s / drive.dt_s)
    wheel = _require_signal(drive, WHEEL_FIELDS, delay_rows, "no_steer", "angle of the steering wheel")
    speed = _require_signal(drive, INS_FIRST_SPEEDS, delay_rows, "no_speed", "speed")
    yaw_rate = _require_signal(drive, INS_FIRST_YAW_RATES, delay_rows, "no_yaw_rate", "yaw rate")
    usable = np.isfinite(wheel) & np.isfinite(speed) & np.isfinite(yaw_rate) & ~reversing_rows(drive)
    usable &= speed > CRITERIA.min_speed_mps
    names = (first_valid_field(drive, names) for names in (WHEEL_FIELDS, INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES))
    usable &= valid_rows(drive, *(name for name in names if name), ins_delay_rows=delay_rows)
    steady = true_throughout(usable, half, half)
    means = [_window_mean(values, half) for values in (wheel, speed, yaw_rate)]
    wheel_rate, accel, yaw_accel = (_window_rate(values, half, drive.dt_s) for values in (wheel, speed, yaw_rate))
    steady &= np.abs(wheel_rate) <= CRITERIA.max_wheel_rate_radps
    steady &= np.abs(accel) <= CRITERIA.max_accel_mps2
    steady &= np.abs(yaw_accel) <= CRITERIA.max_yaw_accel_radps2
    chosen = np.flatnonzero(steady)[:: max(1, round(CRITERIA.spacing_s / drive.dt_s))]
    slip = _rear_slip(drive, half, delay_rows)
    block = (np.arange(drive.n_rows) * drive.dt_s / CRITERIA.block_s).astype(np.int64)
    return SteadySamples(*(column[chosen] for column in (*means, yaw_accel, slip, block)))


def _require_signal(drive: Drive, names: Sequence[str], delay_rows: int, code: str, label: str) -> Array:
    """The first of these fields on every tick; NaN where it is not known."""
    values = interpolate_first_field(drive, names, delay_rows)
    if values is None:
        raise InputError(
            f"the log holds no {label}",
            code=code,
            file=drive.name,
            key=names[0],
            hint="the steering map needs the steering wheel's angle, a speed and a yaw rate",
        )
    return values


def _rear_slip(drive: Drive, half: int, delay_rows: int) -> Array:
    """Course over a window minus the mean heading in it, shape (n_rows,): 0 on any circle without slip."""
    unknown = np.full(drive.n_rows, np.nan)
    if any(not np.isfinite(drive.fields.get(name, unknown)).any() for name in POSE_FIELDS):
        return unknown
    heading, x, y = (shift_earlier(values, delay_rows) for values in interpolate_pose(drive))
    dx, dy = _window_change(x, half), _window_change(y, half)
    course = np.arctan2(dy, dx)
    slip = course - _window_mean(heading, half)
    slip -= 2.0 * np.pi * np.round(slip / (2.0 * np.pi))
    valid = true_throughout(valid_rows(drive, *POSE_FIELDS, ins_delay_rows=delay_rows), half, half)
    return np.where(valid & (np.hypot(dx, dy) >= CRITERIA.min_displacement_m), slip, np.nan)


def _window_mean(values: Array, half: int) -> Array:
    """Mean over 2 * half intervals (trapezium rule), the same shape; NaN where the window does not fit."""
    middle = 0.5 * (values[1:] + values[:-1])
    sums = np.concatenate([[0.0], np.cumsum(np.nan_to_num(middle))])
    return _fit_window((sums[2 * half :] - sums[: -2 * half]) / (2 * half), len(values), half)


def _window_change(values: Array, half: int) -> Array:
    """Change over 2 * half intervals, the same shape; NaN where the window does not fit."""
    return _fit_window(values[2 * half :] - values[: -2 * half], len(values), half)


def _window_rate(values: Array, half: int, dt_s: float) -> Array:
    return _window_change(values, half) / (2 * half * dt_s)


def _fit_window(inner: Array, rows: int, half: int) -> Array:
    """The values of all windows that fit into `rows` rows, at the rows of their middles."""
    whole = np.full(rows, np.nan)
    if rows > 2 * half:
        whole[half : rows - half] = inner
    return whole
