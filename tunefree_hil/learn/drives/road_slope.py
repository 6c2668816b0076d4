"""The constant part of an accelerometer's signal that no road explains: an offset of the sensor, or a steady pull."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.data_sheet import com_to_rear_axle_m
from tunefree_hil.learn.drives.drive import INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES, Array, Drive
from tunefree_hil.learn.drives.smoothing import estimate_rate, interpolate_first_field

ACCEL_FIELDS = ("report.accel_mps2",)


class AccelOffsetCriteria(NamedTuple):
    """When a constant slope is no road; every value is an engineering choice."""

    mean_window_s: float = 2.0  # the slope is judged by means over this time
    rate_window_s: float = 0.5  # of the filter that gives the rate of speed
    min_speed_mps: float = 1.0  # below it pitch and stick-slip of the brakes disturb the accelerometer
    min_duration_s: float = 90.0  # of the means over mean_window_s together; with less no offset is estimated
    sectors: int = 8  # of the compass
    min_means_per_sector: int = 2  # for a drive in all directions
    max_mean_heading: float = 0.5  # length of the mean heading vector of a drive in all directions
    max_straight_heading: float = 0.9  # of a drive that turns at all; a straight road may climb all the way
    max_residual_share: float = 0.5  # of the offset, by which the slope of a drive in all directions may vary
    max_turning_residual_share: float = 0.15  # of a drive that turns, but not in all directions
    max_steep_residual_share: float = 0.05  # of a steep slope, which is more often a hill
    min_reported_g: float = 0.01  # a smaller offset is not reported
    min_steep_g: float = 0.05  # few sensors are mounted as wrongly
    max_offset_g: float = 0.2  # steeper than roads are


ACCEL_OFFSET = AccelOffsetCriteria()


def estimate_accel_offset(drive: Drive, vehicle: VehicleSpec) -> float:
    """The constant difference between a drive's accelerometer and its rate of speed in g; 0.0 where a road explains it.

    A drive in all directions passes each slope up and down, so a constant part is no hill. An area that is inclined as
    a whole is fitted too: its slope varies with the heading. A drive in one direction may climb all the way; its offset
    counts only where it hardly varies. Whether the sensor has the offset, or a force acts on the car, is decided from
    the motion (learn/physics/fit.py, road_share).
    """
    delay_rows = round(vehicle.ins_frame.latency_s / drive.dt_s)
    accel, speed, yaw_rate = (
        interpolate_first_field(drive, names, delay_rows)
        for names in (ACCEL_FIELDS, INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES)
    )
    if accel is None or speed is None or yaw_rate is None:
        return 0.0
    heading_rad = np.cumsum(np.nan_to_num(yaw_rate)) * drive.dt_s
    window = max(round(ACCEL_OFFSET.rate_window_s / drive.dt_s) | 1, 5)
    rate = estimate_rate(speed, np.isfinite(speed), window, drive.dt_s)
    # the speed is the rear axle's; the centre of mass lies b ahead of it and has b * yaw rate^2 less
    centripetal_mps2 = com_to_rear_axle_m(vehicle.nominal) * yaw_rate * yaw_rate
    slope = (accel - rate + centripetal_mps2) / G_MPS2
    is_valid = np.isfinite(slope) & (speed > ACCEL_OFFSET.min_speed_mps)
    rows = round(ACCEL_OFFSET.mean_window_s / drive.dt_s)
    return find_constant_slope(*_window_means(slope, heading_rad, is_valid, rows))


def describe_accel_offsets(drives: Iterable[Drive], vehicle: VehicleSpec) -> list[str]:
    """A message for each drive whose accelerometer has an offset that looks like a hill."""
    offsets = [(drive.name, estimate_accel_offset(drive, vehicle)) for drive in drives]
    return [
        f"{name}: the accelerometer reads {G_MPS2 * offset:+.2f} m/s2 more than the rate of speed in every direction "
        "of travel. No hill explains this: the sensor has an offset, or a steady force acts on the car"
        for name, offset in offsets
        if abs(offset) > ACCEL_OFFSET.min_reported_g
    ]


def find_constant_slope(slopes: Array, headings_rad: Array) -> float:
    """The part of the slopes that does not depend on the heading; 0.0 where the drive does not show one.

    Args:
        slopes, headings_rad: means over AccelOffsetCriteria.mean_window_s, shape (n_means,).
    """
    criteria = ACCEL_OFFSET
    if len(slopes) < criteria.min_duration_s / criteria.mean_window_s:
        return 0.0
    sectors = np.floor((headings_rad % (2.0 * np.pi)) / (2.0 * np.pi / criteria.sectors)).astype(int) % criteria.sectors
    mean_heading = abs(np.exp(1j * headings_rad).mean())
    regressors = np.column_stack([np.ones(len(slopes)), np.cos(headings_rad), np.sin(headings_rad)])
    coefficients, *_ = np.linalg.lstsq(regressors, slopes, rcond=None)
    offset, residual_rms = float(coefficients[0]), float(np.sqrt(np.mean((slopes - regressors @ coefficients) ** 2)))
    means_per_sector = np.bincount(sectors, minlength=criteria.sectors)
    max_share = 0.0
    if means_per_sector.min() >= criteria.min_means_per_sector and mean_heading < criteria.max_mean_heading:
        max_share = criteria.max_residual_share
    elif mean_heading < criteria.max_straight_heading:
        max_share = criteria.max_turning_residual_share
    if abs(offset) >= criteria.min_steep_g:
        max_share = min(max_share, criteria.max_steep_residual_share)
    return offset if residual_rms < max_share * abs(offset) and abs(offset) < criteria.max_offset_g else 0.0


def _window_means(slope: Array, heading_rad: Array, is_valid: Array, rows: int) -> tuple[Array, Array]:
    """Means of slope and heading over `rows` ticks, of the windows in which at least half of the rows are valid."""
    n = len(slope) // rows * rows
    valid = is_valid[:n].reshape(-1, rows)
    slopes = np.where(valid, slope[:n].reshape(-1, rows), 0.0).sum(axis=1) / np.maximum(valid.sum(axis=1), 1)
    has_enough = 2 * valid.sum(axis=1) >= rows
    return slopes[has_enough], heading_rad[:n].reshape(-1, rows).mean(axis=1)[has_enough]
