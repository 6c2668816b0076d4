"""The clock of the package, passed as an argument (docs/reference/bench_channel.md)."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Monotonic seconds. Nothing else in the package reads the time for control purposes."""

    def now_s(self) -> float: ...

    def sleep_until(self, time_s: float) -> None: ...


class RealClock:
    """CLOCK_MONOTONIC; sleeps to an absolute deadline and spins the last `spin_s`."""

    def __init__(self, spin_s: float = 0.0003) -> None:
        self.spin_s = spin_s

    def now_s(self) -> float:
        return time.monotonic()

    def sleep_until(self, time_s: float) -> None:
        rest_s = time_s - time.monotonic() - self.spin_s
        if rest_s > 0.0:
            time.sleep(rest_s)
        while time.monotonic() < time_s:
            pass
