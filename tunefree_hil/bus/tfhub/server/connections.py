"""The connections of a hub, the bytes queued for each, and the back-pressure of members that do not read.

A member's queue only grows to HIGH_BYTES, because the hub then stops reading from the channel's senders (hub.py). An
observer's queue is a ring: the oldest is dropped and counted.
"""

from __future__ import annotations

import selectors
import socket
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from tunefree_hil.bus.tfhub.records import CHANNELS, DROPPED, mark_second_channel, pack_control, select_ids

READ, WRITE = selectors.EVENT_READ, selectors.EVENT_WRITE
KNOWN = 4  # bit of Peer.events: the board has the connection, even with no event to wait for


class Board:
    """The connections of one hub and their selector. `flush` writes the queues, once a wake-up and peer."""

    def __init__(self, observer_bytes: int) -> None:
        self.observer_bytes = observer_bytes
        self.peers: list[Peer] = []
        self.unidentified: list[Peer] = []  # those of them that have not sent HELLO
        self.listeners: dict[str, list[Peer]] = {channel: [] for channel in CHANNELS}
        self.blockers: dict[str, list[Peer]] = {channel: [] for channel in CHANNELS}  # members that do not keep up
        self.dirty: set[Peer] = set()
        self.selector = selectors.DefaultSelector()

    # --- coming and going ----------------------------------------------------------------------------------------

    def add(self, sock: socket.socket, channel: str, deadline_s: float) -> None:
        """Add a new connection, before its HELLO."""
        peer = Peer(sock, channel, deadline_s)
        self.peers.append(peer)
        self.unidentified.append(peer)
        self.watch(peer, READ)

    def admit(self, peer: Peer, welcome: bytes) -> None:
        """Admit a connection after its HELLO; it gets `welcome` first, then the frames of its channels."""
        self.unidentified.remove(peer)
        self.enqueue(peer, welcome)
        for channel in peer.channels:
            if peer.listen:
                self.listeners[channel].append(peer)
            if peer.role == "member":
                self.pause_senders(channel)

    def forget(self, peer: Peer) -> None:
        """Close a connection and remove all that belongs to it."""
        if peer.events & (READ | WRITE):
            self.selector.unregister(peer.sock)
        peer.events = 0
        peer.sock.close()
        self.peers.remove(peer)
        self.dirty.discard(peer)
        for group in (self.unidentified, *self.listeners.values()):
            if peer in group:
                group.remove(peer)
        self._release(peer)

    def watch(self, peer: Peer, events: int) -> None:
        """Have the selector report these events of a peer; 0: none, but the peer stays."""
        registered = peer.events & (READ | WRITE)
        if events == registered:
            return
        if not events:
            self.selector.unregister(peer.sock)
        elif registered:
            self.selector.modify(peer.sock, events, peer)
        else:
            self.selector.register(peer.sock, events, peer)
        peer.events = events | KNOWN

    # --- giving --------------------------------------------------------------------------------------------------

    def enqueue(self, peer: Peer, record: bytes) -> None:
        """Queue a record that is no frame for a peer."""
        peer.enqueue(record, 0)
        self.dirty.add(peer)

    def deliver(self, sender: Peer, channel: str, chunk: bytes, frames: int) -> None:
        """Queue frames for all others of a channel, and for the sender when it wants its echo."""
        for peer in self.listeners[channel]:
            if peer is sender and not peer.echo:
                continue
            if peer.only:
                selected = select_ids(chunk, frames, peer.only)
                if selected:
                    self._enqueue_frames(peer, channel, b"".join(selected), len(selected))
                continue
            self._enqueue_frames(peer, channel, chunk, frames)

    def _enqueue_frames(self, peer: Peer, channel: str, chunk: bytes, frames: int) -> None:
        """Queue frames of a channel for one peer; an observer has a ring, a member that falls behind blocks the bus."""
        if peer.role == "observer":
            peer.enqueue(chunk, frames, self.observer_bytes)
        else:
            peer.enqueue(chunk if peer.channel == channel else mark_second_channel(chunk, frames), frames)
            if peer.queued_bytes > HIGH_BYTES:
                self._block(peer)
        self.dirty.add(peer)

    def flush(self, failed: Callable[[Peer], None]) -> None:
        """Write the queues, as far as the sockets take it; `failed` gets each peer that cannot be written to."""
        dirty, self.dirty = self.dirty, set()
        for peer in dirty:
            if not peer.events:
                continue
            try:
                done = peer.flush()
            except OSError:
                failed(peer)
                continue
            if peer.queued_bytes < LOW_BYTES:
                self._release(peer)
            self.watch(peer, (0 if peer.paused else READ) | (0 if done else WRITE))

    # --- back-pressure -------------------------------------------------------------------------------------------

    def _block(self, member: Peer) -> None:
        """A member does not keep up: read from no sender of its channels until it does."""
        for channel in member.channels:
            if member not in self.blockers[channel]:
                self.blockers[channel].append(member)
                self.pause_senders(channel)

    def _release(self, member: Peer) -> None:
        """The member keeps up again, or is gone."""
        for channel in member.channels:
            if member in self.blockers[channel]:
                self.blockers[channel].remove(member)
                self.pause_senders(channel)

    def pause_senders(self, channel: str) -> None:
        """Read from the members of a channel exactly when no member blocks one of their channels."""
        for peer in self.peers:
            if peer.role == "member" and channel in peer.channels:
                is_held = any(self.blockers[one] for one in peer.channels)
                peer.paused = is_held
                self.watch(peer, (0 if is_held else READ) | (peer.events & WRITE))


HIGH_BYTES = 1 << 20  # a member's queue that stops its channel's senders
LOW_BYTES = 1 << 18  # below this they are read again
OBSERVER_BYTES = 1 << 20  # largest queue of an observer
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
    also: str = ""  # the other channel, where this connection carries both (records.SECOND_FRAME)
    only: frozenset[int] = frozenset()  # gets only frames with one of these ids; empty: all
    stamps: bool = False
    loss_announced: bool = False  # its process's loss has been announced
    rest: bytes = b""  # the beginning of an incomplete record
    sent: int = 0
    dropped: int = 0
    dropped_reported: int = 0
    queued_bytes: int = 0  # bytes in the queue
    queue: deque[tuple[bytes | memoryview, int]] = field(default_factory=deque)
    begun: bool = False  # the queue's first chunk is partly written
    events: int = 0  # as registered with the selector
    paused: bool = False  # not read from, because a member blocks the bus

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that it is on."""
        return (self.channel, self.also) if self.also else (self.channel,)

    def enqueue(self, chunk: bytes, frames: int, ring_bytes: int = 0) -> None:
        """Queue `chunk`. With ring_bytes the oldest frames make room, and are counted in `dropped`."""
        self.queue.append((chunk, frames))
        self.queued_bytes += len(chunk)
        if ring_bytes and self.queued_bytes > ring_bytes:
            self._make_room(ring_bytes)

    def _make_room(self, ring_bytes: int) -> None:
        unfinished = [self.queue.popleft()] if self.begun else []
        while self.queue and self.queued_bytes > ring_bytes:
            chunk, frames = self.queue.popleft()
            self.queued_bytes -= len(chunk)
            self.dropped += frames
            if not frames:  # it was a notice of earlier drops: send a new one
                self.dropped_reported = -1
        self.queue.extendleft(unfinished)

    def flush(self) -> bool:
        """Write what the socket takes. True when nothing is left. OSError when the peer is gone."""
        queue = self.queue
        while True:
            if self.dropped != self.dropped_reported and not self.begun:
                self._queue_drop_notice()
            if not queue:
                return True
            batch = queue[0][0] if len(queue) == 1 or self.begun else self._join()
            try:
                written = self.sock.send(batch)
            except BlockingIOError:
                return False
            self.queued_bytes -= written
            if written < len(batch):
                queue[0] = (memoryview(batch)[written:], queue[0][1])
                self.begun = True
                return False
            queue.popleft()
            self.begun = False

    def _queue_drop_notice(self) -> None:
        notice = pack_control(DROPPED, sequence=self.dropped)
        self.queue.appendleft((notice, 0))
        self.queued_bytes += len(notice)
        self.dropped_reported = self.dropped

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
