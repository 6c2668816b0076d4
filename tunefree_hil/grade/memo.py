"""What follows from a course alone, worked out once: thousands of drives of a tune share a handful of courses."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from tunefree_hil.base.course import Course

Made = TypeVar("Made")

MOST = 32  # courses


class Kept(Generic[Made]):
    """`make(course)`, kept for the last courses asked for. A course is known by identity: it never changes.

    May be called by several threads at once; at worst something is made twice.
    """

    def __init__(self, make: Callable[[Course], Made], most: int = MOST) -> None:
        self._make = make
        self._kept: deque[tuple[Course, Made]] = deque(maxlen=most)

    def __call__(self, course: Course) -> Made:
        """What `make` says of the course."""
        for known, made in tuple(self._kept):  # a copy: another thread may add one meanwhile
            if known is course:
                return made
        made = self._make(course)
        self._kept.append((course, made))
        return made
