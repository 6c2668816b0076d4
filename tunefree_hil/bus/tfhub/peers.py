"""One connection as the hub sees it: who it is, what it still has to be given, and what happens when it does not read.

A member's queue only grows to HIGH_BYTES, because the hub then stops reading from the channel's senders (hub.py). An
observer's queue is a ring: the oldest is dropped and counted.
"""

from __future__ import annotations

import socket
from collections import deque
from dataclasses import dataclass, field

from tunefree_hil.bus.tfhub.records import DROPPED, pack_control

HIGH_BYTES = 1 << 20  # a member that is owed this much stops its channel's senders
LOW_BYTES = 1 << 18  # and lets them go on from here
OBSERVER_BYTES = 1 << 20  # an observer is owed at most this
WRITE_BYTES = 1 << 18  # at most this much is joined into one write


@dataclass(slots=True, eq=False)
class Peer:
    """A connection. `role` is '' until its hello; `queue` holds (bytes, number of frames in them)."""

    sock: socket.socket
    channel: str
    deadline_s: float  # of its hello, monotonic
    role: str = ""
    name: str = "?"
    pid: int = 0
    index: int = 0
    echo: bool = False  # gets its own frames back
    listen: bool = True
    also: str = ""  # the other channel, where this connection carries both (records.OTHER)
    only: frozenset[int] = frozenset()  # gets only frames with one of these ids; empty: all
    stamps: bool = False
    mourned: bool = False  # its process's loss has been announced
    rest: bytes = b""  # the beginning of a record whose end has not come yet
    sent: int = 0
    dropped: int = 0
    dropped_told: int = 0
    owed: int = 0  # bytes in the queue
    queue: deque[tuple[bytes | memoryview, int]] = field(default_factory=deque)
    begun: bool = False  # the queue's first chunk is partly written
    events: int = 0  # as registered with the selector
    paused: bool = False  # not read from, because a member holds the bus

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that it is on."""
        return (self.channel, self.also) if self.also else (self.channel,)

    def give(self, chunk: bytes, frames: int, ring_bytes: int = 0) -> None:
        """Owe it `chunk`. With ring_bytes the oldest frames make room, and are counted in `dropped`."""
        self.queue.append((chunk, frames))
        self.owed += len(chunk)
        if ring_bytes and self.owed > ring_bytes:
            self._make_room(ring_bytes)

    def _make_room(self, ring_bytes: int) -> None:
        kept = [self.queue.popleft()] if self.begun else []
        while self.queue and self.owed > ring_bytes:
            chunk, frames = self.queue.popleft()
            self.owed -= len(chunk)
            self.dropped += frames
            if not frames:  # it was a notice of earlier drops: tell again
                self.dropped_told = -1
        self.queue.extendleft(kept)

    def flush(self) -> bool:
        """Write what the socket takes. True when nothing is left. OSError when the peer is gone."""
        queue = self.queue
        while True:
            if self.dropped != self.dropped_told and not self.begun:
                self._tell_drops()
            if not queue:
                return True
            batch = queue[0][0] if len(queue) == 1 or self.begun else self._join()
            try:
                written = self.sock.send(batch)
            except BlockingIOError:
                return False
            self.owed -= written
            if written < len(batch):
                queue[0] = (memoryview(batch)[written:], queue[0][1])
                self.begun = True
                return False
            queue.popleft()
            self.begun = False

    def _tell_drops(self) -> None:
        notice = pack_control(DROPPED, sequence=self.dropped)
        self.queue.appendleft((notice, 0))
        self.owed += len(notice)
        self.dropped_told = self.dropped

    def _join(self) -> bytes:
        """Make the first chunks of the queue one, up to WRITE_BYTES; its bytes."""
        parts, frames, size = [], 0, 0
        while self.queue and size < WRITE_BYTES:
            chunk, count = self.queue.popleft()
            parts.append(chunk)
            frames += count
            size += len(chunk)
        batch = b"".join(parts)
        self.queue.appendleft((batch, frames))
        return batch
