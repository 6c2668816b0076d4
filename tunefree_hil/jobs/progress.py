"""The steps of a search, a fit or a training as events, and the time that is left."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import closing
from typing import TYPE_CHECKING, Any, TypeVar

from tunefree_hil.base.events import Event

if TYPE_CHECKING:
    from tunefree_hil.gap.progress import SearchProgress

S = TypeVar("S")
T = TypeVar("T")


def relay_events(steps: Generator[S, Any, T], make_event: Callable[[S], Event]) -> Generator[Event, None, T]:
    """Yield an event for each step, and return what the steps return.

    The steps are closed with this generator, so that their processes end at once when it is left.
    """
    with closing(steps):
        while True:
            try:
                step = next(steps)
            except StopIteration as end:
                return end.value
            yield make_event(step)


def left_s(began: float, share: float) -> float | None:
    """Time left where a share of the work is done since `began` (time.monotonic); None where none is."""
    return (time.monotonic() - began) * (1.0 / share - 1.0) if share > 0.0 else None


def count_data(label: str, done: float, total: float, began: float) -> dict[str, Any]:
    """Data of a progress event: a count, and the time left at the rate since `began` (time.monotonic)."""
    return {"label": label, "done": done, "total": total, "eta_s": left_s(began, done / total)}


def progress_data(progress: SearchProgress, began: float) -> dict[str, Any]:
    """What an event says of how far a search of gap is; empty before any of its time is over."""
    share = progress.stage.value
    return {"done": round(100.0 * share), "total": 100, "eta_s": left_s(began, share)} if share else {}
