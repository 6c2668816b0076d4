"""How many of some roads failed, with the exact 95 % interval (Clopper and Pearson 1934, Biometrika 26, 404-413)."""

from __future__ import annotations

from typing import Any, NamedTuple


class FailureShare(NamedTuple):
    """Failed roads of n, with the interval of their share; 0 to 1 where n is 0."""

    failed: int
    n: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """Failed roads over all; 0 of none."""
        return self.failed / self.n if self.n else 0.0

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        return self._asdict()


def compute_failure_share(failed: int, n: int) -> FailureShare:
    """The share with its interval."""
    if n == 0:
        return FailureShare(0, 0, 0.0, 1.0)
    from scipy.stats import binomtest  # here, since it takes a second

    interval = binomtest(failed, n).proportion_ci(confidence_level=0.95, method="exact")
    return FailureShare(failed, n, float(interval.low), float(interval.high))
