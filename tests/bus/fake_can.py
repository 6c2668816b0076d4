"""A SocketCAN socket that is none: real file descriptors to wait on, and a kernel that does what a test says."""

from __future__ import annotations

import errno
import os
import socket
import struct
from collections import deque

from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.socketcan.kernel_frames import CLASSIC_FRAME, pack
from tunefree_hil.bus.socketcan.link import SO_MEMINFO, SO_RXQ_OVFL, SO_TIMESTAMPNS
from tunefree_hil.bus.tfhub.records import ERR_FLAG

STEP_NS = 1_000_000


class FakeSocket:
    """`arrive` puts bytes in its queue, `drop` loses frames, `fail` makes a receive raise; `sent` is what it took.

    `full`: how many sends find the transmit queue full. Stamps are 1 ms apart from 1 s on.
    """

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.full = 0
        self.send_error = 0
        self.memory_known = True
        self._mine, self._other = socket.socketpair()
        self._queue: deque[tuple[bytes, int] | int] = deque()
        self.drops = 0
        self._time_ns = 1_000_000_000

    def fileno(self) -> int:
        return self._mine.fileno()

    def arrive(self, *frames: CanFrame | bytes) -> None:
        for frame in frames:
            data = frame if isinstance(frame, bytes) else pack(frame)
            self._queue.append((data, self.drops))
            self._other.send(b"x")

    def drop(self, count: int) -> None:
        """Frames that find the queue full: known with the next that fits, or by SO_MEMINFO."""
        self.drops += count

    def fail(self, number: int) -> None:
        self._queue.append(number)
        self._other.send(b"x")

    def recvmsg(self, size: int, ancillary: int, flags: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, None]:
        if not self._queue:
            raise BlockingIOError
        self._mine.recv(1)
        item = self._queue.popleft()
        if isinstance(item, int):
            raise OSError(item, os.strerror(item))
        data, drops = item
        self._time_ns += STEP_NS
        stamp = struct.pack("@qq", *divmod(self._time_ns, 1_000_000_000))
        found = [(socket.SOL_SOCKET, SO_TIMESTAMPNS, stamp)]
        if drops:
            found.append((socket.SOL_SOCKET, SO_RXQ_OVFL, struct.pack("=I", drops & 0xFFFF_FFFF)))
        return data[:size], found, 0, None

    def send(self, data: bytes) -> int:
        if self.send_error:
            raise OSError(self.send_error, os.strerror(self.send_error))
        if self.full:
            self.full -= 1
            raise OSError(errno.ENOBUFS, os.strerror(errno.ENOBUFS))
        self.sent.append(data)
        return len(data)

    def getsockopt(self, level: int, name: int, size: int) -> bytes:
        if name != SO_MEMINFO or not self.memory_known:
            raise OSError(errno.ENOPROTOOPT, os.strerror(errno.ENOPROTOOPT))
        return struct.pack("=9I", *[0] * 8, self.drops & 0xFFFF_FFFF)

    def close(self) -> None:
        self._mine.close()
        self._other.close()


def error_frame(classes: int, state: int = 0) -> bytes:
    """An error frame as a driver makes it; `state`: data byte 1."""
    return CLASSIC_FRAME.pack(ERR_FLAG | classes, 8, bytes([0, state, 0, 0, 0, 0, 0, 0]))
