"""Signals that say the same value for seconds while what moves them moves (learn/checks/drive_checks.py)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tunefree_hil.learn.actuators.samples import ECHOES
from tunefree_hil.learn.checks.problem import Problem
from tunefree_hil.learn.drives.drive import (
    CHASSIS_FIRST_SPEEDS,
    CHASSIS_FIRST_YAW_RATES,
    TURNS,
    Drive,
    first_of,
    moving,
    name_of,
)
from tunefree_hil.learn.drives.smoothing import quantum_of, rate_of

Array = np.ndarray

# An echo that stands tells of commands that never arrived: whoever looks for such a fault is not to be refused
STUCK, ECHO_STUCK = "stuck", "echo_stuck"
_ECHOES = frozenset(f"report.{name}" for name in ECHOES.values())
STUCK_S, FEWEST_FRAMES = 2.0, 10
SETTLED_S = 0.5  # at each end of a stretch, in which what moves the signal does not count: its answer comes late
MOVED = 0.3  # of the mover's own range in the drive
# Movers that no field is: made of several, or of the rate or the sum of one.
TURNING, CORNERING, SPEEDING = "steering times speed", "yaw rate times speed", "the rate of the speed"
WAY, TURNED = "the way by the speed", "the angle by the yaw rate"
RATE_S = 0.5  # the rate of a speed is taken over so long
LEVELS = 20  # different values: a sensor that says fewer is dead and not at its end
POSE, HELD = ("ins.heading_rad", "ins.x_m"), 0.5


class Mover(NamedTuple):
    """What makes a signal move, best first, and how far it must have moved for the signal to follow.

    share: so much of its own range in the drive it must have moved, too.
    """

    names: tuple[str, ...]
    least: float
    share: float = MOVED


_YAW = (TURNING,)
_LONGITUDINAL = (Mover((SPEEDING,), 1.0),)
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
    "report.accel_mps2": _LONGITUDINAL,
    "ins.accel_mps2": _LONGITUDINAL,
    "report.lateral_accel_mps2": (Mover((CORNERING,), 1.0),),
    # sums grow as long as it drives: no share of theirs. What a gyro drifts on a straight road is far less than this.
    "ins.heading_rad": (Mover((TURNED,), 0.5, 0.0),),
    "ins.x_m": (Mover((WAY,), 5.0, 0.0),),  # and y: along one axis the other stands still
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
    least = max(mover.least, mover.share * float(np.ptp(moves[usable])))
    values, settled = drive.fields[name], round(SETTLED_S / drive.dt_s)
    felt = by in (CORNERING, SPEEDING)
    if felt:  # the same quantity: on a coarse wire it moves within a step of it or two
        least = max(least, 2.0 * quantum_of(values[drive.fresh[name]]))
    if by == SPEEDING:  # and the rate of a coarse speed flickers by a step of that
        speed = name_of(drive, CHASSIS_FIRST_SPEEDS) or ""
        least = max(least, 4.0 * quantum_of(drive.fields[speed][drive.fresh[speed]]) / RATE_S)
    for begin, end in _stands(drive, name, felt):
        inner = slice(begin + settled, end - settled)
        some = moves[inner][usable[inner]]
        if some.size and np.ptp(some) > 0.0 and np.ptp(some) >= least:
            begin_s, end_s = begin * drive.dt_s, end * drive.dt_s
            words = (
                f"{drive.path}: {name} is stuck at {values[begin]:.4g} from {begin_s:.2f} to {end_s:.2f} s while {by} "
            )
            words += f"moves by {np.ptp(some):.3g}, where it is expected to follow; mend the sensor, or cut that out"
            return Problem("refuse", ECHO_STUCK if name in _ECHOES else STUCK, drive.name, name, words)
    return None


def _stands(drive: Drive, name: str, felt: bool) -> list[tuple[int, int]]:
    """Stretches in which a field stands that it should not.

    felt: an accelerometer, which at the end of its range stands for as long as the car asks for more (gap/measured/signals.py
    leaves that out). A pose is held where satellites are hidden, and the INS goes on by itself: it is stuck where it
    stands for most of what was driven.
    """
    values, fresh = _told(drive, name)
    found = _still(values, fresh, round(STUCK_S / drive.dt_s))
    if felt:
        some = values[fresh & np.isfinite(values)]
        ends = (some.min(), some.max()) if len(np.unique(some)) > LEVELS else ()
        return [one for one in found if values[one[0]] not in ends]
    if name in POSE:
        moves = moving(drive)
        return found if sum(moves[begin:end].sum() for begin, end in found) > HELD * moves.sum() else []
    return found


def _told(drive: Drive, name: str) -> tuple[Array, Array]:
    """What the field says and where it is fresh; of a position both axes, as one complex number."""
    if name == "ins.x_m" and "ins.y_m" in drive.fields:
        fresh = drive.fresh["ins.x_m"] | drive.fresh["ins.y_m"]
        return drive.fields["ins.x_m"] + 1j * drive.fields["ins.y_m"], fresh
    return drive.fields[name], drive.fresh[name]


def _moves(drive: Drive, names: tuple[str, ...]) -> tuple[str, Array | None]:
    """(its name, its values) of the first mover that the drive has."""
    if names[0] in (TURNING, CORNERING, SPEEDING, WAY, TURNED):
        return names[0], _made(drive, names[0])
    name = name_of(drive, names)
    return name or "", None if name is None else drive.fields[name]


def _made(drive: Drive, mover: str) -> Array | None:
    """A mover of several fields; None where the drive lacks one of them."""
    speed, steer = first_of(drive, CHASSIS_FIRST_SPEEDS), first_of(drive, TURNS)
    yaw = first_of(drive, CHASSIS_FIRST_YAW_RATES)
    if speed is None:
        return None
    if mover == SPEEDING:
        name = name_of(drive, CHASSIS_FIRST_SPEEDS) or ""
        return rate_of(speed, drive.fresh[name], 2 * round(RATE_S / drive.dt_s / 2.0) + 1, drive.dt_s)
    if mover == WAY:
        return np.cumsum(np.where(moving(drive), np.abs(speed), 0.0)) * drive.dt_s
    if mover == TURNING:
        return None if steer is None else steer * speed
    if yaw is None:
        return None
    # of a car that stands a gyro drifts, and a heading is held
    return (
        yaw * speed if mover == CORNERING else np.cumsum(np.where(moving(drive), np.nan_to_num(yaw), 0.0)) * drive.dt_s
    )


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
