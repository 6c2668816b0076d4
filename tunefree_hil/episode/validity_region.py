"""How much of a drive lies outside the region that a model's data covered ([valid] of model.toml,
docs/reference/files.md).

A learned plant says something everywhere, and means it only where it has seen the vehicle. A tick is outside where one
quantity is: its mean over SMOOTH ticks, as noise is no drive, beyond its ends by more than MARGIN of their distance.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from tunefree_hil.config.schema import ValidSpec
from tunefree_hil.episode.recording import Array, Recording

SMOOTH = 21
MARGIN = 0.02
COLUMN_OF = {
    "speed_mps": "speed_mps",
    "accel_mps2": "accel_mps2",
    "lateral_accel_mps2": "lateral_accel_mps2",
    "steer_rad": "out_steer_rad",
}


class Outside(NamedTuple):
    """share: of the ticks, at which one quantity or more is outside; by: the same for each that ever is."""

    share: float
    by: dict[str, float]
    ticks: int


def outside(recording: Recording, valid: ValidSpec) -> Outside | None:
    """What of a drive is outside; None where model or recording has nothing to say about it."""
    outside_by_key = {key: _beyond(recording, valid, key) for key in ValidSpec.__struct_fields__}
    beyond = {key: found for key, found in outside_by_key.items() if found is not None}
    if not beyond or not recording.ticks:
        return None
    anywhere = np.any(list(beyond.values()), axis=0)
    share_by_key = {key: float(np.mean(found)) for key, found in beyond.items() if found.any()}
    return Outside(float(np.mean(anywhere)), share_by_key, recording.ticks)


def together(drives: Iterable[Outside | None]) -> Outside | None:
    """Several drives as one; None where none of them says anything."""
    known = [one for one in drives if one is not None]
    ticks = sum(one.ticks for one in known)
    if not ticks:
        return None
    keys = dict.fromkeys(key for one in known for key in one.by)
    share_by_key = {key: sum(one.by.get(key, 0.0) * one.ticks for one in known) / ticks for key in keys}
    return Outside(sum(one.share * one.ticks for one in known) / ticks, share_by_key, ticks)


def _beyond(recording: Recording, valid: ValidSpec, key: str) -> Array | None:
    """Ticks at which a quantity is outside its ends; None where it has none, or the recording lacks it."""
    ends = getattr(valid, key)
    if ends is None:
        return None
    low, high = ends
    margin = MARGIN * (high - low)
    if key != "pedals":
        values = recording.get(COLUMN_OF[key])
        return None if values is None else _outside(values, low - margin, high + margin)
    throttle, brake = recording.get("out_throttle_frac"), recording.get("out_brake_frac")
    if throttle is None or brake is None:
        return None
    # Where one pedal was never touched, the end on its side is the other's duty at rest.
    return _outside(throttle, -np.inf, abs(high) + margin) | _outside(brake, -np.inf, abs(low) + margin)


def _outside(values: Array, low: float, high: float) -> Array:
    """A value that is not known is not outside."""
    mean = _mean(values)
    with np.errstate(invalid="ignore"):
        return (mean < low) | (mean > high)


def _mean(values: Array) -> Array:
    """Centred mean of the known values of SMOOTH ticks, fewer at the ends; NaN where none is known."""
    known = np.isfinite(values)
    sums = np.concatenate([[0.0], np.cumsum(np.where(known, values, 0.0))])
    counts = np.concatenate([[0.0], np.cumsum(known)])
    index = np.arange(len(values))
    begin, end = np.maximum(index - SMOOTH // 2, 0), np.minimum(index + SMOOTH // 2 + 1, len(values))
    number = counts[end] - counts[begin]
    return np.where(number > 0, (sums[end] - sums[begin]) / np.maximum(number, 1.0), np.nan)
