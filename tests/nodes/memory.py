"""Buses and time in memory for the tests of the nodes: no process, no socket, no waiting."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence
from typing import Any

from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus import bench_channel as bc


class FakeTime:
    """Stands in for the module `time`: moves only when somebody waits."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s

    def perf_counter(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


class FakeLink:
    """A Link of one thread: `arrive` puts frames in front of it, `sent` keeps what it sent, batch by batch.

    A wait without frames costs `clock` its whole time-out; `later` holds batches that arrive one at each such wait.
    """

    def __init__(self, clock: FakeTime | None = None) -> None:
        self.name = "fake"
        self.refused: Sequence[CanFrame] = ()
        self.clock = clock or FakeTime()
        self.waiting: list[CanFrame] = []
        self.later: list[list[CanFrame]] = []
        self.sent: list[list[CanFrame]] = []
        self.trouble: Exception | None = None

    def arrive(self, *frames: CanFrame) -> None:
        self.waiting += frames

    def say(self, *messages: Any, time_s: float = 0.0) -> None:
        """Bench messages in front of it."""
        self.waiting += [bc.encode(message)._replace(time_s=time_s) for message in messages]

    def send(self, frames: Sequence[CanFrame]) -> None:
        if self.trouble is not None:
            raise self.trouble
        self.sent.append(list(frames))

    def receive(self, timeout_s: float) -> list[CanFrame]:
        if self.trouble is not None:
            raise self.trouble
        if not self.waiting:
            self.clock.sleep(timeout_s)
            self.waiting = self.later.pop(0) if self.later else []
        found, self.waiting = self.waiting, []
        return found

    def close(self) -> None:
        pass

    def words(self) -> list[Any]:
        """All bench messages that were sent, in order."""
        return [bc.decode(frame) for frame in self.frames()]

    def frames(self) -> list[CanFrame]:
        """All frames that were sent, in order."""
        return [frame for batch in self.sent for frame in batch]


class MemoryBus:
    """One channel for threads: every member hears every other, in one order; `log` keeps all frames."""

    def __init__(self) -> None:
        self.members: list[MemoryLink] = []
        self.log: list[CanFrame] = []
        self.condition = threading.Condition()

    def link(self, name: str) -> MemoryLink:
        link = MemoryLink(self, name)
        self.members.append(link)
        return link

    def deliver(self, sender: MemoryLink, frames: Iterable[CanFrame]) -> None:
        with self.condition:
            batch = list(frames)
            self.log += batch
            for member in self.members:
                if member is not sender:
                    member.inbox += batch
            self.condition.notify_all()


class MemoryLink:
    """A Link to a MemoryBus."""

    refused: Sequence[CanFrame] = ()  # a memory is never full

    def __init__(self, bus: MemoryBus, name: str) -> None:
        self.bus = bus
        self.name = name
        self.inbox: list[CanFrame] = []

    def send(self, frames: Sequence[CanFrame]) -> None:
        self.bus.deliver(self, frames)

    def receive(self, timeout_s: float) -> list[CanFrame]:
        with self.bus.condition:
            self.bus.condition.wait_for(lambda: bool(self.inbox), timeout_s)
            found, self.inbox = self.inbox, []
        return found

    def close(self) -> None:
        pass
