"""A link of the kernel's SocketCAN, such as vcan0.

python-can opens the socket and sets its options; reading and sending are ours, because python-can reads one frame with
two system calls, has no drop counter and raises ENOBUFS at once.

- Stamps are the kernel's own, CLOCK_REALTIME in ns, made when the frame passed the link.
- SO_RXQ_OVFL and SO_MEMINFO give the exact number of frames that did not fit this socket's queue; they are never lost
  silently: `receive` raises rx_overflow with the number.
- A full transmit queue (ENOBUFS, EAGAIN) is retried for `patience_s`. In lockstep there is no deadline, so that is the
  hard limit and then an error. In real time it is half a period for reports and 0 for commands; frames not taken are
  dropped and counted in `refused`: a late command is worse than none.
- A socket does not receive its own frames; every other socket of the machine does.
"""

from __future__ import annotations

import errno
import select
import socket
import struct
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.error_frames import note_error
from tunefree_hil.bus.python_can import can
from tunefree_hil.bus.socketcan.kernel_frames import FD_FRAME, pack, pack_filters, unpack
from tunefree_hil.bus.tfhub.records import EFF_MASK, ERR_FLAG, NO_DATA, Raw

STAMP = struct.Struct("@qq")  # struct timespec
COUNT = struct.Struct("=I")
SO_TIMESTAMPNS, SO_RXQ_OVFL, SO_RCVBUFFORCE, SO_MEMINFO = 35, 40, 33, 55  # asm-generic/socket.h
DROPS_AT, MEMINFO_BYTES = 8, 36  # linux/sock_diag.h: SK_MEMINFO_DROPS of nine u32
COUNTER_MASK = 0xFFFF_FFFF
ANCILLARY = 128
QUEUE_BYTES = 16 << 20  # about 20 000 frames; without root the kernel gives at most net.core.rmem_max
MOST_AT_ONCE = 512  # frames of one receive: in a flood its reader can do other work in between
RETRY_S = 0.0002
LOOK_S = 1.0  # how often a node without a hub checks that the process that started it is there
MOST_FILTERS = 512  # linux/can/raw.h: CAN_RAW_FILTER_MAX
FULL = (errno.ENOBUFS, errno.EAGAIN)
DOWN = {errno.ENETDOWN: "went down", errno.ENXIO: "is gone", errno.ENODEV: "is gone", errno.EIO: "is gone"}


class Options(NamedTuple):
    """How a link is opened. `only`: ids (EFF bit included) the kernel lets through, () for all. `alive`: see LOOK_S."""

    may_send: bool = True
    fd: bool = False
    patience_s: float = 5.0  # how long a full transmit queue is retried
    drops: bool = False  # frames not taken by then are dropped and kept in `refused`, else it is an error
    only: Sequence[int] = ()
    alive: Callable[[], bool] | None = None


class SocketCanLink:
    """A BusLink (link.py) over one SocketCAN interface; `receive_raw` is for the recorder, which reads all frames."""

    def __init__(
        self,
        sock: Any,
        interface: str,
        name: str,
        options: Options = Options(),  # noqa: B008
        close: Callable[[], None] | None = None,
    ) -> None:
        self.name = name
        self.interface = interface
        self.errors: Counter[str] = Counter()
        self.lost = 0  # frames that did not fit this socket's queue, since it was opened
        self.refused: Sequence[CanFrame] = ()
        self._sock = sock
        self._options = options
        self._close = close or sock.close
        self._reported_lost = 0
        self._looked_s = time.monotonic()
        self._poll = select.poll()
        self._poll.register(sock.fileno(), select.POLLIN)

    def fileno(self) -> int:
        """The socket, to wait on."""
        return self._sock.fileno()

    # --- sending -------------------------------------------------------------------------------------------------

    def send(self, frames: Sequence[CanFrame]) -> None:
        """See BusLink; the policy for a full queue stands at the top of this file."""
        if not self._options.may_send:
            raise InputError(f"{self.name} only listens to {self.interface}", code="observer", key="role")
        limit_s = 0.0
        for i, frame in enumerate(frames):
            data = pack(frame)
            while not self._taken(data):
                now_s = time.monotonic()
                limit_s = limit_s or now_s + self._options.patience_s
                if now_s >= limit_s:
                    self._give_up(frames[i:])
                    return
                time.sleep(RETRY_S)
        self.refused = ()

    def _taken(self, data: bytes) -> bool:
        """False while the transmit queue is full."""
        try:
            self._sock.send(data)
        except OSError as error:
            if error.errno in FULL:
                return False
            raise self._explain(error) from error
        return True

    def _give_up(self, frames: Sequence[CanFrame]) -> None:
        self.refused = tuple(frames)
        if self._options.drops:
            return
        raise BenchError(
            f"{self.interface} took no frame for {self._options.patience_s:g} s: its transmit queue is full (ENOBUFS)",
            code="tx_full",
            hint=f"sudo ip link set {self.interface} txqueuelen 1000; does another node acknowledge on this bus?",
        )

    # --- receiving -----------------------------------------------------------------------------------------------

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """See BusLink. BenchError: rx_overflow with the number of lost frames, link_down, bus_off, starter_gone."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            frames = self._data_frames(self.receive_raw(timeout_s))
            self.require_all()
            if frames or timeout_s <= 0.0:
                return frames
            timeout_s = max(0.0, deadline_s - time.monotonic())

    def receive_raw(self, timeout_s: float) -> list[Raw]:
        """Everything that has arrived, error and remote frames too; stamps are CLOCK_REALTIME in ns. Counts losses."""
        self._require_starter()
        if not self._poll.poll(max(0.0, timeout_s) * 1e3):
            return []
        frames: list[Raw] = []
        recvmsg = self._sock.recvmsg
        try:
            while len(frames) < MOST_AT_ONCE:
                data, ancillary, _, _ = recvmsg(FD_FRAME.size, ANCILLARY, socket.MSG_DONTWAIT)
                frames.append(unpack(data, self._note(ancillary)))
        except BlockingIOError:
            pass
        except OSError as error:
            raise self._explain(error) from error
        return frames

    def require_all(self) -> None:
        """Raise BenchError with the number of frames that were lost since the last call."""
        lost, self._reported_lost = self.lost - self._reported_lost, self.lost
        if lost:
            raise overflow(self.interface, self.name, lost)

    def count_lost(self) -> int:
        """The exact number of frames lost so far, those behind the last one received too."""
        with suppress(OSError):  # a kernel before 4.12 has no SO_MEMINFO: then it is known with the next frame
            memory = self._sock.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMINFO_BYTES)
            self._count(COUNT.unpack_from(memory, DROPS_AT * COUNT.size)[0])
        return self.lost

    def forgive(self) -> None:
        """Do not report the losses so far: they belong to no episode."""
        self._reported_lost = self.count_lost()

    def close(self) -> None:
        """See BusLink."""
        self._close()

    def _note(self, ancillary: Sequence[tuple[int, int, bytes]]) -> int:
        """The kernel's stamp in ns; a drop counter that comes with it is kept."""
        time_ns = 0
        for _, kind, data in ancillary:
            if kind == SO_TIMESTAMPNS:
                seconds, rest_ns = STAMP.unpack_from(data)
                time_ns = seconds * 1_000_000_000 + rest_ns
            elif kind == SO_RXQ_OVFL:
                self._count(COUNT.unpack_from(data)[0])
        return time_ns

    def _count(self, drops: int) -> None:
        """Follow the kernel's counter of 32 bits. A frame that waited carries an older count, which is ignored."""
        news = (drops - self.lost) & COUNTER_MASK
        if news <= COUNTER_MASK >> 1:
            self.lost += news

    def _data_frames(self, raws: Sequence[Raw]) -> list[CanFrame]:
        """Data frames with CLOCK_MONOTONIC stamps; error frames are counted. BenchError bus_off."""
        frames = []
        offset_ns = realtime_offset_ns() if raws else 0
        for raw in raws:
            if not raw.can_id & NO_DATA:
                frames.append(raw._replace(time_ns=raw.time_ns - offset_ns).data_frame())
            elif raw.can_id & ERR_FLAG:
                note_error(self.errors, raw.can_id & EFF_MASK, raw.data, self.interface)
        return frames

    def _require_starter(self) -> None:
        now_s = time.monotonic()
        if self._options.alive is None or now_s - self._looked_s < LOOK_S:
            return
        self._looked_s = now_s
        if not self._options.alive():
            raise BenchError("the process that started this node is gone", code="starter_gone")

    def _explain(self, error: OSError) -> BenchError:
        name = self.interface
        problem = DOWN.get(error.errno or 0)
        if problem:
            hint = f"sudo ip link set up {name}; then the same command again"
            return BenchError(f"{name} {problem}", code="link_down", hint=hint)
        if error.errno == errno.EINVAL:
            return BenchError(f"{name} does not carry such a frame: CAN FD needs mtu 72", code="bus_error")
        return BenchError(f"{name}: {error.strerror}", code="bus_error")


def open_socketcan(interface: str, name: str, options: Options = Options()) -> SocketCanLink:  # noqa: B008
    """Open one interface that is there and up. BenchError where the kernel refuses."""
    try:
        bus = can.Bus(interface, interface="socketcan", fd=options.fd, ignore_config=True)
    except (can.CanError, OSError) as error:
        raise BenchError(f"socketcan:{interface} does not open: {error}", code="bus_error") from error
    sock: socket.socket = bus.socket  # type: ignore[attr-defined]
    try:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        _enlarge(sock)
        if 0 < len(options.only) <= MOST_FILTERS:
            sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, pack_filters(options.only))
    except OSError as error:
        bus.shutdown()
        raise BenchError(f"socketcan:{interface} does not open: {error}", code="bus_error") from error
    return SocketCanLink(sock, interface, name, options, bus.shutdown)


def _enlarge(sock: socket.socket) -> None:
    """The largest receive queue that this user may have."""
    try:
        sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, QUEUE_BYTES)
    except PermissionError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, QUEUE_BYTES)


def overflow(interface: str, receiver: str, lost: int) -> BenchError:
    """The error for frames that did not fit a receive queue."""
    return BenchError(
        f"{lost} frame{'' if lost == 1 else 's'} of {interface} did not fit the receive queue of {receiver} "
        "and were lost",
        code="rx_overflow",
        hint="does another program flood this link (candump)? more room: sudo sysctl net.core.rmem_max=16777216",
    )


def realtime_offset_ns() -> int:
    """CLOCK_REALTIME - CLOCK_MONOTONIC: the kernel stamps with the first, nodes use the second.

    Measured at each call, so that a step of the wall clock moves no more than the frames that wait at that moment;
    the narrowest of three measurements, so that an interruption between the two clocks does not move it.
    """
    best_ns, offset_ns = 1 << 62, 0
    for _ in range(3):
        before_ns = time.monotonic_ns()
        real_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
        after_ns = time.monotonic_ns()
        if after_ns - before_ns < best_ns:
            best_ns, offset_ns = after_ns - before_ns, real_ns - (before_ns + after_ns) // 2
    return offset_ns
