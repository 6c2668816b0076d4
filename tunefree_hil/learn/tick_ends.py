"""Where a tick ends in a recording of real time: where the fewest frames come, so that none falls now here, now there.

A message that always comes half a tick after the log's first frame, give or take a tenth of a millisecond, would be
rounded to either tick by chance; and of two that come together, one would be said to be a whole tick late.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

Array = np.ndarray

BINS = 100  # of a tick
NEAR = 10  # bins to either side that count as the place itself: as much as frames come sooner or later by
WORTH = 0.5  # of the frames at the end of a tick: where no place has fewer, messages come at any time
SOME = 0.02  # of a message's frames: fewer at an end of a tick are no harm


def even_zero(times_s: Iterable[Array], dt_s: float, zero_s: float) -> float:
    """zero_s, or up to half a tick off it. times_s: stamps of each message; each counts alike, however often it comes.

    It stays where hardly any frame comes half a tick from it, and where as many come everywhere. Else ticks end in the
    middle of the longest stretch of a tick in which the fewest come.
    """
    load = np.zeros(BINS)
    for one in times_s:
        if len(one):
            at = np.floor(((one - zero_s) / dt_s + 0.5) % 1.0 * BINS).astype(int) % BINS
            load += np.bincount(at, minlength=BINS) / len(one)
    near = np.sum([np.roll(load, by) for by in range(-NEAR, NEAR + 1)], axis=0)
    if near[0] <= SOME or near.min() > WORTH * near[0]:
        return zero_s
    end = _middle(near <= near.min() + SOME)
    return zero_s + (end if end <= 0.5 else end - 1.0) * dt_s


def _middle(free: Array) -> float:
    """Of the longest run of a circle of bins, as a share of the circle."""
    if free.all():
        return 0.0
    first = int(np.argmin(free))  # the circle is cut where it is not free
    edges = np.diff(np.concatenate([[False], np.roll(free, -first), [False]]).astype(int))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    longest = int(np.argmax(ends - begins))
    return float((first + 0.5 * (begins[longest] + ends[longest])) / len(free) % 1.0)
