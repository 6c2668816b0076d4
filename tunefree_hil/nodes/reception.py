"""Supervises received frames: E2E status, arrival and rate of every message, as text and counts.

Statuses are exact and never stop a drive by themselves; the user of a message decides what its status means. A frame
that is too short to be decoded counts as none. Each kind of trouble of a message gives one notice an episode, at its
first tick, and is counted to the end.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from tunefree_hil.bus.dbc.integrity import E2eStatus, Receiver
from tunefree_hil.bus.dbc.message_map import MessageMap

TOO_MANY = "more frames than are due"
TOO_SHORT = "shorter than the DBC says"
MOST_EXTRA = 2.0  # extra frames before a notice
MOST_FREE = 3.0  # of those that come after a gap
FORGOTTEN = 0.25  # reduction by a frame that arrives alone
UNREMARKABLE = (E2eStatus.OK, E2eStatus.INITIAL)


class Notice(NamedTuple):
    """Something wrong with a message, first seen at `tick`."""

    tick: int
    message: str
    problem: str

    def __str__(self) -> str:
        return f"tick {self.tick}: {self.message}: {self.problem}"


class _ExtraFrames:
    """Counts frames of a message that arrive together, which no sender intends; the count decays slowly.

    In real time frames that a gap delayed arrive at once: that many are not counted.
    """

    def __init__(self, period_ticks: int) -> None:
        self.period = max(period_ticks, 1)
        self.extra = 0.0
        self.last_tick = -1

    def receive(self, tick: int) -> bool:
        """Take in a frame; True where there are too many."""
        gap = (tick - self.last_tick) / self.period - 1.0
        if tick == self.last_tick:
            self.extra += 1.0
        elif gap > 0.0:
            self.extra = max(-MOST_FREE, self.extra - gap)
        else:
            self.extra -= max(-FORGOTTEN, min(FORGOTTEN, self.extra))
        self.last_tick = tick
        return self.extra > MOST_EXTRA


class Reception:
    """The messages of one direction, as one node receives them in one episode."""

    def __init__(self, messages: Iterable[MessageMap]) -> None:
        self.receivers = {message.name: Receiver(message) for message in messages}
        self._watched = {
            name: (receiver, _ExtraFrames(receiver.message.period_ticks)) for name, receiver in self.receivers.items()
        }
        self._seen: set[tuple[str, str]] = set()
        self._new: list[Notice] = []
        self.too_many: dict[str, int] = {}
        self.too_short: dict[str, int] = {}

    def expect_every_period(self) -> None:
        """Before the first tick of a drive in lockstep, where no frame is late: a single missing one is noticed."""
        for receiver in self.receivers.values():
            receiver.expect_every_period()

    def receive(self, message: MessageMap, data: bytes, tick: int) -> bool:
        """Take in a frame that has arrived by `tick`; whether its values may be taken."""
        if len(data) < message.length and message.e2e is None and not message.fits(data):  # else the CRC is wrong
            self.too_short[message.name] = self.too_short.get(message.name, 0) + 1
            self._notice(tick, message.name, TOO_SHORT)
            return False
        receiver, extra = self._watched[message.name]
        status = receiver.receive(tick, data)
        if status is not E2eStatus.OK and status is not E2eStatus.INITIAL:
            self._notice(tick, message.name, status.words)
        if extra.extra == 0.0 and tick - extra.last_tick == extra.period:
            extra.last_tick = tick  # as extra.receive does for a frame in time
        elif extra.receive(tick):
            self.too_many[message.name] = self.too_many.get(message.name, 0) + 1
            self._notice(tick, message.name, TOO_MANY)
        return message.e2e is None or receiver.is_valid

    def end_tick(self, tick: int) -> None:
        """End a tick: notice overdue messages."""
        for name, receiver in self.receivers.items():
            if tick >= receiver.due_at and receiver.end_tick(tick):
                self._notice(tick, name, E2eStatus.NO_NEW_DATA.words)

    def status(self, name: str) -> E2eStatus:
        """A message's status now."""
        return self.receivers[name].status

    def notices(self) -> list[Notice]:
        """New notices since the last call."""
        new, self._new = self._new, []
        return new

    def troubles(self) -> dict[str, list[int]]:
        """Messages with which something was wrong: frames by E2eStatus in its order, too many ones, too short ones."""
        totals = {}
        for name, receiver in self.receivers.items():
            row = [*receiver.counts, self.too_many.get(name, 0), self.too_short.get(name, 0)]
            if sum(row) > sum(row[status] for status in UNREMARKABLE):
                totals[name] = row
        return totals

    def summary(self) -> str:
        """All troubles, message by message, in one line; '' for none."""
        return "; ".join(f"{name} {in_words(row)}" for name, row in self.troubles().items())

    def _notice(self, tick: int, name: str, problem: str) -> None:
        if (name, problem) not in self._seen:
            self._seen.add((name, problem))
            self._new.append(Notice(tick, name, problem))


def in_words(row: Sequence[int]) -> str:
    """One message's counts (`Reception.troubles`): '2 repeated, 1 wrong CRC'."""
    kinds = [(row[status], status.words) for status in E2eStatus if status not in UNREMARKABLE]
    kinds += zip(row[len(E2eStatus) :], (TOO_MANY, TOO_SHORT), strict=False)  # older runs do not have the last
    return ", ".join(f"{count} {problem}" for count, problem in kinds if count)
