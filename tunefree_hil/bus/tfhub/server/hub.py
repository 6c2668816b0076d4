"""The hub: one thread that gives every frame its number and its stamp and hands it to all others, in one order.

Hot path: one read takes many records; they are checked and stamped where they lie, and the same bytes object goes to
every receiver, one write each a wake-up. Nothing is formatted there; the log becomes text in idle moments.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple

from tunefree_hil.bus.tfhub import reception
from tunefree_hil.bus.tfhub.address import DEFAULT_TRANSPORT, Transport
from tunefree_hil.bus.tfhub.records import (
    BYE,
    CHANNELS,
    CLASSIC,
    END,
    FD,
    FRAME,
    HEAD,
    HELLO,
    KIND_AT,
    LEN_AT,
    LOG_NAMES,
    NUMBER,
    REQUEST,
    SECOND_FRAME,
    STAMP,
    STAMP_AT,
    TIME_AT,
    RecordError,
    body_of,
    pack_control,
)
from tunefree_hil.bus.tfhub.server import control
from tunefree_hil.bus.tfhub.server.connections import OBSERVER_BYTES, READ, WRITE, Board, Peer
from tunefree_hil.bus.tfhub.server.log import CandumpLog
from tunefree_hil.bus.tfhub.server.sender_check import VEHICLE, SenderCheck
from tunefree_hil.bus.tfhub.session import Session

HubClock = Literal["real", "sender"]
READ_BYTES = 1 << 16
LOG_SLICE = 96  # frames made into log text at a time, when that many wait and nothing else is to do: about 100 us
BUSY_LIMIT = 4096  # frames that may wait for that while the hub is never idle
LONGEST_CONTROL = 1 << 14
SIZE_KIND = struct.Struct("<HB")
TIME = struct.Struct("<Q")


class HubOptions(NamedTuple):
    """How a hub runs.

    clock: 'real': stamps are CLOCK_MONOTONIC. 'sender': members that asked for it in HELLO stamp their own frames
    (virtual time), all others get the latest of these.
    """

    transport: Transport = DEFAULT_TRANSPORT
    clock: HubClock = "real"
    standalone: bool = False  # it does not end with its owner
    log_names: Mapping[str, str] = LOG_NAMES  # channel -> its name in a log
    observer_bytes: int = OBSERVER_BYTES


class _Run(NamedTuple):
    """Consecutive FRAME (or SECOND_FRAME) records in the buffer: where they begin, where the last of them does."""

    kind: int
    first: int
    last: int
    end: int
    count: int


class Hub:
    """Routes two channels until `stop` is called, or (unless standalone) until its owner is gone.

    `note` gets messages for the user, one a line.
    """

    def __init__(
        self,
        session: Session,
        options: HubOptions,
        epoch_offset_ns: int = 0,
        note: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.session = session
        self.standalone = options.standalone
        self.log_names = {**LOG_NAMES, **options.log_names}
        self.board = Board(options.observer_bytes)
        self.sender_clock = session.info.clock == "sender"
        self.epoch_offset_ns = 0 if self.sender_clock else epoch_offset_ns
        self.note = note
        self.frames = {str(channel): 0 for channel in CHANNELS}
        self.sequence = 0
        self.logs: dict[str, CandumpLog] = {}
        self.lost: deque[str] = deque(maxlen=100)
        self.sender_check = SenderCheck()
        self.ended = ""
        self.owner_deadline_s = 0.0 if options.standalone else time.monotonic() + reception.OWNER_PATIENCE_S
        self._time_ns = 0  # latest virtual time
        self._buffer = bytearray(2 * READ_BYTES)
        self._view = memoryview(self._buffer)
        self._requests: list[tuple[Peer, bytes]] = []
        self._waker, self._woken = socket.socketpair()
        self.board.selector.register(self._woken, READ, None)
        for channel, listener in session.listeners.items():
            self.board.selector.register(listener, READ, channel)

    def stop(self, reason: str) -> None:
        """End `run` soon; from a signal handler or another thread too."""
        self.ended = self.ended or reason
        self._waker.send(b"x")

    def run(self) -> None:
        """Route until the end; then close everything."""
        try:
            while not self.ended:
                self._turn()
        finally:
            self._close()

    # --- one wake-up ---------------------------------------------------------------------------------------------

    def _turn(self) -> None:
        waiting = sum([log.waiting for log in self.logs.values()]) if self.logs else 0
        write_log = waiting >= LOG_SLICE
        ready = self.board.selector.select(0.0 if write_log else reception.patience_s(self))
        for key, mask in ready:
            peer = key.data
            if type(peer) is Peer:
                if mask & READ and peer.events & READ:
                    self._read(peer)
                if mask & WRITE:
                    self.board.dirty.add(peer)
            elif peer is None:
                self._woken.recv(16)
            else:
                reception.accept(self, key.fileobj, peer)  # type: ignore[arg-type]
        if self._requests:  # after all that was sent before them
            self._answer()
        while self.board.dirty:
            self.board.flush(self._write_failed)
        if write_log and (not ready or waiting > BUSY_LIMIT):
            for log in self.logs.values():
                log.work(max(LOG_SLICE, log.waiting - BUSY_LIMIT))
        reception.enforce_deadlines(self)

    def _read(self, peer: Peer) -> None:
        """Take what a peer has sent; a peer that sends bytes that are no records is dropped."""
        start = len(peer.rest)
        if start:
            self._view[:start] = peer.rest
        try:
            got = peer.sock.recv_into(self._view[start:], READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            reception.lose(self, peer, error.strerror or "connection lost")
            return
        if not got:
            reception.lose(self, peer, "its connection closed without BYE")
            return
        end = start + got
        try:
            used = self._take(peer, end)
        except RecordError as error:
            reception.drop(self, peer, str(error))
            return
        peer.rest = bytes(self._view[used:end]) if used < end else b""

    def _take(self, peer: Peer, end: int) -> int:
        """Check, number, stamp and route the records in the buffer up to `end`. Returns the number of bytes used."""
        buffer, index, sequence = self._buffer, peer.index, self.sequence
        own_stamps = self.sender_clock and peer.stamps
        time_ns = self._time_ns if self.sender_clock else time.monotonic_ns()
        offset = first = last = count = 0
        run = FRAME  # what the frames from `first` on are: of the peer's own channel, or SECOND_FRAME
        while end - offset >= SIZE_KIND.size:
            size, kind = SIZE_KIND.unpack_from(buffer, offset)
            if kind != run and (kind == FRAME or (kind == SECOND_FRAME and peer.also)):
                self._route(peer, _Run(run, first, last, offset, count))
                run, first, count, sequence = kind, offset, 0, self.sequence
            if kind != run:
                self._route(peer, _Run(run, first, last, offset, count))
                if not self._take_control(peer, offset, end):
                    return offset
                if not peer.events:
                    return end
                first = offset = offset + size
                index, count, sequence = peer.index, 0, self.sequence
                own_stamps = self.sender_clock and peer.stamps
                continue
            if size != CLASSIC.size and size != FD.size:
                self._route(peer, _Run(run, first, last, offset, count))
                raise RecordError("it sent bytes that are no records")
            if end - offset < size:
                break
            if buffer[offset + LEN_AT] > (8 if size == CLASSIC.size else 64):
                self._route(peer, _Run(run, first, last, offset, count))
                raise RecordError("it sent a frame that is too long")
            sequence += 1
            buffer[offset + KIND_AT] = FRAME
            if own_stamps:
                NUMBER.pack_into(buffer, offset + STAMP_AT, index, sequence)
            else:
                STAMP.pack_into(buffer, offset + STAMP_AT, index, sequence, time_ns)
            last, offset, count = offset, offset + size, count + 1
        self._route(peer, _Run(run, first, last, offset, count))
        return offset

    def _take_control(self, peer: Peer, offset: int, end: int) -> bool:
        """Act on the control record at `offset`; False where it is not whole yet."""
        size, kind = SIZE_KIND.unpack_from(self._buffer, offset)
        _check_control(peer, kind, size)
        if end - offset < size:
            return False
        self._control(peer, kind, bytes(self._view[offset : offset + size]))
        return True

    def _route(self, peer: Peer, run: _Run) -> None:
        """Queue stamped frames to all others of their channel."""
        if not run.count:
            return
        if peer.role != "member":
            raise RecordError(f"it sent frames as {peer.role or 'an unidentified peer'}")
        chunk = bytes(self._view[run.first : run.end])
        channel = peer.channel if run.kind == FRAME else peer.also
        self.sequence += run.count
        self.frames[channel] += run.count
        peer.sent += run.count
        if self.sender_clock and peer.stamps:
            self._time_ns = TIME.unpack_from(self._buffer, run.last + TIME_AT)[0]
        if self.sender_check.ids and channel == VEHICLE:
            self.sender_check.watch(self.board.peers, peer, chunk)
        self.board.deliver(peer, channel, chunk, run.count)
        log = self.logs.get(channel)
        if log is not None:
            log.add(chunk, run.count)

    def _control(self, peer: Peer, kind: int, record: bytes) -> None:
        """Act on a record that is no frame and that the peer may send."""
        if kind == HELLO:
            reception.hello(self, peer, body_of(record))
        elif kind == BYE:
            reception.farewell(self, peer)
        else:
            self._requests.append((peer, record))

    def _answer(self) -> None:
        requests, self._requests = self._requests, []
        for peer, record in requests:
            try:
                reply = control.answer(self, body_of(record))
            except RecordError as error:
                reception.drop(self, peer, str(error))
                continue
            self.board.enqueue(peer, reply)

    # --- the end -------------------------------------------------------------------------------------------------

    def _write_failed(self, peer: Peer) -> None:
        self._read(peer)  # it may have sent BYE before it closed
        if peer.events:
            reception.lose(self, peer, "its connection closed without BYE")

    def _close(self) -> None:
        for log in self.logs.values():
            log.abandon()
        for peer in list(self.board.peers):
            peer.enqueue(pack_control(END, {"why": self.ended or "it failed"}), 0)
            with contextlib.suppress(OSError):  # it is gone already
                peer.flush()
            self.board.forget(peer)
        self.board.selector.close()
        self._waker.close()
        self._woken.close()
        self.session.close()


def _check_control(peer: Peer, kind: int, size: int) -> None:
    """RecordError, before the rest of it is waited for, unless the peer may send such a record now."""
    if kind not in (HELLO, BYE, REQUEST) or not HEAD.size <= size <= (HEAD.size if kind == BYE else LONGEST_CONTROL):
        raise RecordError("it sent bytes that are no records")
    allowed = {"": (HELLO,), "owner": (BYE, REQUEST)}.get(peer.role, (BYE,))
    if kind not in allowed:
        raise RecordError("it sent a record that it may not send")
