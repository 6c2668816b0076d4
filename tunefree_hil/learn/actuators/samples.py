"""Pairs of a by-wire channel's command and output, in one frame of time, tick by tick.

A report that echoes the command beside the output has no transport between the two: the echo is the command that the
actuator was given in the tick at whose end the output stands, just as `plant/actuation/actuators.py` has it. Between two such
reports the command of the wire is taken, at the shift at which it agrees with the echo. Without an echo the command of
the wire is moved by the bench's delays ([timing]: one tick each way, and one for the step itself).

The stops of a by-wire channel: outputs that no command moves any further.

A wheel or a valve that stops before its command does is no wrong gain and no lag; what is identified of it has to be
identified from what it could obey: its commands end at the one that reaches the stop. The stop itself is an effect of
the catalogue, which `gap` names with its value.

What acted on a car in each tick, as far as a drive says: commands moved to where they act, and reported outputs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tunefree_hil.learn.drives.drive import Drive, Part
from tunefree_hil.learn.drives.runs import runs
from tunefree_hil.learn.drives.smoothing import between_fresh
from tunefree_hil.plant.actuation.acceleration_interface import FULL_MPS2

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

    counts: bool [n], rows to compare. window: 0, or the ticks of the filter (learn/drives/smoothing.py) through which `output`
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
    from tunefree_hil.learn.drives.smoothing import rate_of, speed_of

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
    from tunefree_hil.learn.drives.smoothing import quantum_of

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


HELD_S = 0.3  # for which the output stands still while its command asks for more: longer than lags of such channels
EVEN = 0.01  # of what the outputs span: what stands still moves by no more, and all its stands are at one level
BEYOND = 0.05  # of it: so much further goes the command, and so much do the commands differ that all end there
REST_S, LEAST_RESTS, LEAST_RANGE = 2.0 * HELD_S, 20, 0.2  # longer than dead times; rows; of the span, of commands
LEAST_HELD_S, LEAST_RUNS = 0.5, 2  # beyond HELD_S, altogether


def stops_of(pairs: Sequence[Pair]) -> tuple[float, float]:
    """(lowest, highest) output that a channel reaches, in its unit; without end where no stop shows itself."""
    outputs = [pair.output[pair.counts] for pair in pairs]
    span = float(np.ptp(np.concatenate(outputs))) if outputs else 0.0
    if not span > 0.0:
        return -math.inf, math.inf
    return -_highest(pairs, -1.0, span), _highest(pairs, 1.0, span)


def within(pair: Pair, low: float, high: float) -> Pair:
    """A stretch whose commands end at these."""
    return pair._replace(command=np.clip(pair.command, low, high))


def commands_at(pairs: Sequence[Pair], low: float, high: float) -> tuple[float, float]:
    """The commands that reach these outputs, by the gain and offset of a channel where it is at rest: (low, high)."""
    gain, offset = _at_rest(pairs, low, high)
    return (low - offset) / gain, (high - offset) / gain


def _at_rest(pairs: Sequence[Pair], low: float, high: float) -> tuple[float, float]:
    """(gain, offset) of outputs that have come to rest, short of these stops, under commands that stand; (1, 0) where
    hardly any do or all at one level.
    """
    outputs = [pair.output[pair.counts] for pair in pairs]
    span = float(np.ptp(np.concatenate(outputs)))
    found = list[Array]()
    for pair in pairs:
        rows, count, _ = _rows_of(pair, REST_S)
        if count > len(rows):
            continue
        output, asked = (sliding_window_view(one[rows], count) for one in (pair.output, pair.command))
        output = output[:, -max(count // 3, 2) :]  # what it has come to in the end
        level = output.mean(axis=1)
        rests = (np.ptp(output, axis=1) <= EVEN * span) & (np.ptp(asked, axis=1) <= EVEN * span)
        rests &= (level > low + BEYOND * span) & (level < high - BEYOND * span)
        found.append(np.stack([asked.mean(axis=1)[rests], level[rests]]))
    command, output = np.concatenate(found, axis=1) if found else np.zeros((2, 0))
    if len(command) < LEAST_RESTS or float(np.ptp(command)) < LEAST_RANGE * span:
        return 1.0, 0.0
    gain, offset = (float(one) for one in np.polyfit(command, output, 1))
    return (gain, offset) if gain > 0.0 else (1.0, 0.0)


def stop_words(pairs: Sequence[Pair], low: float, high: float) -> str:
    """Where a channel stops, for people; '' where it does not. low, high: the commands that reach it."""
    ends = " and ".join(f"{end:.4g}" for end in (low, high) if math.isfinite(end))
    if not ends:
        return ""
    command = np.concatenate([pair.command[pair.counts] for pair in pairs])
    share = float(np.mean((command < low) | (command > high)))
    return f"it stops at a command of {ends}, which {share:.1%} of its commands pass"


def _rows_of(pair: Pair, wide_s: float) -> tuple[Array, int, float]:
    """(rows that count, how many of them such a time holds: more than there are where nobody can tell, s from one to
    the next).
    """
    rows = np.flatnonzero(pair.counts)
    every_s = pair.dt_s * float(np.median(np.diff(rows))) if len(rows) > 1 else math.inf
    return rows, max(round(wide_s / every_s), 2) if math.isfinite(every_s) else len(rows) + 1, every_s


def _highest(pairs: Sequence[Pair], sign: float, span: float) -> float:
    """The highest of sign times the output, as far as that is a stop; else without end."""
    top = max(float((sign * pair.output[pair.counts]).max()) for pair in pairs)
    levels, commands, held_s, runs = list[Array](), list[Array](), 0.0, 0
    for pair in pairs:
        rows, count, every_s = _rows_of(pair, HELD_S)
        if count > len(rows):
            continue
        outputs, asked = (sliding_window_view(sign * one[rows], count) for one in (pair.output, pair.command))
        level, least = outputs.mean(axis=1), asked.min(axis=1)
        stands = (np.ptp(outputs, axis=1) <= EVEN * span) & (level >= top - EVEN * span)
        stands &= least >= level + BEYOND * span
        levels.append(level[stands])
        commands.append(least[stands])
        held_s += float(stands.sum()) * every_s
        runs += int(np.sum(np.diff(np.flatnonzero(stands), prepend=-count) >= count))
    if held_s < LEAST_HELD_S or runs < LEAST_RUNS:
        return math.inf
    if float(np.ptp(np.concatenate(commands))) < BEYOND * span:
        return math.inf
    return float(np.median(np.concatenate(levels)))


def channel_of(drive: Drive, name: str, rest: float) -> tuple[Array, Array, Array]:
    """(command, recorded output, obeyed) of a channel over a whole drive, as they act."""
    asked, said = drive.get(f"command.{CHANNELS[name]}"), drive.get(f"report.{CHANNELS[name]}")
    echo = drive.get(f"report.{ECHOES[name]}")
    none = np.full(drive.ticks, np.nan)
    output = none if said is None else between_fresh(said, drive.fresh[f"report.{CHANNELS[name]}"])
    if asked is None and said is None:  # a vehicle without this pedal
        return np.full(drive.ticks, rest), none, np.ones(drive.ticks, dtype=bool)
    if echo is not None:
        command = by_echo(echo, drive.fresh[f"report.{ECHOES[name]}"], asked, drive.dt_s)
        # a person at the wheel moves the output, and the echo of what is commanded may stay at rest
        return command, output, np.isfinite(command) & (drive.enabled | ~np.isfinite(output))
    if asked is None:
        return none, output, np.zeros(drive.ticks, dtype=bool)
    command = shifted(asked, BENCH_TICKS)
    return command, output, np.isfinite(command) & drive.enabled


def accel_asked(drive: Drive) -> Array | None:
    """The acceleration that acts in each tick as it was asked for, of a car that is driven so and shows no pedals."""
    asked, echo = drive.get("command.accel_mps2"), drive.get(f"report.{ECHOES['accel']}")
    if any(drive.get(f"{group}.throttle_frac") is not None for group in ("command", "report")):
        return None
    if echo is not None:
        return by_echo(echo, drive.fresh[f"report.{ECHOES['accel']}"], asked, drive.dt_s)
    return None if asked is None else shifted(asked, BENCH_TICKS)


def asked_pedals(asked: Array, enabled: Array, rest: float) -> list[tuple[Array, Array, Array]]:
    """Throttle and brake as `channel_of` has them, of a car that is asked for an acceleration."""
    none, obeyed = np.full(len(asked), np.nan), np.isfinite(asked) & enabled
    throttle, brake = np.maximum(asked, 0.0), np.maximum(-asked, 0.0)
    return [(rest + pedal / FULL_MPS2, none, obeyed) for pedal in (throttle, brake)]
