"""What the figures of a calibration show, made where the kernels are compiled (learn/compiled_process.py)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.learn.actuators.model import Way, simulated
from tunefree_hil.learn.actuators.samples import Pair, Pairs
from tunefree_hil.learn.physics.windows import Off, Window, errors, rms_of
from tunefree_hil.plant.actuation.actuators import ActuatorParams

Array = np.ndarray

LARGE_S, SMALL_S = 8.0, 2.5


class Trace(NamedTuple):
    """A stretch of a channel: stamps, command, reported output (NaN where none came), and what the fit puts out."""

    time_s: Array
    command: Array
    output: Array
    fit: Array


class Judged(NamedTuple):
    """Free runs on parts that no fit has seen. time_s [m]; rms by target over all windows at each time, [m, 6].

    before, after: rms over everything by target, with the data sheet's constants and the fitted ones.
    """

    time_s: Array
    before_at: Array
    after_at: Array
    before: dict[str, float]
    after: dict[str, float]
    windows: int


def traces(pairs: Pairs, params: ActuatorParams) -> list[Trace]:
    """A long stretch and a short one with as much going on as there is; none without pairs."""
    if not pairs.some:
        return []
    found = []
    for seconds in (LARGE_S, SMALL_S):
        pair, begin = _liveliest(pairs.some, seconds)
        span = slice(begin, begin + round(seconds / pair.dt_s))
        output = np.where(pair.counts, pair.output, np.nan)
        time_s = np.arange(len(pair.command)) * pair.dt_s
        fit = simulated(Way(params), pair)
        found.append(Trace(time_s[span], pair.command[span], output[span], fit[span]))
    return found


def _liveliest(some: Sequence[Pair], seconds: float) -> tuple[Pair, int]:
    """(pair, row) where a stretch of so long has the most changes of direction and of value in it."""
    best = (-1.0, some[0], 0)
    for pair in some:
        rows = round(seconds / pair.dt_s)
        moves = np.abs(np.diff(pair.command, append=pair.command[-1]))
        live = np.sqrt(moves) * pair.counts
        total = np.concatenate([[0.0], np.cumsum(live)])
        for begin in range(0, max(len(live) - rows, 1), max(rows // 4, 1)):
            score = float(total[min(begin + rows, len(live))] - total[begin])
            if score > best[0]:
                best = (score, pair, begin)
    return best[1], best[2]


def judged(
    some: Sequence[Window],
    before: tuple[Mapping[str, float], Off],
    after: tuple[Mapping[str, float], Off],
) -> Judged | None:
    """Both sets of constants, each with what lies before the car, in free run; None without windows."""
    if not some:
        return None
    misses = [errors(params, off, some) for params, off in (before, after)]
    growth = [np.sqrt(np.nanmean(one * one, axis=0)) if np.isfinite(one).any() else one[0] for one in misses]
    return Judged(some[0].at * some[0].dt_s, growth[0], growth[1], rms_of(misses[0]), rms_of(misses[1]), len(some))
