"""The stops of a by-wire channel: outputs that no command moves any further.

A wheel or a valve that stops before its command does is no wrong gain and no lag; what is identified of it has to be
identified from what it could obey: its commands end at the one that reaches the stop. The stop itself is an effect of
the catalogue, which `gap` names with its value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

if TYPE_CHECKING:
    from tunefree_hil.learn.pairs import Pair

Array = np.ndarray

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
