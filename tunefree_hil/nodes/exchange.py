"""Exchanges frames between nodes: phases in lockstep, deadlines in real time (docs/reference/bench_channel.md).

A node holds two links: `vehicle` carries the frames of the DBC, `bench` carries TICK, DONE, STATUS and the like.
A phase ends when the DONE that announces it *and* the n_tx frames it announced have arrived; the frames are then handed
over in (id, sequence) order. Waiting has a hard limit and names the missing node.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from operator import itemgetter
from typing import Any

from tunefree_hil.base.errors import BenchError, NoAnswer, PeerGone
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.dbc.message_map import EXTENDED_FLAG
from tunefree_hil.bus.link import Links, Sending
from tunefree_hil.bus.recording.frame_attribution import PHASE_ROLES, can_key, digest

HARD_LIMIT_S = 5.0
SLICE_S = 0.5  # how often a waiting node looks at the other link: a lost peer is announced on both


class Exchange:
    """Both links of one node. `ids_of_phase`: (ids of the reports, ids of the commands), SocketCAN ids.

    `drops`: the vehicle's link may leave frames unsent (SocketCAN in real time), so DONE announces what was taken.
    """

    def __init__(
        self,
        links: Links,
        ids_of_phase: Sequence[frozenset[int]],
        tick_s: float,
        *,
        drops: bool = False,
    ) -> None:
        self.vehicle = links.vehicle
        self.bench = links.bench
        self._prepare = links.prepare
        self.ids_of_phase = ids_of_phase
        self.tick_s = tick_s
        self.inbox: list[Any] = []  # bench messages not read yet
        self.run_stamp_s = 0.0  # when STATUS RUN passed the bus: the same for all receivers
        self.heard = 0  # frames of the other node that were taken in real time
        self.refused = 0  # frames that a full transmit queue did not take in time (`drops`)
        self._drops = drops
        self._frames: list[list[CanFrame]] = [[], []]  # by phase
        is_plain = all(key < EXTENDED_FLAG for ids in ids_of_phase for key in ids)
        self._order: Callable[[CanFrame], int] = itemgetter(0) if is_plain else can_key  # the same, where no id is long

    def send_messages(self, *messages: Any, k: int = 0) -> None:
        """Send bench messages, stamped with tick k."""
        self.bench.send(self._bench_frames(messages, k))

    def _bench_frames(self, messages: Iterable[Any], k: int) -> list[CanFrame]:
        stamp_s = k * self.tick_s
        return [bc.encode(message, stamp_s) for message in messages]

    def announce(self, k: int, phase: int, frames: list[CanFrame], *before: Any) -> None:
        """Send this phase's vehicle frames, then `before` and DONE on the bench channel."""
        self.prepare(k, phase, frames, *before)()

    def prepare(self, k: int, phase: int, frames: list[CanFrame], *before: Any) -> Sending:
        """`announce` in two steps: all that can be made ready now, the rest when the returned function is called."""
        frames.sort(key=self._order)
        if self._drops:
            return partial(self._announce_what_goes, k, phase, frames, before)
        done = bc.Done(k, phase, len(frames), digest(frames))
        return self._prepare(frames, self._bench_frames((*before, done), k))

    def _announce_what_goes(self, k: int, phase: int, frames: list[CanFrame], before: tuple[Any, ...]) -> None:
        frames = self._send_what_goes(frames)
        self.bench.send(self._bench_frames((*before, bc.Done(k, phase, len(frames), digest(frames))), k))

    def _send_what_goes(self, frames: list[CanFrame]) -> list[CanFrame]:
        """Real time on a bus whose queue may be full: what was taken; the rest is dropped and counted."""
        if not frames:
            return frames
        self.vehicle.send(frames)
        refused = self.vehicle.refused
        self.refused += len(refused)
        return frames[: len(frames) - len(refused)]

    def interrupted(self, interrupt: Callable[[Any], bool]) -> bool:
        """Real time: whether a received bench message ends the episode; what follows it stays.

        A runner that does not wait has the next EPISODE and its PARAMs in the same batch.
        """
        if not self.inbox:
            self._fill_inbox(0.0)
        for i, message in enumerate(self.inbox):
            if interrupt(message):
                del self.inbox[: i + 1]
                return True
        self.inbox.clear()
        return False

    def next_message(self, timeout_s: float) -> Any:
        """The next bench message, or None; what came with it stays, for it may belong to the episode it begins."""
        if not self.inbox:
            self._fill_inbox(timeout_s)
        return self.inbox.pop(0) if self.inbox else None

    def _fill_inbox(self, timeout_s: float) -> None:
        for frame in self.bench.receive(timeout_s):
            message = bc.decode(frame)
            if message is None:
                continue
            if isinstance(message, bc.Status) and message.state == bc.State.RUN:
                self.run_stamp_s = frame.time_s
            self.inbox.append(message)

    def await_phase(self, k: int, phase: int, interrupt: Callable[[Any], bool]) -> list[CanFrame] | None:
        """The frames of phase `phase` of tick k, in (id, sequence) order.

        `interrupt(message)` is asked about every other bench message; True ends the wait with None.
        Raises NoAnswer after 5 s, BenchError when what arrived is not what was announced.
        """
        done = self._await_done(k, phase, interrupt)
        if done is None:
            return None
        frames = self._await_frames(k, phase, done.n_tx)
        frames.sort(key=self._order)
        if digest(frames) != done.digest:
            surplus = f"{len(frames) - done.n_tx} more came" if len(frames) > done.n_tx else "their contents differ"
            raise BenchError(
                f"tick {k}: the {len(frames)} frames of the {PHASE_ROLES[phase]} are not those it announced "
                f"({', '.join(f'0x{frame.id:X}' for frame in frames)}): {surplus}, so another node sends these ids",
                code="digest",
                hint="another process sends this vehicle's ids on the same bus; end it, or use another --session",
            )
        return frames

    def _await_done(self, k: int, phase: int, interrupt: Callable[[Any], bool]) -> bc.Done | None:
        limit_s = time.monotonic() + HARD_LIMIT_S
        while True:
            for i, message in enumerate(self.inbox):
                if type(message) is bc.Done and message.phase == phase and message.k == k:
                    del self.inbox[: i + 1]
                    return message
                self._notice_leaving(k, message)
                if interrupt(message):
                    del self.inbox[: i + 1]
                    return None
            self.inbox.clear()
            self._fill_inbox(SLICE_S)
            if not self.inbox and time.monotonic() > limit_s:
                raise NoAnswer(
                    f"tick {k}: the {PHASE_ROLES[phase]} did not answer within {HARD_LIMIT_S:g} s",
                    code="no_answer",
                    hint=f"look at what the {PHASE_ROLES[phase]} process printed; is it stopped or in a debugger?",
                )

    @staticmethod
    def _notice_leaving(k: int, message: Any) -> None:
        if isinstance(message, bc.Status) and message.state == bc.State.END and message.role != bc.Role.RUNNER:
            name = bc.Role(message.role).name.lower()
            raise PeerGone(name, f"tick {k}: the {name} has left the bench", code="node_lost")

    def _await_frames(self, k: int, phase: int, n_tx: int) -> list[CanFrame]:
        limit_s = time.monotonic() + HARD_LIMIT_S
        waiting = self._frames[phase]
        while len(waiting) < n_tx:
            self.sort_in(self.vehicle.receive(SLICE_S))
            if len(waiting) < n_tx and time.monotonic() > limit_s:
                ids = ", ".join(f"0x{frame.id:X}" for frame in waiting) or "none"
                raise NoAnswer(
                    f"tick {k}: the {PHASE_ROLES[phase]} announced {n_tx} frames, {len(waiting)} arrived ({ids})",
                    code="frames_missing",
                )
        self._frames[phase] = []
        return waiting

    def sort_in(self, frames: Iterable[CanFrame]) -> None:
        """Put arrived frames to their phase; those that are in neither set are left out."""
        telemetry, commands = self.ids_of_phase
        reports, orders = self._frames
        for frame in frames:
            key = frame[0] | EXTENDED_FLAG if frame[2] else frame[0]  # can_key
            if key in telemetry:
                reports.append(frame)
            elif key in commands:
                orders.append(frame)

    def take_before(self, phase: int, stamp_s: float) -> list[CanFrame]:
        """Real time: the frames of a phase stamped before `stamp_s`; later ones stay for the next cycle."""
        self.sort_in(self.vehicle.receive(0.0))
        waiting = self._frames[phase]
        taken = [frame for frame in waiting if frame.time_s < stamp_s]
        if taken:
            self.heard += len(taken)
            waiting[:] = [frame for frame in waiting if frame.time_s >= stamp_s]
        return taken

    def clear(self) -> None:
        """Forget what an ended episode left behind, and what a full receive queue lost of it."""
        try:
            self.sort_in(self.vehicle.receive(0.0))
        except BenchError as error:
            if error.code != "rx_overflow":
                raise
        for waiting in self._frames:
            waiting.clear()
