"""Whether several drives are of one vehicle: what does not depend on how it was driven is compared."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from tunefree_hil.learn.drives import Drive
from tunefree_hil.learn.fields import CHASSIS_FIRST_SPEEDS, CHASSIS_FIRST_YAW_RATES
from tunefree_hil.learn.problems import Problem
from tunefree_hil.learn.series import TURNS, backwards, first_of, moving, name_of

Array = np.ndarray
Band = tuple[int, int, int]  # of speed, of steering, its side

WINDOW_S = 1.0
LEAST_TURN_RAD = 0.05  # in a window, that it counts
LEAST_STEER = 0.1  # of the most that was steered: less is as much trim as steering
FEWEST_WINDOWS = 3  # in a band
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
    yield from _apart(drives, steering, STEERING_APART, "turns", "steering angle", field)
    wheels: list[dict[Band, float]] = [{(0, 0, 0): gain} if (gain := _wheels(drive)) else {} for drive in drives]
    yield from _apart(drives, wheels, WHEELS_APART, "drives", "turn of its wheels", "report.wheel_rl_radps")


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
    drives: Sequence[Drive],
    gains: Sequence[dict[Band, float]],
    limits: tuple[float, float],
    does: str,
    what: str,
    field: str,
) -> Iterator[Problem]:
    """gains: of each drive by band. The first with a band in common is who it is compared with."""
    for i, mine in enumerate(gains):
        for before in range(i):
            common = mine.keys() & gains[before].keys()
            if not common:
                continue
            ratio = float(np.median([mine[band] / gains[before][band] for band in common]))
            apart = max(ratio, 1.0 / ratio)
            if apart > limits[0]:
                severity = "refuse" if apart > limits[1] else "warn"
                words = f"{drives[i].path} {does} {ratio:.2f} times as much for the same {what} as "
                words += (
                    f"{drives[before].path} ({field}), where 1 is expected: logs of two vehicles; give those of one"
                )
                yield Problem(severity, "two_vehicles", drives[i].name, field, words)
            break


def _steering(drive: Drive, least_rad: float) -> dict[Band, float]:
    """Yaw rate by steering times speed, of windows that turn enough, by band of speed and of steering to each side.

    A servo is not linear, tyres are not, and a wheel is never quite straight: only what was steered alike is compared.
    """
    speed, steer, yaw = (first_of(drive, names) for names in (CHASSIS_FIRST_SPEEDS, TURNS, CHASSIS_FIRST_YAW_RATES))
    if speed is None or steer is None or yaw is None:
        return {}
    whole = moving(drive) & ~backwards(drive) & np.isfinite(steer) & np.isfinite(yaw)
    v, wheel, turned = (_windows(np.where(whole, one, np.nan), drive.dt_s) for one in (np.abs(speed), steer, yaw))
    good = np.isfinite(v) & (np.abs(turned) * WINDOW_S > LEAST_TURN_RAD) & (np.abs(wheel) > least_rad)
    v, wheel, turned = v[good], wheel[good], turned[good]
    gains = turned / (wheel * v)
    keys = zip(_bands(v), _bands(np.abs(wheel)), np.sign(wheel).astype(int).tolist(), strict=True)
    by_band: dict[Band, list[float]] = {}
    for key, gain in zip(keys, gains.tolist(), strict=True):
        by_band.setdefault(key, []).append(gain)
    found = {key: float(np.median(some)) for key, some in by_band.items() if len(some) >= FEWEST_WINDOWS}
    return {key: gain for key, gain in found.items() if gain > 0.0}  # a turned sign is another fault


def _bands(values: Array) -> list[int]:
    return np.floor(np.log(values) / np.log(BAND)).astype(int).tolist()


def _wheels(drive: Drive) -> float | None:
    """Speed by the rear wheels' turn, while it moves."""
    speed, left, right = (drive.get(f"report.{one}") for one in ("speed_mps", "wheel_rl_radps", "wheel_rr_radps"))
    if speed is None or left is None or right is None:
        return None
    turn = 0.5 * (left + right)
    rows = moving(drive) & ~backwards(drive) & np.isfinite(turn) & (np.abs(turn) > 1.0)
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
