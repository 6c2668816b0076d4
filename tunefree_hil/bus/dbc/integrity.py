"""Checks received frames: counters, CRCs, arrival. One implementation for ECU, controller and logs.

A counter shows that a frame is fresh and in order, a CRC that it is intact, a data id that it is from the right
sender; none of them shows that its values are plausible. Statuses are those of the AUTOSAR E2E protocol. The first
frame of a protected message only initialises the counter, so its values are not used.
"""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import TYPE_CHECKING, NamedTuple

from tunefree_hil.bus.dbc.e2e import is_intact, read_nibble

if TYPE_CHECKING:
    from tunefree_hil.bus.dbc.message_map import MessageMap


class Order(Enum):
    """How a counter follows the one before."""

    FIRST = "the first frame"
    OK = "the next value"
    REPEATED = "the same value again: a repeated or stuck frame"
    SOME_LOST = "a few values were skipped"
    WRONG = "more values were skipped than allowed, or it went back"


class E2eStatus(IntEnum):
    """E2E status of a message's last frame, or of its absence. The numbers are the project's own."""

    words: str

    def __new__(cls, value: int, words: str) -> E2eStatus:
        member = int.__new__(cls, value)
        member._value_ = value
        member.words = words
        return member

    OK = 0, "ok"
    SOME_LOST = 1, "some frames lost"
    REPEATED = 2, "repeated"
    WRONG_SEQUENCE = 3, "wrong sequence"
    WRONG_CRC = 4, "wrong CRC"
    NO_NEW_DATA = 5, "no new data"
    INITIAL = 6, "not proven yet"


LATE_TICKS = 2  # after its period, at which a message is overdue: frames come a tick late in real time
VALID_STATUSES = (E2eStatus.OK, E2eStatus.SOME_LOST)  # the values of such a frame of a protected message are used
_OF_ORDER = {
    Order.FIRST: E2eStatus.INITIAL,
    Order.OK: E2eStatus.OK,
    Order.REPEATED: E2eStatus.REPEATED,
    Order.SOME_LOST: E2eStatus.SOME_LOST,
    Order.WRONG: E2eStatus.WRONG_SEQUENCE,
}


class CounterStep(NamedTuple):
    """Result of a counter check: the order, and how many frames are missing in between."""

    order: Order
    lost: int


def check_counter(last: int | None, counter: int, modulus: int, max_delta: int = 1) -> CounterStep:
    """How `counter` follows `last` (None: no frame yet). max_delta: the widest step that still passes."""
    if last is None:
        return CounterStep(Order.FIRST, 0)
    delta = (counter - last) % modulus
    if delta == 0:
        return CounterStep(Order.REPEATED, 0)
    if delta == 1:
        return CounterStep(Order.OK, 0)
    return CounterStep(Order.SOME_LOST if delta <= max_delta else Order.WRONG, delta - 1)


class Receiver:
    """Watches one message over time, ticks of the vehicle's. `receive` each frame, then `end_tick`.

    The step that the counter may make grows by one for each period without a valid frame, as in AUTOSAR's receiver;
    when it would allow any step, or after a wrong one, the counter starts anew and the next frame is the first valid
    one. A message without protection is always valid; its counter, where it has one, is still watched.
    """

    def __init__(self, message: MessageMap) -> None:
        self.message = message
        self.status = E2eStatus.INITIAL
        self.counts = [0] * len(E2eStatus)
        self.protection = message.e2e
        self._period = max(message.period_ticks, 1)
        self._plain = message.e2e is None and not message.counter
        self._last: int | None = None
        self._good_at = 0  # tick of the last frame that counted on
        self._slack = LATE_TICKS
        self.due_at = self._period + self._slack  # the tick at which it is overdue
        if message.counter:
            self._counter_bits = message.signals[message.counter].end_bit

    @property
    def is_valid(self) -> bool:
        """Whether the values of the last frame may be used."""
        return self.protection is None or self.status in VALID_STATUSES

    def expect_every_period(self) -> None:
        """From the beginning: a frame is overdue at the very tick at which it does not come. For lockstep."""
        self.due_at -= self._slack
        self._slack = 0

    def receive(self, tick: int, data: bytes) -> E2eStatus:
        """Take in a frame that has arrived by `tick`."""
        self.due_at = tick + self._period + self._slack
        self.status = status = E2eStatus.OK if self._plain else self._judge(tick, data)
        self.counts[status] += 1
        return status

    def end_tick(self, tick: int) -> bool:
        """End a tick; True where the message is overdue at it, which is counted once a period."""
        if tick < self.due_at:
            return False
        self.due_at = tick + self._period
        self.status = E2eStatus.NO_NEW_DATA
        self.counts[self.status] += 1
        return True

    def _judge(self, tick: int, data: bytes) -> E2eStatus:
        counter, modulus, widest = self._read(data), self.message.counter_modulus, 1
        if counter is None:
            return E2eStatus.OK
        if self.protection is None and self._last is not None and (counter - self._last) % modulus == 1:
            self._last, self._good_at = counter, tick  # as below, without its detours
            return E2eStatus.OK
        if counter < 0:
            return E2eStatus.WRONG_CRC
        if self.protection is not None:
            if counter >= modulus:  # 15 in profile 1: no sender counts so
                return E2eStatus.WRONG_SEQUENCE
            widest = self.message.e2e_max_delta + max(0, (tick - self._good_at) // self._period - 1)
            if widest >= modulus - 1:
                self._last = None
        order = check_counter(self._last, counter, modulus, widest).order
        if order is not Order.REPEATED:
            self._last, self._good_at = counter, tick
        return _OF_ORDER[order]

    def _read(self, data: bytes) -> int | None:
        """The frame's counter; -1 where its CRC is wrong; None where an unprotected frame ends before it."""
        message = self.message
        if self.protection is not None:
            data = data[: message.length]
            if len(data) < message.length or not is_intact(self.protection, data):
                return -1
            return read_nibble(data, self.protection.counter_at)
        if self._counter_bits > 8 * len(data):
            return None
        return message.read_raw(message.counter, data)
