"""Rolling counters, and end-to-end protection by profile name (anchors A6).

A counter proves that a frame is fresh and in order; it does not prove that its values are plausible.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

# Profiles that a codec can write and check. 'none': a counter at most, no checksum.
PROFILES = ("none",)


class Order(Enum):
    """How a counter follows the one before."""

    FIRST = "the first frame"
    OK = "the next value"
    REPEATED = "the same value again: a repeated or stuck frame"
    SOME_LOST = "a few values were skipped"
    WRONG = "more values were skipped than allowed, or it went back"


class Counted(NamedTuple):
    """What a counter check says: the order, and how many frames are missing in between."""

    order: Order
    lost: int


def next_counter(counter: int, modulus: int) -> int:
    """The value after `counter` of a counter that rolls over at `modulus`."""
    return (counter + 1) % modulus


def check_counter(last: int | None, heard: int, modulus: int, max_delta: int = 1) -> Counted:
    """How `heard` follows `last` (None: nothing heard yet). max_delta: the widest step that still passes."""
    if last is None:
        return Counted(Order.FIRST, 0)
    delta = (heard - last) % modulus
    if delta == 0:
        return Counted(Order.REPEATED, 0)
    if delta == 1:
        return Counted(Order.OK, 0)
    return Counted(Order.SOME_LOST if delta <= max_delta else Order.WRONG, delta - 1)


class CounterCheck:
    """Watches one message's counter. A wrong step is a new start, as receivers take it after a sender's restart."""

    def __init__(self, modulus: int, max_delta: int = 1) -> None:
        self.modulus = modulus
        self.max_delta = max_delta
        self.last: int | None = None
        self.repeats = 0  # in a row

    def hear(self, counter: float) -> Counted:
        """Take in the next frame's counter."""
        heard = int(counter)
        counted = check_counter(self.last, heard, self.modulus, self.max_delta)
        self.repeats = self.repeats + 1 if counted.order is Order.REPEATED else 0
        self.last = heard
        return counted
