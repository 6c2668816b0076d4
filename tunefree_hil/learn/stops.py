"""The stops of a by-wire channel: outputs that no command moves any further.

A wheel or a valve that stops before its command does is no wrong gain and no lag; what is identified of it has to be
identified from what it could obey: where its output stands at a stop, and for a while behind it, nothing is compared
(the command that a stop answers is not known before the channel's gain and offset are). The stop itself is an effect
of the catalogue, which `gap` names with its value.
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
AFTER_S = 0.5  # behind a stop: a lag that goes on beyond it has come back by then
LEAST_HELD_S, LEAST_RUNS = 0.5, 2  # beyond HELD_S, altogether


def stops_of(pairs: Sequence[Pair]) -> tuple[float, float]:
    """(lowest, highest) output that a channel reaches, in its unit; without end where no stop shows itself."""
    outputs = [pair.output[pair.counts] for pair in pairs]
    span = float(np.ptp(np.concatenate(outputs))) if outputs else 0.0
    if not span > 0.0:
        return -math.inf, math.inf
    return -_highest(pairs, -1.0, span), _highest(pairs, 1.0, span)


def within(pair: Pair, low: float, high: float) -> Pair:
    """A stretch of which nothing counts where the output is at one of these stops, nor shortly after."""
    near = EVEN * (high - low) if math.isfinite(high - low) else EVEN * float(np.ptp(pair.output[pair.counts]))
    stands = pair.counts & ((pair.output >= high - near) | (pair.output <= low + near))
    after = np.ones(max(round(AFTER_S / pair.dt_s), 1) + 1)
    return pair._replace(counts=pair.counts & ~(np.convolve(stands, after)[: len(stands)] > 0.5))


def stop_words(pairs: Sequence[Pair], low: float, high: float) -> str:
    """What was found, for people; '' where there is none."""
    ends = " and ".join(f"{end:.4g}" for end in (low, high) if math.isfinite(end))
    if not ends:
        return ""
    command = np.concatenate([pair.command[pair.counts] for pair in pairs])
    share = float(np.mean((command < low) | (command > high)))
    return f"it stops at {ends}, which {share:.1%} of its commands pass"


def _highest(pairs: Sequence[Pair], sign: float, span: float) -> float:
    """The highest of sign times the output, as far as that is a stop; else without end."""
    top = max(float((sign * pair.output[pair.counts]).max()) for pair in pairs)
    levels, commands, held_s, runs = list[Array](), list[Array](), 0.0, 0
    for pair in pairs:
        rows = np.flatnonzero(pair.counts)
        every_s = pair.dt_s * float(np.median(np.diff(rows))) if len(rows) > 1 else math.inf
        count = max(round(HELD_S / every_s), 2) if math.isfinite(every_s) else len(rows) + 1
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
