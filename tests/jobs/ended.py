"""A job, or a part of one, run to its end by a test that wants what it returns as well as what it said."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any, TypeVar

S = TypeVar("S")
T = TypeVar("T")


def ended(job: Generator[S, Any, T]) -> tuple[T, list[S]]:
    """(what it returned, what it yielded)."""
    said: list[S] = []
    while True:
        try:
            said.append(next(job))
        except StopIteration as end:
            return end.value, said
