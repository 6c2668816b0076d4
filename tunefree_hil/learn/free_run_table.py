"""Free-run errors as tables with intervals: level ground and hills apart, drives drawn again and again, not starts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tunefree_hil.learn.drives import Array
from tunefree_hil.learn.free_run import Judged

RESAMPLES = 1000
MANY = 15  # drives from which on their bootstrap will do
QUANTITIES = ("position_m", "heading_rad", "speed_mps")


def table_of(judged: Judged, seed: int = 1) -> dict[str, Any]:
    """Plain data: rows 'level' and 'hills' (None where there is no such start), and the one-step errors.

    A row has the counts of starts and drives and by horizon ('10') for each quantity mean, its 95 % interval (None
    where all starts are of one drive) and the 95th percentile, and position error per metre driven (mean over starts
    that moved).
    """
    found: dict[str, Any] = {
        "kind": judged.kind,
        "one_step": {"accel_mps2": judged.accel_mps2, "yaw_rate_radps": judged.yaw_rate_radps},
    }
    for name, rows in (("level", ~judged.hill), ("hills", judged.hill)):
        found[name] = _row(judged, rows, seed) if rows.any() else None
    return found


def _row(judged: Judged, rows: Array, seed: int) -> dict[str, Any]:
    drives = np.array(judged.drives)[rows]
    row: dict[str, Any] = {"starts": int(rows.sum()), "drives": len(set(drives.tolist()))}
    for column, seconds in enumerate(judged.horizons_s):
        values = {name: getattr(judged, name)[rows, column] for name in QUANTITIES}
        metres = judged.metres[rows, column]
        with np.errstate(invalid="ignore"):
            values["position_per_m"] = np.where(metres > 1.0, values["position_m"] / np.maximum(metres, 1.0), np.nan)
        if np.isfinite(values["position_m"]).any():
            row[f"{seconds:g}"] = {name: _spread(one, drives, seed) for name, one in values.items()}
    return row


def _spread(values: Array, drives: Array, seed: int) -> dict[str, Any]:
    known = np.isfinite(values)
    if not known.any():
        return {"n": 0, "mean": None, "p95": None, "low": None, "high": None}
    low, high = (None if math.isnan(one) else one for one in interval_of(values[known], drives[known], seed))
    mean, p95 = float(values[known].mean()), float(np.percentile(values[known], 95))
    return {"n": int(known.sum()), "mean": mean, "p95": p95, "low": low, "high": high}


def interval_of(values: Array, drives: Array, seed: int = 1) -> tuple[float, float]:
    """95 % interval of the mean over whole drives: by their bootstrap, or of few by Student's t (`few_drives`)."""
    totals, counts = _by_drive(values, drives)
    if len(totals) < MANY:
        return few_drives(totals, counts)
    picks = np.random.default_rng(seed).integers(0, len(totals), (RESAMPLES, len(totals)))
    means = totals[picks].sum(axis=1) / counts[picks].sum(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def few_drives(parts: Array, wholes: Array) -> tuple[float, float]:
    """95 % interval of sum(parts) / sum(wholes), one of each a drive, by Student's t: a bootstrap of a few drives, or
    their least and most, holds the truth far too seldom. Of one drive nothing says how far others are off: NaN.
    """
    from scipy.stats import t as student

    n, ratio = len(parts), float(parts.sum() / wholes.sum())
    if n < 2:
        return math.nan, math.nan
    left = parts - ratio * wholes
    doubt = math.sqrt(n / (n - 1.0) * float(left @ left)) / abs(float(wholes.sum()))
    reach = float(student.ppf(0.975, n - 1)) * doubt
    least = 0.0 if (parts >= 0.0).all() else -math.inf  # of errors, which are not below 0
    return max(ratio - reach, least), ratio + reach


def _by_drive(values: Array, drives: Array) -> tuple[Array, Array]:
    """(sum, count) of each drive."""
    _, place = np.unique(drives, return_inverse=True)
    return np.bincount(place, weights=values), np.bincount(place).astype(np.float64)


def reduction(ours: Judged, other: Judged, seconds: float, *, hills: bool = False, seed: int = 1) -> dict[str, Any]:
    """By how many percent the mean position error is smaller than another model's over the same starts.

    With a 95 % interval (whole drives drawn, both models on the same ones) and the number of starts.
    """
    column = ours.horizons_s.index(seconds)
    mine, theirs = ours.position_m[:, column], other.position_m[:, column]
    rows = np.isfinite(mine) & np.isfinite(theirs) & (ours.hill == hills)
    drives = np.array(ours.drives)[rows]
    sums, _ = _by_drive(mine[rows], drives)
    others, counts = _by_drive(theirs[rows], drives)
    value = 100.0 * (1.0 - float(sums.sum()) / float(others.sum()))
    if len(counts) < MANY:
        ends = (100.0 * (1.0 - one) for one in few_drives(sums, others)[::-1])
        low, high = (None if math.isnan(one) else one for one in ends)
        return {"value": value, "low": low, "high": high, "n": int(rows.sum())}
    picks = np.random.default_rng(seed).integers(0, len(counts), (RESAMPLES, len(counts)))
    drawn = 100.0 * (1.0 - sums[picks].sum(axis=1) / others[picks].sum(axis=1))
    low, high = np.percentile(drawn, [2.5, 97.5])
    return {"value": value, "low": float(low), "high": float(high), "n": int(rows.sum())}
