"""One way to make an answer of several readings: median, and how far it can be trusted (interfaces 1)."""

from __future__ import annotations

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
