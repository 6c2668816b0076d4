"""A clock that moves only when somebody sleeps: a part's real time without waiting for it."""

from __future__ import annotations


class StoppedClock:
    """Clock (`base/clock.py`) at 0 s until told to sleep."""

    def __init__(self) -> None:
        self._now_s = 0.0

    def now_s(self) -> float:
        return self._now_s

    def sleep_until(self, time_s: float) -> None:
        self._now_s = max(self._now_s, time_s)
