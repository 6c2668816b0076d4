"""Single values that no car can have come to: a frame that was written wrong, or read wrong, between two good ones.

One of them is nothing to a mean and everything to a slope: a speed of 0 in one frame of ten thousand is a brake that
nobody pressed. What sticks out of both of its neighbours by many times what the signal usually moves there is left out,
as if its frame had not come. Commands and their echoes are left alone: a controller can ask for anything. So is an
actuator's output that is told so seldom that a tap shows in one value. The first and the last value of a drive have one
neighbour only, and stay.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import median_filter

from tunefree_hil.learn.drives import Drive
from tunefree_hil.learn.pairs import ECHOES
from tunefree_hil.learn.smooth import quantum_of

Array = np.ndarray

CALM = 0.2  # of how far a value sticks out: more do the values around it not differ, or the signal moves of itself
FAR = 25.0  # times the usual step from value to value; of white noise the farthest of a million is at 6
AROUND = 21  # values whose steps are the usual ones
MOST_SHARE = 0.01  # of a signal's values: where more stick out, it is the sensor's own way
LEAST_VALUES = 50
STEPS = ("report.gear",)  # no quantity that moves from value to value
OUTPUTS = ("report.throttle_frac", "report.brake_frac", "report.steer_rad")
SELDOM_S = 0.03  # from value to value; a tap of an actuator takes longer


def without_spikes(drive: Drive) -> tuple[Drive, dict[str, int]]:
    """(drive, how many values of which field were left out of it). A value that is left out is not fresh any more."""
    fields, fresh, found = dict(drive.fields), dict(drive.fresh), {}
    for name in _asked(drive):
        rows = np.flatnonzero(drive.fresh[name] & np.isfinite(drive.fields[name]))
        if name in OUTPUTS and len(rows) > 1 and float(np.median(np.diff(rows))) * drive.dt_s > SELDOM_S:
            continue
        values = drive.fields[name][rows]
        bad = rows[spikes(np.unwrap(values) if name.endswith("heading_rad") else values)]
        if 0 < len(bad) <= max(1.0, MOST_SHARE * len(rows)):
            fresh[name] = drive.fresh[name].copy()
            fresh[name][bad] = False
            fields[name] = _held(drive.fields[name], drive.fresh[name], bad)
            found[name] = len(bad)
    return (drive._replace(fields=fields, fresh=fresh), found) if found else (drive, found)


def spikes(values: Array) -> Array:
    """bool [n]: which values stick out of both of their neighbours by FAR times the steps around them, and overall,
    while the two values before and the two behind stay where they were.
    """
    bad = np.zeros(len(values), dtype=bool)
    if len(values) < LEAST_VALUES:
        return bad
    steps = np.abs(np.diff(values))
    usual = np.maximum(median_filter(steps, AROUND, mode="nearest"), float(np.median(steps))) + quantum_of(values)
    before, at, after = values[:-2], values[1:-1], values[2:]
    out = np.maximum(at - np.maximum(before, after), np.minimum(before, after) - at)
    beside = np.maximum(np.concatenate([[0.0], steps[:-2]]), np.concatenate([steps[2:], [0.0]]))
    calm = np.maximum(np.abs(after - before), beside) < CALM * out
    bad[1:-1] = calm & (out > FAR * np.maximum(usual[:-1], usual[1:]))
    return bad


def _asked(drive: Drive) -> Iterator[str]:
    """The fields that somebody measured."""
    echoes = {f"report.{name}" for name in ECHOES.values()}
    for name in drive.fields:
        if name.startswith(("report.", "ins.")) and name not in echoes and name not in STEPS:
            yield name


def _held(values: Array, fresh: Array, bad: Array) -> Array:
    """A field in which each bad value, and what was held of it until the next frame, is the one before it."""
    found, frames = values.copy(), np.flatnonzero(fresh)
    for row in bad:
        i = int(np.searchsorted(frames, row))
        end = frames[i + 1] if i + 1 < len(frames) else len(values)
        found[row:end] = found[row - 1]
    return found
