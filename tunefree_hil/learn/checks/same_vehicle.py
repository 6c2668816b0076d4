"""Whether several drives are of one vehicle, by properties that do not depend on the driving."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

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
    reversing_rows,
)
from tunefree_hil.learn.drives.validity import valid_rows

Band = tuple[int, int, int]  # of the speed, of the steering angle, and the side


class RatioLimits(NamedTuple):
    """Ratios between two drives above which they are probably of two vehicles."""

    warn: float
    refuse: float


class SameVehicleCriteria(NamedTuple):
    """Settings of the comparison; every value is an engineering choice."""

    window_s: float = 1.0  # length of a window whose turning and steering are compared
    min_turned_rad: float = 0.05  # change of heading in a window that is compared
    min_steer_share: float = 0.1  # of the largest steering angle; smaller angles are mostly the offset of the wheel
    min_windows: int = 3  # in a band of speed and angle that is compared
    band_ratio: float = 1.6  # of the upper end of a band to its lower end
    median_std_ratio: float = 1.25  # standard error of a median, in multiples of that of a mean (normal distribution)
    doubt_sigmas: float = 2.0  # standard errors that are subtracted from a difference
    steering: RatioLimits = RatioLimits(1.3, 1.7)  # of the turning per steering angle
    wheels: RatioLimits = RatioLimits(1.05, 1.1)  # of the speed per wheel speed
    min_wheel_radps: float = 1.0  # wheel speed from which on a wheel turns
    min_unknown_ids: int = 5  # in a log, for a comparison of the ids
    min_shared_share: float = 0.3  # of the unknown ids of two logs, that are in both


SAME_VEHICLE = SameVehicleCriteria()


class _Quantity(NamedTuple):
    """A ratio that is constant for one vehicle: how much it `verb`s for the same `cause`."""

    verb: str
    cause: str
    field: str
    limits: RatioLimits


def check_same_vehicle(drives: Sequence[Drive]) -> Iterator[LogProblem]:
    """Compare every drive with the first comparable one: steering, wheels, and the unknown ids on the bus."""
    yield from _check_duplicates(drives)
    yield from _check_unknown_ids(drives)
    angles = [np.abs(steer) for drive in drives if (steer := first_field_values(drive, STEER_FIELDS)) is not None]
    max_rad = max((float(np.nanmax(angle, initial=0.0)) for angle in angles), default=0.0)
    responses = [_steering_response(drive, SAME_VEHICLE.min_steer_share * max_rad) for drive in drives]
    field = next((name for drive in drives if (name := first_field_name(drive, STEER_FIELDS))), STEER_FIELDS[0])
    quantity = _Quantity("turns", "steering angle", field, SAME_VEHICLE.steering)
    yield from _compare(drives, lambda i, j: _turn_ratio(responses[i], responses[j]), quantity)
    radii = [_wheel_radius(drive) for drive in drives]
    quantity = _Quantity("drives", "turn of its wheels", "report.wheel_rl_radps", SAME_VEHICLE.wheels)
    yield from _compare(drives, lambda i, j: _ratio(radii[i], radii[j]), quantity)


def _check_duplicates(drives: Sequence[Drive]) -> Iterator[LogProblem]:
    """Refuse a file that is named twice; warn of a copy, which a split keeps together with its original."""
    first_by_hash: dict[str, Drive] = {}
    for drive in drives:
        first = first_by_hash.setdefault(drive.log_hash, drive) if drive.log_hash else drive
        if first is drive:
            continue
        if drive.log_summary is not None and Path(drive.path).resolve() == Path(first.path).resolve():
            message = f"{drive.path} is named twice, but each log is expected once; name it once"
            yield LogProblem("refuse", "twice", drive.name, "", message)
        elif first.name != drive.name:
            message = f"{drive.path} is the same recording as {first.path}, but each is expected once; leave one out"
            yield LogProblem("warn", "twice", drive.name, "", message)


def _check_unknown_ids(drives: Sequence[Drive]) -> Iterator[LogProblem]:
    """The ids that the vehicle folder does not have are the same in every log of one vehicle."""
    ids = [set(drive.log_summary.unknown_ids) if drive.log_summary is not None else set() for drive in drives]
    comparable = [i for i, drive_ids in enumerate(ids) if len(drive_ids) >= SAME_VEHICLE.min_unknown_ids]
    for i in comparable[1:]:
        first = comparable[0]
        shared, union = ids[first] & ids[i], ids[first] | ids[i]
        if len(shared) < SAME_VEHICLE.min_shared_share * len(union):
            message = (
                f"{drives[i].path} shares only {len(shared)} of {len(union)} ids that the vehicle folder does not have "
                f"with {drives[first].path}, but nearly all are expected: these are probably two vehicles; use the "
                "logs of one"
            )
            yield LogProblem("refuse", "two_vehicles", drives[i].name, "", message)


def _compare(
    drives: Sequence[Drive], ratio: Callable[[int, int], float | None], quantity: _Quantity
) -> Iterator[LogProblem]:
    """Compare each drive with the first earlier one that has a ratio to it."""
    for i, drive in enumerate(drives):
        ratios = ((j, ratio(i, j)) for j in range(i))
        comparison = next(((j, value) for j, value in ratios if value is not None), None)
        if comparison is None:
            continue
        j, value = comparison
        factor = max(value, 1.0 / value)
        if factor > quantity.limits.warn:
            message = (
                f"{drive.path} {quantity.verb} {value:.2f} times as much for the same {quantity.cause} as "
                f"{drives[j].path} ({quantity.field}), but about 1 is expected: these are probably two vehicles; use "
                "the logs of one"
            )
            severity = "refuse" if factor > quantity.limits.refuse else "warn"
            yield LogProblem(severity, "two_vehicles", drive.name, quantity.field, message)


def _ratio(value: float | None, reference: float | None) -> float | None:
    return None if value is None or reference is None else value / reference


def _steering_response(drive: Drive, min_steer_rad: float) -> dict[Band, Array]:
    """Windows that turn enough, by band of speed and of steering to each side.

    Only similar steering is compared, because servos and tyres are not linear and a wheel is never exactly centred.

    Returns:
        Arrays of shape (n_windows, 3): log of yaw rate / (steering * speed), speed squared, steering angle.
    """
    sources = (CHASSIS_FIRST_SPEEDS, STEER_FIELDS, CHASSIS_FIRST_YAW_RATES)
    speed, steer, yaw_rate = (first_field_values(drive, names) for names in sources)
    if speed is None or steer is None or yaw_rate is None:
        return {}
    is_usable = moving_rows(drive) & ~reversing_rows(drive) & np.isfinite(steer) & np.isfinite(yaw_rate)
    names = (first_field_name(drive, names) for names in sources)
    is_usable &= valid_rows(drive, *(name for name in names if name))
    v, angle, rate = (
        _window_means(np.where(is_usable, signal, np.nan), drive.dt_s) for signal in (np.abs(speed), steer, yaw_rate)
    )
    is_turning = np.abs(rate) * SAME_VEHICLE.window_s > SAME_VEHICLE.min_turned_rad
    is_good = np.isfinite(v) & is_turning & (np.abs(angle) > min_steer_rad)
    is_good &= rate * angle > 0.0  # check_consistency reports a wrong sign
    v, angle, rate = v[is_good], angle[is_good], rate[is_good]
    rows = np.column_stack([np.log(rate / (angle * v)), v * v, np.abs(angle)])
    by_band: dict[Band, list[Array]] = {}
    bands = zip(_bands(v), _bands(np.abs(angle)), np.sign(angle).astype(int).tolist(), strict=True)
    for band, row in zip(bands, rows, strict=True):
        by_band.setdefault(band, []).append(row)
    return {band: np.array(row) for band, row in by_band.items() if len(row) >= SAME_VEHICLE.min_windows}


def _turn_ratio(response: Mapping[Band, Array], reference: Mapping[Band, Array]) -> float | None:
    """The least ratio of turning between two drives: the median over their common bands, towards 1 by its error.

    Within a band a faster car turns less for the same angle, and larger angles have less effect. These two slopes are
    fitted within each drive and band and removed before the drives are compared. The scatter that remains between
    windows gives the standard error of the median; doubt_sigmas of it are subtracted. None without a common band.
    """
    common = sorted(response.keys() & reference.keys())
    if not common:
        return None
    responses = (response, reference)
    centred = np.concatenate([rows - rows.mean(axis=0) for bands in responses for rows in bands.values()])
    slopes = np.linalg.lstsq(centred[:, 1:], centred[:, 0], rcond=None)[0]
    differences = [
        np.median(_without_slopes(response[band], slopes)) - np.median(_without_slopes(reference[band], slopes))
        for band in common
    ]
    scatter = [
        np.concatenate([_from_median(_without_slopes(bands[band], slopes)) for band in common]) for bands in responses
    ]
    standard_errors = (values.std() / np.sqrt(len(values)) for values in scatter)
    median_error = SAME_VEHICLE.median_std_ratio * float(np.hypot(*standard_errors))
    median = float(np.median(differences))
    return float(np.exp(np.sign(median) * max(abs(median) - SAME_VEHICLE.doubt_sigmas * median_error, 0.0)))


def _without_slopes(rows: Array, slopes: Array) -> Array:
    """The logarithms of a steering response without the effect of speed and steering angle, shape (n_windows,)."""
    return rows[:, 0] - rows[:, 1:] @ slopes


def _from_median(values: Array) -> Array:
    return values - np.median(values)


def _bands(values: Array) -> list[int]:
    return np.floor(np.log(values) / np.log(SAME_VEHICLE.band_ratio)).astype(int).tolist()


def _wheel_radius(drive: Drive) -> float | None:
    """Speed divided by the mean turn rate of the rear wheels, in m, while the vehicle moves."""
    names = [f"report.{name}" for name in ("speed_mps", "wheel_rl_radps", "wheel_rr_radps")]
    speed, left, right = (drive.get(name) for name in names)
    if speed is None or left is None or right is None:
        return None
    turn_rate = 0.5 * (left + right)
    is_turning = np.isfinite(turn_rate) & (np.abs(turn_rate) > SAME_VEHICLE.min_wheel_radps)
    rows = moving_rows(drive) & ~reversing_rows(drive) & is_turning & valid_rows(drive, *names)
    if rows.sum() * drive.dt_s < SAME_VEHICLE.min_windows * SAME_VEHICLE.window_s:
        return None
    radius_m = float(np.abs(speed[rows]).sum() / np.abs(turn_rate[rows]).sum())
    return radius_m if radius_m > 0.0 else None


def _window_means(values: Array, dt_s: float) -> Array:
    """Means over windows that overlap by half; NaN where a row of the window is."""
    half = max(1, round(SAME_VEHICLE.window_s / dt_s / 2.0))
    count = len(values) // half
    halves = values[: count * half].reshape(count, half).mean(axis=1)
    return 0.5 * (halves[1:] + halves[:-1])
