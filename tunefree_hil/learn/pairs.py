"""Pairs of a by-wire channel's command and output, in one frame of time, tick by tick.

A report that echoes the command beside the output has no transport between the two: the echo is the command that the
actuator was given in the tick at whose end the output stands, just as `plant/actuators.py` has it. Between two such
reports the command of the wire is taken, at the shift at which it agrees with the echo. Without an echo the command of
the wire is moved by the bench's delays ([timing]: one tick each way, and one for the step itself).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.learn.drives import Drive, Part
from tunefree_hil.learn.runs import runs
from tunefree_hil.learn.stops import commands_at, stop_words, stops_of, within

Array = np.ndarray

CHANNELS = {
    "throttle": "throttle_frac",
    "brake": "brake_frac",
    "steer": "steer_rad",
    "accel": "accel_mps2",
    "steer_torque": "steer_torque_nm",
}
ECHOES = {
    "throttle": "throttle_command_frac",
    "brake": "brake_command_frac",
    "steer": "steer_command_rad",
    "accel": "accel_command_mps2",
    "steer_torque": "steer_torque_command_nm",
}
BENCH_TICKS = 3  # command, step, report
LONGEST_SHIFT_S = 0.3  # between a command on the wire and its echo
AGREEING_SHARE = 0.9  # of the changes of the echo that the wire must explain
LONGEST_SILENCE_S = 0.2
WARM_S = 1.0  # of a segment that is not compared: what went before it is not known
LEAST_S = 3.0
NO_AGES = np.zeros(0)
TOLD_S = 5e-4  # of a deviation of ages: less is how evenly frames come
RATE_WINDOW_S = 0.5  # of the polynomial that gives the rate of the speed, where that is the output


class Pair(NamedTuple):
    """A stretch without a gap. command [n]: held during each tick; output [n]: at its end, NaN where none came.

    counts: bool [n], rows to compare. window: 0, or the ticks of the filter (learn/smooth.py) through which `output`
    went; what is compared to it must go through it too.
    """

    command: Array
    output: Array
    counts: Array
    dt_s: float
    window: int = 0


class Pairs(NamedTuple):
    """All stretches of a channel; words: where the commands come from. apart_s: standard deviation of the time from a
    command to the report that echoes it first (command_age.py); 0 where commands come with the ticks.
    """

    channel: str
    some: tuple[Pair, ...]
    words: str
    apart_s: float = 0.0

    @property
    def rows(self) -> int:
        """Rows to compare."""
        return sum(int(pair.counts.sum()) for pair in self.some)


def pairs_of(parts: Iterable[Part], channel: str) -> Pairs:
    """Command and output of a channel in `parts`; without stretches where the logs do not have both."""
    found: list[Pair] = []
    words: list[str] = []
    ages: list[Array] = []
    for part in parts:
        drive = part.drive
        taken = _taken(drive, channel)
        if taken is None:
            continue
        command, output, fresh, window, said = taken
        words += [said] if said not in words else []
        ages += [drive.command_ages.get(f"report.{ECHOES[channel]}", NO_AGES)]
        for begin, end in stretches(drive, part, command, output, fresh):
            counts = fresh[begin:end] & np.isfinite(output[begin:end])
            counts[: round(WARM_S / drive.dt_s)] = False
            if counts.any():
                found.append(Pair(command[begin:end], output[begin:end], counts, drive.dt_s, window))
    heard = np.concatenate([NO_AGES, *ages])
    apart_s = float(heard.std()) if len(heard) else 0.0
    if apart_s > TOLD_S:
        words.append(f"commands come {1e3 * heard.mean():.1f} ms before that, deviation {1e3 * apart_s:.1f} ms")
    return Pairs(channel, tuple(found), "; ".join(words), apart_s)


def up_to_stops(training: Pairs, held_out: Pairs) -> tuple[Pairs, Pairs]:
    """Both with commands that end where the channel does (stops.py), which all of them show together."""
    every = (*training.some, *held_out.some)
    low, high = stops_of(every)
    if math.isinf(low) and math.isinf(high):
        return training, held_out
    ends = commands_at(every, low, high)
    said = stop_words(every, *ends)

    def ended(pairs: Pairs) -> Pairs:
        return pairs._replace(some=tuple(within(one, *ends) for one in pairs.some), words=f"{pairs.words}; {said}")

    return ended(training), ended(held_out)


def _taken(drive: Drive, channel: str) -> tuple[Array, Array, Array, int, str] | None:
    """(command, output, where it is fresh, window, words) of a whole drive, or None."""
    name = CHANNELS[channel]
    output, wire = drive.get(f"report.{name}"), drive.get(f"command.{name}")
    echo = drive.get(f"report.{ECHOES[channel]}")
    if output is not None and channel != "accel":
        fresh = drive.fresh[f"report.{name}"]
        if echo is not None:
            told = drive.fresh[f"report.{ECHOES[channel]}"]
            return by_echo(echo, told, wire, drive.dt_s), output, fresh, 0, _echo_words(wire)
        if wire is not None:
            moved = shifted(wire, BENCH_TICKS)
            return moved, output, fresh, 0, f"no echo: commands moved by {BENCH_TICKS} ticks, as the bench delays them"
        return None
    if echo is not None:
        command = by_echo(echo, drive.fresh[f"report.{ECHOES[channel]}"], wire, drive.dt_s)
    else:
        command = None if wire is None else shifted(wire, BENCH_TICKS)
    return None if command is None or channel != "accel" else _by_motion(drive, command)


def _echo_words(wire: Array | None) -> str:
    return "command and output of the same report" + ("" if wire is None else ", the wire's commands between two")


def _by_motion(drive: Drive, command: Array) -> tuple[Array, Array, Array, int, str] | None:
    """The rate of the car's speed as the output of an acceleration channel."""
    from tunefree_hil.learn.smooth import rate_of, speed_of

    found = speed_of(drive)
    if found is None:
        return None
    speed, fresh = found
    window = max(round(RATE_WINDOW_S / drive.dt_s) | 1, 5)
    return command, rate_of(speed, fresh, window, drive.dt_s), fresh, window, "from motion: the rate of the speed"


def by_echo(echo: Array, fresh: Array, wire: Array | None, dt_s: float) -> Array:
    """The command of every tick: the echo where a report is fresh; between two the wire's, if it agrees with both.

    Where it does not (a ramp or a limit of the by-wire unit, a foot on the pedal) a straight line between the echoes.
    """
    ticks = np.flatnonzero(fresh & np.isfinite(echo))
    if len(ticks) < 2 or len(ticks) == ticks[-1] - ticks[0] + 1:
        return echo.copy()
    command = np.where(np.isfinite(echo), np.interp(np.arange(len(echo)), ticks, echo[ticks]), np.nan)
    shift = None if wire is None else shift_of(echo, wire, ticks, round(LONGEST_SHIFT_S / dt_s))
    if wire is None or shift is None:
        return command
    moved = shifted(wire, shift)
    agrees = np.abs(moved[ticks] - echo[ticks]) <= tolerance(echo[ticks])
    place = np.clip(np.searchsorted(ticks, np.arange(len(echo)), side="right") - 1, 0, len(ticks) - 2)
    use = agrees[place] & agrees[place + 1] & np.isfinite(moved) & np.isfinite(command)
    use[ticks] = False
    command[use] = moved[use]
    return command


def shift_of(echo: Array, wire: Array, ticks: Array, longest: int) -> int | None:
    """By how many rows the wire must be moved to agree with the echo before and after each change; None if it cannot.

    Where several shifts do (every change in the same half of a report's period), the one nearest to the bench's own.
    """
    slack = tolerance(echo[ticks])
    place = np.flatnonzero(np.abs(np.diff(echo[ticks])) > slack)
    place = place[ticks[place] >= longest]
    if not len(place):
        return BENCH_TICKS
    both = np.concatenate([ticks[place], ticks[place + 1]])
    shares = [float(np.mean(np.abs(wire[both - shift] - echo[both]) <= slack)) for shift in range(longest + 1)]
    best = min(range(longest + 1), key=lambda shift: (-round(shares[shift], 3), abs(shift - BENCH_TICKS)))
    return best if shares[best] >= AGREEING_SHARE else None


def tolerance(values: Array) -> float:
    """What two roundings of one number may differ by: one and a half steps of the wire."""
    from tunefree_hil.learn.smooth import quantum_of

    return 1.5 * quantum_of(values) + 1e-9


def shifted(values: Array, rows: int) -> Array:
    """The same signal `rows` rows later."""
    moved = np.full_like(values, np.nan)
    moved[rows:] = values[: len(values) - rows]
    return moved


def stretches(drive: Drive, part: Part, command: Array, output: Array, fresh: Array) -> list[tuple[int, int]]:
    """Rows [begin, end) of a part in which the channel obeys and nothing is silent for long."""
    good = np.isfinite(command) & np.isfinite(output) & drive.enabled
    silence = round(LONGEST_SILENCE_S / drive.dt_s)
    heard = np.flatnonzero(fresh)
    last = np.searchsorted(heard, np.arange(len(fresh)), side="right") - 1
    age = np.where(last >= 0, np.arange(len(fresh)) - heard[np.maximum(last, 0)] if len(heard) else 0, silence + 1)
    good &= age <= silence
    return runs(good[part.begin : part.end], round(LEAST_S / drive.dt_s), part.begin)


def has_channel(drives: Sequence[Drive], channel: str) -> bool:
    """Whether any log has a command (or its echo) of this channel."""
    names = (f"command.{CHANNELS[channel]}", f"report.{ECHOES[channel]}")
    return any(drive.get(name) is not None for drive in drives for name in names)
