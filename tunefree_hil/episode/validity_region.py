"""Share of a drive outside the region of a model's data ([valid] of model.toml, docs/reference/files.md).

The output of a learned plant is reliable only within the region of its data. A tick is outside where the mean of one
quantity over SMOOTH ticks (against noise) is beyond its limits by more than MARGIN of their distance.
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
    """share: of the ticks with one quantity or more outside; by: the same for each quantity that is ever outside."""

    share: float
    by: dict[str, float]
    ticks: int


def outside(recording: Recording, valid: ValidSpec) -> Outside | None:
    """The part of a drive outside; None where model or recording lack the data."""
    outside_by_key = {key: _beyond(recording, valid, key) for key in ValidSpec.__struct_fields__}
    beyond = {key: found for key, found in outside_by_key.items() if found is not None}
    if not beyond or not recording.ticks:
        return None
    anywhere = np.any(list(beyond.values()), axis=0)
    share_by_key = {key: float(np.mean(found)) for key, found in beyond.items() if found.any()}
    return Outside(float(np.mean(anywhere)), share_by_key, recording.ticks)


def together(drives: Iterable[Outside | None]) -> Outside | None:
    """Several drives as one; None without any data."""
    known = [one for one in drives if one is not None]
    ticks = sum(one.ticks for one in known)
    if not ticks:
        return None
    keys = dict.fromkeys(key for one in known for key in one.by)
    share_by_key = {key: sum(one.by.get(key, 0.0) * one.ticks for one in known) / ticks for key in keys}
    return Outside(sum(one.share * one.ticks for one in known) / ticks, share_by_key, ticks)


def _beyond(recording: Recording, valid: ValidSpec, key: str) -> Array | None:
    """Ticks at which a quantity is outside its limits; None without limits or without the quantity."""
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
    # For an unused pedal the limit on its side is the rest duty of the other one.
    return _outside(throttle, -np.inf, abs(high) + margin) | _outside(brake, -np.inf, abs(low) + margin)


def _outside(values: Array, low: float, high: float) -> Array:
    """An unknown value is not outside."""
    mean = _mean(values)
    with np.errstate(invalid="ignore"):
        return (mean < low) | (mean > high)


def _mean(values: Array) -> Array:
    """Centred mean of the known values of SMOOTH ticks, fewer at the ends; NaN without known values."""
    known = np.isfinite(values)
    sums = np.concatenate([[0.0], np.cumsum(np.where(known, values, 0.0))])
    counts = np.concatenate([[0.0], np.cumsum(known)])
    index = np.arange(len(values))
    begin, end = np.maximum(index - SMOOTH // 2, 0), np.minimum(index + SMOOTH // 2 + 1, len(values))
    number = counts[end] - counts[begin]
    return np.where(number > 0, (sums[end] - sums[begin]) / np.maximum(number, 1.0), np.nan)
