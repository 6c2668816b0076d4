"""The steps of a search, a fit or a training as progress, and what is left of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import closing
from typing import Any, TypeVar

from tunefree_hil.base.events import Event

STAGES = {  # of a search for what is missing (gap/pipeline.py): the share of its time that has gone as each begins
    "recalibration alone": 0.0,
    "suspects": 0.24,
    "beside": 0.86,
    "each without the others": 0.94,
    "what is left": 0.97,
}
S = TypeVar("S")
T = TypeVar("T")


def told(steps: Generator[S, Any, T], event_of: Callable[[S], Event]) -> Generator[Event, None, T]:
    """Each step as an event; returns what the steps return.

    They are closed when nobody listens any more: their processes end with this, and not when memory is tidied.
    """
    with closing(steps):
        while True:
            try:
                step = next(steps)
            except StopIteration as end:
                return end.value
            yield event_of(step)


def left_s(began: float, share: float) -> float | None:
    """Time that is left where a share of it has gone since `began` (time.monotonic); None where none has."""
    return (time.monotonic() - began) * (1.0 / share - 1.0) if share > 0.0 else None


def eta_of(stage: str, began: float) -> dict[str, Any]:
    """What is left of a search for what is missing, by the stage that begins; nothing before any of it has gone."""
    share = next((one for name, one in STAGES.items() if name in stage), 0.0)
    return {"done": round(100.0 * share), "total": 100, "eta_s": left_s(began, share)} if share else {}
