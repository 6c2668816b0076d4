"""Where a drive says what is read of it: not behind a frame that was the last for long, nor before the first.

What a message said last holds on every tick (learn/drives.py); in a gap of the recording, or once it has fallen silent,
that is no measurement.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tunefree_hil.learn.drives import Array, Drive
from tunefree_hil.learn.fields import INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES, first_told
from tunefree_hil.learn.pairs import CHANNELS, ECHOES
from tunefree_hil.learn.runs import there_of
from tunefree_hil.learn.smooth import between_fresh, earlier

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
