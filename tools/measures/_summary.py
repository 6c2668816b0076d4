"""One way to make an answer of several readings: median, and how far it can be trusted (docs/reference/files.md)."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

RESAMPLES = 2000
FEW = 5


def summary(readings: Sequence[float], unit: str, detail: dict[str, Any], seed: int = 1) -> dict[str, Any]:
    """The median of `readings` with its 95 % bootstrap interval, or min and max where there are fewer than five."""
    values = np.asarray(readings, dtype=float)
    if len(values) < FEW:
        low, high = float(values.min()), float(values.max())
    else:
        rng = np.random.default_rng(seed)
        medians = np.median(rng.choice(values, (RESAMPLES, len(values))), axis=1)
        low, high = (float(edge) for edge in np.percentile(medians, [2.5, 97.5]))
    value = float(np.median(values))
    return {"value": value, "unit": unit, "n": len(values), "low": low, "high": high, "detail": detail}


def machine() -> dict[str, Any]:
    """What a timing was measured on, and how busy that was just before (load average of the last minute)."""
    return {
        "cpus": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load_before": round(os.getloadavg()[0], 2),
        "python": sys.version.split()[0],
    }


def rounded(value: Any, digits: int = 4) -> Any:
    """Plain data with its floats cut to `digits` significant figures: for people who read a detail."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    if isinstance(value, dict):
        return {key: rounded(one, digits) for key, one in value.items()}
    return [rounded(one, digits) for one in value] if isinstance(value, list | tuple) else value
