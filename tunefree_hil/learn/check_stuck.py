"""Signals that say the same value for seconds while what moves them moves (learn/checks.py)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tunefree_hil.learn.drives import Drive
from tunefree_hil.learn.fields import CHASSIS_FIRST_SPEEDS
from tunefree_hil.learn.problems import Problem
from tunefree_hil.learn.series import TURNS, first_of, name_of

Array = np.ndarray

STUCK_S, FEWEST_FRAMES = 2.0, 10
SETTLED_S = 0.5  # at each end of a stretch, in which what moves the signal does not count: its answer comes late
MOVED = 0.3  # of the mover's own range in the drive
TURNING = "steering times speed"


class Mover(NamedTuple):
    """What makes a signal move, best first, and how far it must have moved for the signal to follow."""

    names: tuple[str, ...]
    least: float


_YAW = (TURNING,)
_FOLLOWS: dict[str, tuple[Mover, ...]] = {
    "report.steer_rad": (Mover(("report.steer_command_rad", "command.steer_rad"), 0.1),),
    "report.steer_command_rad": (Mover(("command.steer_rad",), 0.1),),
    "report.throttle_frac": (Mover(("report.throttle_command_frac", "command.throttle_frac"), 0.04),),
    "report.throttle_command_frac": (Mover(("command.throttle_frac",), 0.04),),
    "report.brake_frac": (Mover(("report.brake_command_frac", "command.brake_frac"), 0.04),),
    "report.brake_command_frac": (Mover(("command.brake_frac",), 0.04),),
    "report.steer_torque_nm": (Mover(("report.steer_torque_command_nm", "command.steer_torque_nm"), 0.0),),
    "report.yaw_rate_radps": (Mover(("ins.yaw_rate_radps",), 0.1), Mover(_YAW, 5.0)),
    "ins.yaw_rate_radps": (Mover(("report.yaw_rate_radps",), 0.1), Mover(_YAW, 5.0)),
    "report.speed_mps": (Mover(("ins.speed_mps", "report.wheel_rl_radps"), 1.5),),
    "ins.speed_mps": (Mover(("report.speed_mps",), 1.5),),
    **{f"report.wheel_{at}_radps": (Mover(CHASSIS_FIRST_SPEEDS, 1.5),) for at in ("fl", "fr", "rl", "rr")},
}


def check_stuck(drive: Drive) -> Iterator[Problem]:
    """The longest stretch of each signal that stands still, where it may not."""
    for name, movers in _FOLLOWS.items():
        if name in drive.fields:
            found = next((one for mover in movers if (one := _stuck(drive, name, mover)) is not None), None)
            if found is not None:
                yield found


def _stuck(drive: Drive, name: str, mover: Mover) -> Problem | None:
    by, moves = _moves(drive, mover.names)
    if moves is None:
        return None
    usable = np.isfinite(moves) & (drive.enabled if by.startswith("command.") else True)
    if not usable.any():
        return None
    least = max(mover.least, MOVED * float(np.ptp(moves[usable])))
    values, settled = drive.fields[name], round(SETTLED_S / drive.dt_s)
    for begin, end in _still(values, drive.fresh[name], round(STUCK_S / drive.dt_s)):
        inner = slice(begin + settled, end - settled)
        some = moves[inner][usable[inner]]
        if some.size and np.ptp(some) > 0.0 and np.ptp(some) >= least:
            begin_s, end_s = begin * drive.dt_s, end * drive.dt_s
            words = (
                f"{drive.name}: {name} is stuck at {values[begin]:.4g} from {begin_s:.2f} to {end_s:.2f} s while {by} "
            )
            words += f"moves by {np.ptp(some):.3g}, where it is expected to follow; mend the sensor, or cut that out"
            return Problem("refuse", "stuck", drive.name, name, words)
    return None


def _moves(drive: Drive, names: tuple[str, ...]) -> tuple[str, Array | None]:
    """(its name, its values) of the first mover that the drive has."""
    if names == _YAW:
        steer, speed = first_of(drive, TURNS), first_of(drive, CHASSIS_FIRST_SPEEDS)
        return TURNING, None if steer is None or speed is None else steer * speed
    name = name_of(drive, names)
    return name or "", None if name is None else drive.fields[name]


def _still(values: Array, fresh: Array, least_ticks: int) -> list[tuple[int, int]]:
    """[first, last) rows of stretches in which fresh frames bring one and the same value, longest first."""
    rows = np.flatnonzero(fresh)
    if not len(rows):
        return []
    changes = np.flatnonzero(np.diff(values[rows]) != 0.0) + 1
    firsts = np.concatenate([[0], changes])
    lasts = np.concatenate([changes, [len(rows)]]) - 1
    long = (rows[lasts] - rows[firsts] >= least_ticks) & (lasts - firsts >= FEWEST_FRAMES)
    found = [(int(rows[first]), int(rows[last]) + 1) for first, last in zip(firsts[long], lasts[long], strict=True)]
    return sorted(found, key=lambda one: one[0] - one[1])
