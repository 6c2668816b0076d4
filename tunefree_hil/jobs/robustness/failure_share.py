"""How many of some roads failed, with the exact 95 % interval of Clopper and Pearson (1934, Biometrika 26, 404-413).

With no failure the upper bound is the one-sided one, 1 - 0.05^(1/n), nearly 3/n ("rule of three"), and with failures
only the lower bound likewise.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

ERROR_SHARE = 0.05  # 1 - confidence
BISECTIONS = 50  # 2^-50 of the whole range


class FailureShare(NamedTuple):
    """Failed ones of n, with the interval of their share; NaN-free: 0 to 1 where n is 0."""

    failed: int
    n: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """Failed ones over all; 0 of none."""
        return self.failed / self.n if self.n else 0.0

    def as_data(self) -> dict[str, Any]:
        """Plain data."""
        return self._asdict()


def failure_share(failed: int, n: int) -> FailureShare:
    """The share with its interval."""
    if n == 0:
        return FailureShare(0, 0, 0.0, 1.0)
    if failed == 0:
        return FailureShare(0, n, 0.0, 1.0 - ERROR_SHARE ** (1.0 / n))
    if failed == n:
        return FailureShare(n, n, ERROR_SHARE ** (1.0 / n), 1.0)
    low = _solve(lambda share: 1.0 - _lower_tail(failed - 1, n, share) - 0.5 * ERROR_SHARE)
    high = _solve(lambda share: 0.5 * ERROR_SHARE - _lower_tail(failed, n, share))
    return FailureShare(failed, n, low, high)


def _lower_tail(k: int, n: int, share: float) -> float:
    """P(X <= k) of a binomial variable."""
    i = np.arange(k + 1, dtype=float)
    log_ways = np.concatenate([[0.0], np.cumsum(np.log((n - i[:-1]) / (i[:-1] + 1.0)))])
    return float(np.sum(np.exp(log_ways + i * np.log(share) + (n - i) * np.log1p(-share))))


def _solve(rising: Callable[[float], float]) -> float:
    """Where a rising function of a share is 0."""
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if rising(middle) > 0.0 else (middle, high)
    return 0.5 * (low + high)
