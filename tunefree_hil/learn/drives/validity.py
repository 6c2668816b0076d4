"""Where a drive says what is read of it: not behind a frame that was the last for long, nor before the first.

What a message said last holds on every tick (learn/drives/drive.py); in a gap of the recording, or once it has fallen silent,
that is no measurement.

Single values that no car can have come to: a frame that was written wrong, or read wrong, between two good ones.

One of them is nothing to a mean and everything to a slope: a speed of 0 in one frame of ten thousand is a brake that
nobody pressed. What sticks out of both of its neighbours by many times what the signal usually moves there is left out,
as if its frame had not come. Commands and their echoes are left alone: a controller can ask for anything. So is an
actuator's output that is told so seldom that a tap shows in one value. The first and the last value of a drive have one
neighbour only, and stay.

A pose that stands while the car drives: satellites are hidden, and the INS says again where it was.

Less than half of the driving of it is no fault (learn/checks/stuck_signals.py); it is no measurement either.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.ndimage import median_filter

from tunefree_hil.learn.actuators.samples import CHANNELS, ECHOES
from tunefree_hil.learn.drives.drive import (
    CHASSIS_FIRST_SPEEDS,
    INS_FIRST_SPEEDS,
    INS_FIRST_YAW_RATES,
    Drive,
    first_of,
    first_told,
)
from tunefree_hil.learn.drives.runs import every_of, runs, there_of
from tunefree_hil.learn.drives.smoothing import between_fresh, earlier, quantum_of

PAUSES = 3  # of a message, which is sent on demand then and not every so often
COVERS = 0.5  # of a drive: what says less, with pauses, is sent on demand
DRIVEN_BY = ("throttle", "brake", "steer")
POSE = ("ins.heading_rad", "ins.x_m", "ins.y_m")


def is_on_demand(there: Array) -> bool:
    """Whether a message pauses for most of a drive, again and again: what it said last holds then. there: bool [n]."""
    return int((np.diff(there.astype(int)) < 0).sum()) >= PAUSES and bool(there.mean() < COVERS)


def told(drive: Drive, *names: str, late: int = 0) -> Array:
    """bool [n]: rows in which every one of these fields is said. late: rows by which the INS speaks of the past."""
    rows = np.ones(drive.ticks, dtype=bool)
    for name in names:
        if name not in drive.fresh:
            continue  # a drive that was made row by row says everything in each
        there = there_of(drive.fresh[name] & np.isfinite(drive.fields[name]), drive.dt_s)
        if is_on_demand(there) and not name.startswith("ins."):
            continue
        rows &= (earlier(there.astype(float), late) > 0.5) if name.startswith("ins.") else there
    return rows


def motion_told(drive: Drive, late: int, placed: bool) -> Array:
    """bool [n]: where speed and yaw rate are said, and the pose where it was measured."""
    first = (first_told(drive, names) for names in (INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES))
    return told(drive, *(name for name in first if name is not None), *(POSE if placed else ()), late=late)


def between_poses(drive: Drive) -> list[Array]:
    """Heading (continuous), x and y on every tick, between their frames a straight line: held they would be late."""
    found = []
    for name in POSE:
        values, fresh = drive.fields[name].copy(), drive.fresh[name] & np.isfinite(drive.fields[name])
        if name == POSE[0]:
            values[fresh] = np.unwrap(values[fresh])
        even = between_fresh(values, fresh)
        even[: int(np.argmax(fresh))] = np.nan
        found.append(even)
    return found


def acted_told(drive: Drive, obeyed: Sequence[Array]) -> Array:
    """bool [n]: where it is said what acted. obeyed: for throttle, brake and steering where the command did."""
    rows = np.ones(drive.ticks, dtype=bool)
    for channel, by_command in zip(DRIVEN_BY, obeyed, strict=True):
        said = f"report.{CHANNELS[channel]}"
        recorded = told(drive, said) if said in drive.fields else np.ones(drive.ticks, dtype=bool)
        rows &= np.where(by_command, _asked_told(drive, channel), recorded)
    return rows


def _asked_told(drive: Drive, channel: str) -> Array:
    """By the echo where there is one; pedals of a car that is asked for an acceleration by that."""
    names = [f"report.{ECHOES[channel]}", f"command.{CHANNELS[channel]}"]
    if channel != "steer":
        names += [f"report.{ECHOES['accel']}", f"command.{CHANNELS['accel']}"]
    name = next((one for one in names if one in drive.fields), None)
    return np.ones(drive.ticks, dtype=bool) if name is None else told(drive, name)


def those_that_say_all(drives: Sequence[Drive]) -> tuple[list[Drive], list[str]]:
    """(drives that say something of every channel of which any of them does, the others in words)."""
    said = [{one for one in DRIVEN_BY if _says(drive, one)} for drive in drives]
    most = set[str]().union(*said)
    if most not in said:  # none says all of them
        return list(drives), []
    words = [
        f"{drive.path} says nothing of {' and '.join(sorted(most - mine))}, of which others do, and is left out"
        for drive, mine in zip(drives, said, strict=True)
        if mine != most
    ]
    return [drive for drive, mine in zip(drives, said, strict=True) if mine == most], words


def _says(drive: Drive, channel: str) -> bool:
    names = (f"command.{CHANNELS[channel]}", f"report.{CHANNELS[channel]}", f"report.{ECHOES[channel]}")
    return any(name in drive.fields and np.isfinite(drive.fields[name]).any() for name in names)


Array = np.ndarray

CALM = 0.2  # of how far a value sticks out: more do the values around it not differ, or the signal moves of itself
FAR = 25.0  # times the usual step from value to value; of white noise the farthest of a million is at 6
AROUND = 21  # values whose steps are the usual ones
MOST_SHARE = 0.01  # of a signal's values: where more stick out, it is the sensor's own way
LEAST_VALUES = 50
STEPS = ("report.gear",)  # no quantity that moves from value to value
OUTPUTS = ("report.throttle_frac", "report.brake_frac", "report.steer_rad")
SELDOM_S = 0.03  # from value to value; a tap of an actuator takes longer


def without_spikes(drive: Drive) -> tuple[Drive, dict[str, int]]:
    """(drive, how many values of which field were left out of it). A value that is left out is not fresh any more."""
    fields, fresh, found = dict(drive.fields), dict(drive.fresh), {}
    for name in _asked(drive):
        rows = np.flatnonzero(drive.fresh[name] & np.isfinite(drive.fields[name]))
        if name in OUTPUTS and len(rows) > 1 and float(np.median(np.diff(rows))) * drive.dt_s > SELDOM_S:
            continue
        values = drive.fields[name][rows]
        bad = rows[spikes(np.unwrap(values) if name.endswith("heading_rad") else values)]
        if 0 < len(bad) <= max(1.0, MOST_SHARE * len(rows)):
            fresh[name] = drive.fresh[name].copy()
            fresh[name][bad] = False
            fields[name] = _held(drive.fields[name], drive.fresh[name], bad)
            found[name] = len(bad)
    return (drive._replace(fields=fields, fresh=fresh), found) if found else (drive, found)


def spikes(values: Array) -> Array:
    """bool [n]: which values stick out of both of their neighbours by FAR times the steps around them, and overall,
    while the two values before and the two behind stay where they were.
    """
    bad = np.zeros(len(values), dtype=bool)
    if len(values) < LEAST_VALUES:
        return bad
    steps = np.abs(np.diff(values))
    usual = np.maximum(median_filter(steps, AROUND, mode="nearest"), float(np.median(steps))) + quantum_of(values)
    before, at, after = values[:-2], values[1:-1], values[2:]
    out = np.maximum(at - np.maximum(before, after), np.minimum(before, after) - at)
    beside = np.maximum(np.concatenate([[0.0], steps[:-2]]), np.concatenate([steps[2:], [0.0]]))
    calm = np.maximum(np.abs(after - before), beside) < CALM * out
    bad[1:-1] = calm & (out > FAR * np.maximum(usual[:-1], usual[1:]))
    return bad


def _asked(drive: Drive) -> Iterator[str]:
    """The fields that somebody measured."""
    echoes = {f"report.{name}" for name in ECHOES.values()}
    for name in drive.fields:
        if name.startswith(("report.", "ins.")) and name not in echoes and name not in STEPS:
            yield name


def _held(values: Array, fresh: Array, bad: Array) -> Array:
    """A field in which each bad value, and what was held of it until the next frame, is the one before it."""
    found, frames = values.copy(), np.flatnonzero(fresh)
    for row in bad:
        i = int(np.searchsorted(frames, row))
        end = frames[i + 1] if i + 1 < len(frames) else len(values)
        found[row:end] = found[row - 1]
    return found


PLACE = ("ins.x_m", "ins.y_m")
HELD_S = 1.0
LEAST_M = 1.0  # by its speed, that it is somewhere else by then
FRAMES = 4  # of a slow INS, that say the same


def without_place(drive: Drive) -> Drive:
    """The drive as if nobody had said where it was."""
    fields = {name: values for name, values in drive.fields.items() if name not in PLACE}
    return drive._replace(fields=fields, fresh={name: drive.fresh[name] for name in fields})


def without_held_pose(drive: Drive) -> tuple[Drive, float]:
    """(the drive without its place in such stretches, how many seconds they are)."""
    speed = first_of(drive, CHASSIS_FIRST_SPEEDS)
    if speed is None or any(name not in drive.fields for name in PLACE):
        return drive, 0.0
    stands = np.zeros(drive.ticks, dtype=bool)
    still = np.all([np.diff(drive.fields[name], prepend=np.nan) == 0.0 for name in PLACE], axis=0)
    least = max(round(HELD_S / drive.dt_s), round(FRAMES * every_of(drive.fresh[PLACE[0]])))
    for begin, end in runs(still, least):
        stands[begin:end] = float(np.nansum(np.abs(speed[begin:end]))) * drive.dt_s > LEAST_M
    if not stands.any():
        return drive, 0.0
    fields, fresh = dict(drive.fields), dict(drive.fresh)
    for name in PLACE:
        fields[name] = np.where(stands, np.nan, fields[name])
        fresh[name] = fresh[name] & ~stands
    return drive._replace(fields=fields, fresh=fresh), float(stands.sum()) * drive.dt_s
