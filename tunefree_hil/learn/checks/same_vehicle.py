"""Whether several drives are of one vehicle: what does not depend on how it was driven is compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from tunefree_hil.learn.checks.problem import Problem, Severity
from tunefree_hil.learn.drives.drive import (
    CHASSIS_FIRST_SPEEDS,
    CHASSIS_FIRST_YAW_RATES,
    TURNS,
    Drive,
    backwards,
    first_of,
    moving,
    name_of,
)
from tunefree_hil.learn.drives.validity import told

Array = np.ndarray
Band = tuple[int, int, int]  # of speed, of steering, its side

WINDOW_S = 1.0
LEAST_TURN_RAD = 0.05  # in a window, that it counts
LEAST_STEER = 0.1  # of the most that was steered: less is as much trim as steering
FEWEST_WINDOWS = 3  # in a band
OF_MEDIAN, SURE = 1.25, 2.0  # a middle one is so much less sure than a mean; deviations that are taken off
BAND = 1.6  # a band reaches from a value to this many times it
# From which ratio on it is told, and refused.
STEERING_APART, WHEELS_APART = (1.3, 1.7), (1.05, 1.1)
FEWEST_IDS, LEAST_SHARED = 5, 0.3  # foreign ids of a log, and how many of all of two logs' are in both


def check_same_vehicle(drives: Sequence[Drive]) -> Iterator[Problem]:
    """Every drive against the first that can be compared with it: steering, wheels, what else is on the bus."""
    yield from _twice(drives)
    yield from _foreign(drives)
    steers = [np.abs(steer) for drive in drives if (steer := first_of(drive, TURNS)) is not None]
    most_rad = max((float(np.nanmax(steer, initial=0.0)) for steer in steers), default=0.0)
    steering = [_steering(drive, LEAST_STEER * most_rad) for drive in drives]
    field = next((name for drive in drives if (name := name_of(drive, TURNS))), TURNS[0])
    turns = _apart(drives, lambda i, j: _turning(steering[i], steering[j]), STEERING_APART)
    yield from (_of_two(*pair, "turns", "steering angle", field) for pair in turns)
    wheels = [_wheels(drive) for drive in drives]
    rolls = _apart(drives, lambda i, j: _ratio(wheels[i], wheels[j]), WHEELS_APART)
    yield from (_of_two(*pair, "drives", "turn of its wheels", "report.wheel_rl_radps") for pair in rolls)


def _twice(drives: Sequence[Drive]) -> Iterator[Problem]:
    """One file named twice would be fitted on and prove what was fitted; a copy is only told, as splits know it."""
    first: dict[str, Drive] = {}
    for drive in drives:
        before = first.setdefault(drive.log_hash, drive) if drive.log_hash else drive
        if before is drive:
            continue
        if drive.reading is not None and Path(drive.path).resolve() == Path(before.path).resolve():
            words = f"{drive.path} is named twice, where each log is expected once; leave one out"
            yield Problem("refuse", "twice", drive.name, "", words)
        elif before.name != drive.name:
            words = f"{drive.path} is the same recording as {before.path}, where each is expected once; leave one out"
            yield Problem("warn", "twice", drive.name, "", words)


def _foreign(drives: Sequence[Drive]) -> Iterator[Problem]:
    """A vehicle's bus carries the same ids on every drive, those too that the folder does not know."""
    ids = [set(drive.reading.foreign) if drive.reading is not None else set() for drive in drives]
    many = [i for i, some in enumerate(ids) if len(some) >= FEWEST_IDS]
    for i in many[1:]:
        both, any_of = ids[many[0]] & ids[i], ids[many[0]] | ids[i]
        if len(both) < LEAST_SHARED * len(any_of):
            words = f"{drives[i].path} shares {len(both)} of {len(any_of)} ids that the folder does not know with "
            words += f"{drives[many[0]].path}, where nearly all are expected: two vehicles? give the logs of one"
            yield Problem("refuse", "two_vehicles", drives[i].name, "", words)


def _apart(
    drives: Sequence[Drive], ratio_of: Callable[[int, int], float | None], limits: tuple[float, float]
) -> Iterator[tuple[Severity, float, Drive, Drive]]:
    """(severity, ratio, drive, the one that it is compared with: the first that can be) of those that are too unlike.
    ratio_of: of two drives by number, None where they cannot be compared.
    """
    for i, drive in enumerate(drives):
        ratios = ((before, ratio_of(i, before)) for before in range(i))
        found = next(((before, ratio) for before, ratio in ratios if ratio is not None), None)
        if found and (apart := max(found[1], 1.0 / found[1])) > limits[0]:
            yield "refuse" if apart > limits[1] else "warn", found[1], drive, drives[found[0]]


def _of_two(severity: Severity, ratio: float, drive: Drive, other: Drive, does: str, what: str, field: str) -> Problem:
    words = f"{drive.path} {does} {ratio:.2f} times as much for the same {what} as {other.path} ({field}), where 1 is "
    words += "expected: logs of two vehicles; give those of one"
    return Problem(severity, "two_vehicles", drive.name, field, words)


def _ratio(mine: float | None, other: float | None) -> float | None:
    return None if mine is None or other is None else mine / other


def _steering(drive: Drive, least_rad: float) -> dict[Band, Array]:
    """Windows that turn enough, by band of speed and of steering to each side, each [n, 3]: logarithm of the yaw rate
    by steering times speed, speed squared, steering angle.

    A servo is not linear, tyres are not, and a wheel is never quite straight: only what was steered alike is compared.
    """
    speed, steer, yaw = (first_of(drive, names) for names in (CHASSIS_FIRST_SPEEDS, TURNS, CHASSIS_FIRST_YAW_RATES))
    if speed is None or steer is None or yaw is None:
        return {}
    whole = moving(drive) & ~backwards(drive) & np.isfinite(steer) & np.isfinite(yaw)
    used = (name_of(drive, names) for names in (CHASSIS_FIRST_SPEEDS, TURNS, CHASSIS_FIRST_YAW_RATES))
    whole &= told(drive, *(name for name in used if name))
    v, wheel, turned = (_windows(np.where(whole, one, np.nan), drive.dt_s) for one in (np.abs(speed), steer, yaw))
    good = np.isfinite(v) & (np.abs(turned) * WINDOW_S > LEAST_TURN_RAD) & (np.abs(wheel) > least_rad)
    good &= turned * wheel > 0.0  # a turned sign is another fault
    v, wheel, turned = v[good], wheel[good], turned[good]
    rows = np.column_stack([np.log(turned / (wheel * v)), v * v, np.abs(wheel)])
    by_band: dict[Band, list[Array]] = {}
    keys = zip(_bands(v), _bands(np.abs(wheel)), np.sign(wheel).astype(int).tolist(), strict=True)
    for key, row in zip(keys, rows, strict=True):
        by_band.setdefault(key, []).append(row)
    return {key: np.array(some) for key, some in by_band.items() if len(some) >= FEWEST_WINDOWS}


def _turning(mine: Mapping[Band, Array], other: Mapping[Band, Array]) -> float | None:
    """By how much more one drive turns at the least, the middle one of the bands that both have; None without any.
    Within a band a faster car turns less for the same angle, and more steering is worth less: what that comes to is
    told by the windows of each drive and band among themselves, and taken off before two drives are compared. What is
    left from window to window says how sure the middle one is.
    """
    common = sorted(mine.keys() & other.keys())
    if not common:
        return None
    centred = np.concatenate([rows - rows.mean(axis=0) for some in (mine, other) for rows in some.values()])
    slopes = np.linalg.lstsq(centred[:, 1:], centred[:, 0], rcond=None)[0]
    apart = [np.median(_even(mine[band], slopes)) - np.median(_even(other[band], slopes)) for band in common]
    doubts = [np.concatenate([_from_middle(_even(some[band], slopes)) for band in common]) for some in (mine, other)]
    doubt = OF_MEDIAN * float(np.hypot(*(one.std() / np.sqrt(len(one)) for one in doubts)))
    middle = float(np.median(apart))
    return float(np.exp(np.sign(middle) * max(abs(middle) - SURE * doubt, 0.0)))


def _even(rows: Array, slopes: Array) -> Array:
    """Logarithms [n] of how much a drive turned, without what speed and steering do to that."""
    return rows[:, 0] - rows[:, 1:] @ slopes


def _from_middle(values: Array) -> Array:
    return values - np.median(values)


def _bands(values: Array) -> list[int]:
    return np.floor(np.log(values) / np.log(BAND)).astype(int).tolist()


def _wheels(drive: Drive) -> float | None:
    """Speed by the rear wheels' turn, while it moves."""
    names = [f"report.{one}" for one in ("speed_mps", "wheel_rl_radps", "wheel_rr_radps")]
    speed, left, right = (drive.get(name) for name in names)
    if speed is None or left is None or right is None:
        return None
    turn = 0.5 * (left + right)
    rows = moving(drive) & ~backwards(drive) & np.isfinite(turn) & (np.abs(turn) > 1.0) & told(drive, *names)
    if rows.sum() * drive.dt_s < FEWEST_WINDOWS * WINDOW_S:
        return None
    gain = float(np.abs(speed[rows]).sum() / np.abs(turn[rows]).sum())
    return gain if gain > 0.0 else None


def _windows(values: Array, dt_s: float) -> Array:
    """Means over windows of WINDOW_S, one each half of it; NaN where a row of it is."""
    half = max(1, round(WINDOW_S / dt_s / 2.0))
    count = len(values) // half
    halves = values[: count * half].reshape(count, half).mean(axis=1)
    return 0.5 * (halves[1:] + halves[:-1])
