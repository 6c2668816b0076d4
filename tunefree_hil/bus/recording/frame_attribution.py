"""Sender and tick of recorded frames on SocketCAN (docs/reference/bench_channel.md); a hub knows both.

SocketCAN shows no sender and carries no virtual time. So ids of commands count as the controller's (phase 1), the
vehicle's other ids as the ECU's (phase 0), and DONE(k, phase, n_tx, digest) on the bench channel claims the next n_tx
frames of its phase, in order of arrival. So the two channels, read from two sockets, may be interleaved in any way. The
digest shows whether the claimed frames are the announced ones: where they are not, another node sends these ids.

In lockstep a claimed frame is stamped k ticks; an unclaimed one keeps its place in the log, with the tick of the
frame before it. In real time stamps are the kernel's own and nothing waits for its claim.
"""

from __future__ import annotations

import zlib
from collections import deque
from collections.abc import Callable, Collection, Iterable
from typing import NamedTuple

from tunefree_hil.base.errors import BenchError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.dbc.message_map import EXTENDED_FLAG
from tunefree_hil.bus.tfhub.records import EFF_FLAG, EFF_MASK, ERR_FLAG, RTR_FLAG, Raw

PHASE_ROLES = ("ecu", "controller")


def can_key(frame: CanFrame) -> int:
    """SocketCAN's can_id. Order of simultaneous frames too: a stable sort keeps the sequence within an id."""
    return frame.id | EXTENDED_FLAG if frame.extended else frame.id


def digest(frames: Iterable[CanFrame]) -> int:
    """16-bit check of a phase's frames, in (id, sequence) order (DONE, docs/reference/bench_channel.md)."""
    crc = 0
    for frame in frames:
        crc = zlib.crc32(frame.data, zlib.crc32(frame.id.to_bytes(4, "little"), crc))
    return crc & 0xFFFF


class _Entry:
    """A vehicle frame on its way to the log. `phase` -1 for a frame with another id."""

    __slots__ = ("k", "phase", "raw")

    def __init__(self, raw: Raw, phase: int) -> None:
        self.raw = raw
        self.phase = phase
        self.k = -1


class MissingFrames(NamedTuple):
    """The announced frames of a phase that have not arrived; count 0: none."""

    tick: int
    sender: str
    count: int


class Ledger:
    """One episode. `write(frame)` gets the vehicle's frames, stamped, in the order in which they arrived.

    `foreign` (id -> count) and `remote` count other frames; they, and error frames, are written too.
    """

    def __init__(
        self, ids_of_phase: tuple[Collection[int], Collection[int]], tick_ns: int, write: Callable[[Raw], None]
    ) -> None:
        self.foreign: dict[int, int] = {}
        self.remote = 0
        self.tick = 0  # of the latest TICK or DONE
        self.ended = False  # the ECU has announced the end
        self.claiming = True  # False once frames were lost: then the others have no certain tick
        self._phase_of = {key: phase for phase, ids in enumerate(ids_of_phase) for key in ids}
        self._tick_ns = tick_ns  # 0 in real time
        self._write = write
        self._waiting: deque[_Entry] = deque()  # not yet written, in order of arrival
        self._unclaimed: tuple[deque[_Entry], deque[_Entry]] = (deque(), deque())
        self._dones: tuple[deque[bc.Done], deque[bc.Done]] = (deque(), deque())
        self._last_ns = 0

    def vehicle(self, raw: Raw) -> None:
        """A frame of the vehicle channel has arrived. BenchError when it shows a foreign sender."""
        phase = self._count(raw)
        entry = _Entry(raw, phase)
        if phase >= 0:
            self._unclaimed[phase].append(entry)
        if self._tick_ns:
            self._waiting.append(entry)
        else:
            self._write(raw)
        if phase >= 0:
            self._claim(phase)
        self._hand_over()

    def bench(self, message: object) -> None:
        """A message of the bench channel has arrived. BenchError when it shows a foreign sender of vehicle frames."""
        if isinstance(message, bc.Tick):
            self.tick = message.k
        elif isinstance(message, bc.Done):
            self.tick = message.k
            if message.phase in (0, 1):
                self._dones[message.phase].append(message)
                self._claim(message.phase)
                self._hand_over()
        elif isinstance(message, bc.Status) and message.role == bc.Role.ECU:
            self.ended = self.ended or message.state in (bc.State.FINISHED, bc.State.FAILED)

    @property
    def settled(self) -> bool:
        """The drive is over and every announced frame has arrived."""
        return self.ended and not any(self._dones)

    def missing(self) -> MissingFrames:
        """The first announced frames that have not arrived."""
        for phase, dones in enumerate(self._dones):
            if dones:
                return MissingFrames(dones[0].k, PHASE_ROLES[phase], dones[0].n_tx - len(self._unclaimed[phase]))
        return MissingFrames(0, "", 0)

    def finish(self) -> None:
        """Write the frames that still wait for a claim."""
        while self._waiting:
            self._put(self._waiting.popleft())

    def _count(self, raw: Raw) -> int:
        """Phase of a frame, -1 for others; those with another id and remote ones are counted."""
        if raw.can_id & ERR_FLAG:
            return -1
        key = raw.can_id & (EFF_FLAG | EFF_MASK)
        if raw.can_id & RTR_FLAG:
            self.remote += 1
            return -1
        phase = self._phase_of.get(key, -1)
        if phase < 0:
            self.foreign[key] = self.foreign.get(key, 0) + 1
        return phase

    def _claim(self, phase: int) -> None:
        dones, unclaimed = self._dones[phase], self._unclaimed[phase]
        while self.claiming and dones and len(unclaimed) >= dones[0].n_tx:
            done = dones.popleft()
            claimed = [unclaimed.popleft() for _ in range(done.n_tx)]
            for entry in claimed:
                entry.k = done.k
            frames = [entry.raw.data_frame() for entry in claimed]
            frames.sort(key=can_key)
            if digest(frames) != done.digest:
                raise self._foreign_sender(done, frames)

    def _foreign_sender(self, done: bc.Done, frames: list[CanFrame]) -> BenchError:
        ids = ", ".join(dict.fromkeys(f"0x{frame.id:03X}" for frame in frames))
        word = "commander" if done.phase else "reporter"
        return BenchError(
            f"foreign {word} at tick {done.k}: the frames that came with ids of the {PHASE_ROLES[done.phase]} ({ids}) "
            "are not those that it announced, so another node sends them on this bus",
            code=f"foreign_{word}",
            hint="end the other controller, player or vehicle on this link; SocketCAN does not show which it is",
        )

    def _hand_over(self) -> None:
        waiting = self._waiting
        if not self.claiming:
            self.finish()
        while waiting and (waiting[0].k >= 0 or waiting[0].phase < 0):
            self._put(waiting.popleft())

    def _put(self, entry: _Entry) -> None:
        if entry.k >= 0:
            self._last_ns = entry.k * self._tick_ns
        self._write(entry.raw._replace(time_ns=self._last_ns))
