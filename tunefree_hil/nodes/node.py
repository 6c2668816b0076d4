"""Common to ECU and controller: send HELLO, load an episode on request, run it, announce how it ended."""

from __future__ import annotations

import contextlib
import gc
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

from tunefree_hil.base.clock import Clock
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.nodes.exchange import Exchange
from tunefree_hil.nodes.priority import lock_memory, punctual

WAIT_S = 0.5


class Part(Protocol):
    """One role's share of an episode."""

    role: bc.Role

    def load(self, scenario: bytes, seed: int, parameters: dict[int, float]) -> None: ...

    def lockstep(self, exchange: Exchange, stopped: Callable[[Any], bool]) -> None: ...

    def realtime(self, exchange: Exchange, clock: Clock, zero_s: float, stopped: Callable[[Any], bool]) -> None: ...


class Announcement(NamedTuple):
    """What a node sends in its HELLO. parameters: names of those of its own, beside docs/reference/controller.md."""

    name: str
    parameters: Sequence[str] = ()


def print_line(text: str) -> None:
    """Print a node's notice on stderr."""
    print(text, file=sys.stderr, flush=True)  # noqa: T201


class Node:
    """Serves episodes until the bus goes (which raises) or the runner sends END."""

    def __init__(
        self, part: Part, exchange: Exchange, announcement: Announcement, clock: Clock, realtime: bool = False
    ) -> None:
        self.part = part
        self.exchange = exchange
        self.announcement = announcement
        self.clock = clock
        self.realtime = realtime
        self._episode: bc.Episode | None = None
        self._parameters: dict[int, float] = {}
        self._parameter_count = -1
        self._ready = False

    def hello(self) -> None:
        """Announce role, name and parameters."""
        for message in bc.hello_messages(self.part.role, *self.announcement):
            self.exchange.send_messages(message)

    def serve(self) -> None:
        """Send HELLO, then answer the runner for ever. The reason of an end is announced on the bench channel."""
        try:
            self.hello()
            gc.collect()
            gc.freeze()  # what has been imported stays: the collection before each episode need not look at it
            self._serve()
        except BaseException:
            self._announce_leaving()
            raise

    def _serve(self) -> None:
        while True:
            message = self.exchange.next_message(WAIT_S)
            if isinstance(message, bc.Status) and message.role == bc.Role.RUNNER and message.state == bc.State.END:
                return
            if message is not None:
                self._answer(message)

    def _announce_leaving(self) -> None:
        """Announce the end, so that the others need not wait; where the bus itself is gone nothing can be sent."""
        with contextlib.suppress(BenchError):
            self.exchange.send_messages(bc.Status(self.part.role, bc.State.END, bc.ErrorCode.INTERNAL, 0))

    def _answer(self, message: Any) -> None:
        if isinstance(message, bc.Hello) and message.role == bc.Role.RUNNER and message.part == 0:
            self.hello()
        elif isinstance(message, bc.Episode):
            self._episode, self._parameters, self._parameter_count, self._ready = message, {}, -1, False
        elif isinstance(message, bc.Param):
            self._parameters[message.index] = message.value
            self._parameter_count = message.count
        elif isinstance(message, bc.Status) and message.role == bc.Role.RUNNER and message.state == bc.State.RUN:
            self._run(float(message.tick))
        if self._episode is not None and len(self._parameters) == self._parameter_count and not self._ready:
            self._load(self._episode)

    def _load(self, episode: bc.Episode) -> None:
        self._ready = True
        self.exchange.clear()
        try:
            self.part.load(episode.scenario, episode.seed, dict(self._parameters))
        except InputError as error:
            code = bc.ErrorCode.UNKNOWN_SCENARIO if error.code == "unknown_scenario" else bc.ErrorCode.CONTROL_ERROR
            self.exchange.send_messages(bc.Status(self.part.role, bc.State.FAILED, code, 0))
            raise
        gc.collect()
        if self.realtime:
            lock_memory()  # now, as it takes a while
        self.exchange.send_messages(bc.Status(self.part.role, bc.State.READY, 0, 0))

    def _run(self, lead_ms: float) -> None:
        if self._episode is None:
            return
        self._episode, self._ready = None, False
        gc.disable()  # a tick makes no cycles; loading's were collected before READY
        try:
            if self.realtime:
                zero_s = self.exchange.run_stamp_s + lead_ms * 1e-3
                with punctual():
                    self.part.realtime(self.exchange, self.clock, zero_s, self._stopped)
            else:
                self.part.lockstep(self.exchange, self._stopped)
        finally:
            gc.enable()

    @staticmethod
    def _stopped(message: Any) -> bool:
        """Whether a bench message ends the running episode."""
        if not isinstance(message, bc.Status):
            return False
        if message.role == bc.Role.RUNNER:
            return message.state in (bc.State.STOP, bc.State.END)
        return message.role == bc.Role.ECU and message.state in (bc.State.FINISHED, bc.State.FAILED)
