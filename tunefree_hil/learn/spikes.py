"""Single values that no car can have come to: a frame that was written wrong, or read wrong, between two good ones.

One of them is nothing to a mean and everything to a slope: a speed of 0 in one frame of ten thousand is a brake that
nobody pressed. What sticks out of both of its neighbours by many times what the signal usually moves there is left out,
as if its frame had not come. Commands and their echoes are left alone: a controller can ask for anything.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import median_filter

from tunefree_hil.learn.drives import Drive
from tunefree_hil.learn.pairs import ECHOES
from tunefree_hil.learn.smooth import quantum_of

Array = np.ndarray

FAR = 25.0  # times the usual step from value to value; of white noise the farthest of a million is at 6
AROUND = 21  # values whose steps are the usual ones
MOST_SHARE = 0.01  # of a signal's values: where more stick out, it is the sensor's own way
LEAST_VALUES = 50
STEPS = ("report.gear",)  # no quantity that moves from value to value


def without_spikes(drive: Drive) -> tuple[Drive, dict[str, int]]:
    """(drive, how many values of which field were left out of it). A value that is left out is not fresh any more."""
    fields, fresh, found = dict(drive.fields), dict(drive.fresh), {}
    for name in _asked(drive):
        rows = np.flatnonzero(drive.fresh[name] & np.isfinite(drive.fields[name]))
        values = drive.fields[name][rows]
        bad = rows[spikes(np.unwrap(values) if name.endswith("heading_rad") else values)]
        if 0 < len(bad) <= MOST_SHARE * len(rows):
            fresh[name] = drive.fresh[name].copy()
            fresh[name][bad] = False
            fields[name] = _held(drive.fields[name], rows, bad)
            found[name] = len(bad)
    return (drive._replace(fields=fields, fresh=fresh), found) if found else (drive, found)


def spikes(values: Array) -> Array:
    """bool [n]: which values stick out of both of their neighbours by FAR times the steps around them, and overall."""
    bad = np.zeros(len(values), dtype=bool)
    if len(values) < LEAST_VALUES:
        return bad
    steps = np.abs(np.diff(values))
    usual = np.maximum(median_filter(steps, AROUND, mode="nearest"), float(np.median(steps))) + quantum_of(values)
    before, at, after = values[:-2], values[1:-1], values[2:]
    out = np.maximum(at - np.maximum(before, after), np.minimum(before, after) - at)
    bad[1:-1] = out > FAR * np.maximum(usual[:-1], usual[1:])
    return bad


def _asked(drive: Drive) -> Iterator[str]:
    """The fields that somebody measured."""
    echoes = {f"report.{name}" for name in ECHOES.values()}
    for name in drive.fields:
        if name.startswith(("report.", "ins.")) and name not in echoes and name not in STEPS:
            yield name


def _held(values: Array, rows: Array, bad: Array) -> Array:
    """A field in which each bad value, and what was held of it, is the good one before it."""
    found = values.copy()
    for row in bad:
        i = int(np.searchsorted(rows, row))
        end = rows[i + 1] if i + 1 < len(rows) else len(values)
        found[row:end] = values[rows[i - 1]]
    return found
