"""Cache of values that depend on a course only: thousands of drives of a tune share a few courses."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from tunefree_hil.base.course import Course

Derived = TypeVar("Derived")

MAX_COURSES = 32  # courses


class CourseCache(Generic[Derived]):
    """Caches `make(course)` for the most recently added courses. A course is compared by identity, as it is immutable.

    Safe for concurrent calls; at worst a value is computed twice.
    """

    def __init__(self, make: Callable[[Course], Derived], max_courses: int = MAX_COURSES) -> None:
        self._make = make
        self._entries: deque[tuple[Course, Derived]] = deque(maxlen=max_courses)

    def __call__(self, course: Course) -> Derived:
        for known, value in tuple(self._entries):  # a copy, because another thread may add an entry meanwhile
            if known is course:
                return value
        value = self._make(course)
        self._entries.append((course, value))
        return value
