"""Interpolation, smoothing, rates, noise and quantisation of a drive's signals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from tunefree_hil.config.schema import NominalSpec
from tunefree_hil.learn.drives.drive import (
    CHASSIS_FIRST_SPEEDS,
    INS_FIRST_SPEEDS,
    Array,
    Drive,
    DrivePart,
    first_valid_field,
)
from tunefree_hil.plant.measurement.sensors import NOISY

QUANTILE_95 = 1.6449  # of the standard normal distribution, one-sided


class NoiseCriteria(NamedTuple):
    """Settings of the noise estimates; every value is an engineering choice."""

    window_values: int = 9  # fresh values under the local polynomial that the noise is measured against
    polynomial_degree: int = 3  # of that local polynomial
    min_values: int = 200  # fresh values that a signal's noise or range is estimated from
    min_window_mean_values: int = 10  # differences that the noise of a window mean is estimated from
    range_smoothing_values: int = 21  # under the filter that takes noise off before the driven range is read
    range_tail_share: float = 0.001  # of the values, left out of the driven range at either end
    min_pressed_frac: float = 0.01  # a brake below this counts as released


NOISE = NoiseCriteria()


def interpolate_fresh(values: Array, fresh: Array) -> Array:
    """The signal on every tick: linear between fresh values, constant beyond them; all NaN where none is finite."""
    ticks = np.flatnonzero(fresh & np.isfinite(values))
    if not len(ticks):
        return np.full(len(values), np.nan)
    return np.interp(np.arange(len(values)), ticks, values[ticks])


def interpolate_from_first(drive: Drive, name: str) -> Array:
    """A field on every tick, NaN before its first value; a heading is unwrapped."""
    values, fresh = drive.fields[name], drive.fresh[name] & np.isfinite(drive.fields[name])
    if name.endswith("heading_rad"):
        values = values.copy()
        values[fresh] = np.unwrap(values[fresh])
    interpolated = interpolate_fresh(values, fresh)
    interpolated[: int(np.argmax(fresh))] = np.nan
    return interpolated


def interpolate_first_field(drive: Drive, names: Sequence[str], ins_delay_rows: int) -> Array | None:
    """The first of these fields that has values, on every tick; that of the INS moved back by its delay."""
    name = first_valid_field(drive, names)
    if name is None:
        return None
    values = interpolate_fresh(drive.fields[name], drive.fresh[name])
    return shift_earlier(values, ins_delay_rows) if name.startswith("ins.") else values


def shift_earlier(values: Array, rows: int) -> Array:
    """The same signal `rows` rows earlier; NaN at its end."""
    return np.concatenate([values[rows:], np.full(rows, np.nan)]) if rows else values


def smooth_signal(values: Array, window: int) -> Array:
    """A Savitzky-Golay filter of degree 2 over `window` rows; a shorter signal is returned unchanged."""
    return np.asarray(savgol_filter(values, window, 2)) if len(values) >= window else values.copy()


def estimate_rate(values: Array, fresh: Array, window: int, dt_s: float) -> Array:
    """The rate of a signal by a Savitzky-Golay filter of degree 2 over `window` ticks; NaN before the first value."""
    interpolated = interpolate_fresh(values, fresh)
    if len(interpolated) < window or not np.isfinite(interpolated).all():
        return np.full(len(values), np.nan)
    rate = np.asarray(savgol_filter(interpolated, window, 2, deriv=1, delta=dt_s))
    rate[: int(np.argmax(np.isfinite(values)))] = np.nan
    return rate


def select_speed(drive: Drive) -> tuple[Array, Array] | None:
    """(speed, fresh) by the INS, else by the chassis; None where neither measures it."""
    name = first_valid_field(drive, INS_FIRST_SPEEDS)
    return None if name is None else (drive.fields[name], drive.fresh[name])


def estimate_mean_noise(residuals: Array, fresh: Array, rows: int) -> float:
    """Standard deviation of a mean over `rows` ticks of an accelerometer's residuals against the rate of speed.

    It follows from the differences between neighbouring fresh values, so that vibration seen at a low rate counts as
    noise and not as a slope. inf where there are too few values.
    """
    fresh_residuals = residuals[fresh & np.isfinite(residuals)]
    if len(fresh_residuals) < NOISE.min_window_mean_values:
        return float("inf")
    std = float(np.sqrt(0.5 * np.mean(np.diff(fresh_residuals) ** 2)))
    return std / float(np.sqrt(max(rows * np.mean(fresh), 1.0)))


def yaw_rate_from_wheels(drive: Drive, nominal: NominalSpec) -> tuple[Array, Array] | None:
    """(yaw rate, fresh) from the difference of the rear wheel speeds, for a car without a gyro.

    None without wheel speeds, or where the vehicle folder does not give the track and the rolling radius. With
    unequal wheel radii a straight line looks like a curve, and a fit finds an offset of the steering wheel.
    """
    left, right = drive.get("report.wheel_rl_radps"), drive.get("report.wheel_rr_radps")
    if left is None or right is None or not (nominal.track_m and nominal.wheel_radius_m):
        return None
    fresh = drive.fresh["report.wheel_rl_radps"] & drive.fresh["report.wheel_rr_radps"]
    return (right - left) * nominal.wheel_radius_m / nominal.track_m, fresh


def estimate_quantum(values: Array) -> float:
    """The quantisation step of a signal: the smallest difference between two of its values, 0 without any."""
    levels = np.unique(values[np.isfinite(values)])
    if len(levels) < 2:
        return 0.0
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * max(1.0, float(np.abs(levels).max()))]  # less is rounding of the float
    return float(steps.min()) if len(steps) else 0.0


def estimate_noise(values: Array, quantum: float = 0.0) -> float:
    """Standard deviation of the white noise on fresh values, without the share of their quantisation.

    The noise is the residual of a local cubic. Only its middle 90 % count, so that the corners of steps do not.
    """
    values = values[np.isfinite(values)]
    if len(values) < NOISE.window_values:
        return 0.0
    centre_weight = savgol_coeffs(NOISE.window_values, NOISE.polynomial_degree)[NOISE.window_values // 2]
    residuals = values - savgol_filter(values, NOISE.window_values, NOISE.polynomial_degree)
    low, high = np.quantile(residuals, [0.05, 0.95])
    spread = (high - low) / (2.0 * QUANTILE_95)  # unlike a median deviation not 0 after coarse rounding
    variance = spread * spread / (1.0 - centre_weight) - quantum * quantum / 12.0
    return float(np.sqrt(max(variance, 0.0)))


def estimate_noise_table(parts: Iterable[DrivePart]) -> dict[str, float]:
    """Noise by record field, for [noise] of model.toml; fields with too few fresh values are left out."""
    parts = list(parts)
    noise_by_field: dict[str, float] = {}
    for name in NOISY:
        pieces = [select_fresh_values(part, name) for part in parts]
        pieces = [piece for piece in pieces if len(piece) >= NOISE.min_values]
        if not pieces:
            continue
        pieces = [np.unwrap(piece) if name.endswith("heading_rad") else piece for piece in pieces]
        quantum = min((step for step in map(estimate_quantum, pieces) if step > 0.0), default=0.0)
        sizes = np.array([len(piece) for piece in pieces], dtype=float)
        noises = np.array([estimate_noise(piece, quantum) for piece in pieces])
        noise_by_field[name] = float(np.sqrt(np.average(noises * noises, weights=sizes)))
    return noise_by_field


def select_fresh_values(part: DrivePart, name: str) -> Array:
    """The fresh, finite values of a field in a part, shape (n_values,)."""
    values = part.drive.get(name)
    if values is None:
        return np.zeros(0)
    rows = slice(part.begin, part.end)
    fresh_values = values[rows][part.drive.fresh[name][rows]]
    return fresh_values[np.isfinite(fresh_values)]


def estimate_valid_region(parts: Iterable[DrivePart], rest_frac: float) -> dict[str, tuple[float, float]]:
    """The driven range of each quantity, for [valid] of model.toml.

    Returns:
        (low, high) by quantity. 'pedals' is minus the brake where it is pressed, else the throttle, as in
        calibration.npz.
    """
    parts = list(parts)
    sources_by_quantity = {
        "speed_mps": CHASSIS_FIRST_SPEEDS,
        "accel_mps2": ("report.accel_mps2", "ins.accel_mps2"),
        "lateral_accel_mps2": ("report.lateral_accel_mps2",),
        "steer_rad": ("report.steer_rad",),
    }
    ranges: dict[str, tuple[float, float]] = {}
    window = NOISE.range_smoothing_values
    for quantity, sources in sources_by_quantity.items():
        for source in sources:
            pieces = [smooth_signal(select_fresh_values(part, source), window) for part in parts]
            values = np.concatenate(pieces or [np.zeros(0)])
            if len(values) >= NOISE.min_values:
                ranges[quantity] = _driven_range(values)
                break
    pedals = np.concatenate([_pedal_values(part, rest_frac) for part in parts] or [np.zeros(0)])
    if len(pedals) >= NOISE.min_values:
        ranges["pedals"] = _driven_range(pedals)
    return {quantity: range_ends for quantity, range_ends in ranges.items() if range_ends[0] < range_ends[1]}


def _pedal_values(part: DrivePart, rest_frac: float) -> Array:
    rows = slice(part.begin, part.end)
    throttle, brake = part.drive.get("report.throttle_frac"), part.drive.get("report.brake_frac")
    if throttle is None or brake is None:
        return np.zeros(0)
    is_braking = brake[rows] - rest_frac > np.maximum(throttle[rows] - rest_frac, NOISE.min_pressed_frac)
    pedals = np.where(is_braking, -brake[rows], throttle[rows])
    return pedals[np.isfinite(pedals)]


def _driven_range(values: Array) -> tuple[float, float]:
    low, high = np.quantile(values, [NOISE.range_tail_share, 1.0 - NOISE.range_tail_share])
    return float(low), float(high)
