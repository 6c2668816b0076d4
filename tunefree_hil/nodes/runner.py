"""Conducts episodes over the bench channel: waits for the nodes, sends episode and parameters, reports the end.

The runner is no part of the lockstep: the ECU owns time, so a slow runner slows nothing. It waits for messages of the
bench channel and reports a silence of 5 s.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError, InputError, NoAnswer, PeerGone
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.link import BusLink
from tunefree_hil.bus.recording.recorder_owner import RecorderOwner
from tunefree_hil.bus.tfhub.owner import Owner
from tunefree_hil.control.parameters import NAMES
from tunefree_hil.nodes.exchange import HARD_LIMIT_S

LOOK_S = 0.05  # how often it looks at the processes while no message comes
LATE_S = 0.005  # how much later than the ECU the controller may report its own end
LOAD_LIMIT_S = 120.0  # a jitted plant compiles while it loads
SILENT_LIMIT_S = HARD_LIMIT_S + 2.0  # the waiting node reports it first, with more detail
LEAVING_LOOKS, LEAVING_LOOK_S = 8, 0.25  # a process that announced its end still needs a moment
LEAD_MS = 200  # real time: from RUN to tick 0


class Outcome(NamedTuple):
    """How an episode ended. error_code 0: driven to its end."""

    ticks: int
    error_code: int
    logged: dict[str, int]
    wall_s: float

    @property
    def error(self) -> str:
        """The error's name, '' when there was none."""
        return bc.ErrorCode(self.error_code).name.lower() if self.error_code else ""


class Runner:
    """Runs episodes on one bench.

    `owner` writes the logs and counts frames. `check()` raises when a process of ours has died, or the bus has a fault.
    """

    def __init__(self, bench: BusLink, owner: Owner | RecorderOwner, check: Callable[[], None] = lambda: None) -> None:
        self.bench = bench
        self.owner = owner
        self.check = check
        self.collector = bc.HelloCollector()

    def meet(self, limit_s: float = 30.0) -> None:
        """Wait for an ECU and a controller. Raises NoAnswer that names the missing ones."""
        limit = time.monotonic() + limit_s
        needed = (bc.Role.ECU, bc.Role.CONTROLLER)
        self._send_messages(*bc.hello_messages(bc.Role.RUNNER, "runner", []))
        while not all(self.collector.complete(role) for role in needed):
            for message in self._receive():
                if isinstance(message, bc.Hello):
                    self.collector.add(message)
            if time.monotonic() > limit:
                raise self._missing_nodes_error([role for role in needed if not self.collector.complete(role)], limit_s)
        self.announced()  # raises for an unreadable text

    def _missing_nodes_error(self, missing: Sequence[bc.Role], limit_s: float) -> NoAnswer:
        """The error for nodes without a complete HELLO, with what a controller of the user's own has to send."""
        message = f"no hello from {' and '.join(role.name.lower() for role in missing)} within {limit_s:g} s"
        is_here, all_of_it = self.collector.arrived(bc.Role.CONTROLLER)
        if bc.Role.CONTROLLER in missing and is_here:
            message += f"; {is_here} of {all_of_it} parts of the controller's came"
        hint = "start `tunefree-hil ecu` and `tunefree-hil controller` on the same --session"
        if missing == [bc.Role.CONTROLLER]:
            hint += f"; a controller of your own has to send {bc.HELLO_WORDS}"
        return NoAnswer(message, code="node_missing", hint=hint)

    def announced(self) -> dict[int, str]:
        """{index: name} of the parameters that a controller of the user's own announced."""
        return self.collector.parameters(bc.Role.CONTROLLER)

    def indexed(self, parameters: Mapping[str, float]) -> dict[int, float]:
        """PARAM index -> value, by the list of docs/reference/controller.md and by what the controller announced.

        Raises InputError for a name that is in neither.
        """
        announced = self.announced()
        indices = {name: index for index, name in [*enumerate(NAMES), *announced.items()]}
        unknown = [name for name in parameters if name not in indices]
        if unknown:
            raise InputError(
                f"the controller {self.collector.name(bc.Role.CONTROLLER)} has no parameter {', '.join(unknown)}",
                code="unknown_parameter",
                hint=f"it announced {', '.join(announced.values()) or 'none of its own'}",
            )
        return {indices[name]: value for name, value in parameters.items()}

    def drive(
        self,
        scenario: bytes,
        seed: int,
        parameters: Sequence[float] | Mapping[int, float],
        logs: dict[str, Path],
    ) -> Outcome:
        """Drive one episode to its end or failure; hub or recorder write the logs.

        scenario: content hash, of which EPISODE carries 6 bytes. parameters: values from index 0 on, or by index
        (`indexed`). Raises BenchError, NoAnswer, PeerGone.
        """
        self._send_messages(bc.Episode(scenario[:6], seed))
        values = parameters if isinstance(parameters, Mapping) else dict(enumerate(parameters))
        self._send_messages(*[bc.Param(index, len(values), value) for index, value in values.items()])
        self._await_ready()
        self.owner.start_log(logs)
        started = time.monotonic()
        try:
            self._send_messages(bc.Status(bc.Role.RUNNER, bc.State.RUN, 0, LEAD_MS))
            ticks, code = self._await_end()
        except HubSilent:
            raise  # it would not answer stop_log either
        except BaseException:
            self.owner.stop_log()
            raise
        wall_s = time.monotonic() - started
        return Outcome(ticks, code, self.owner.stop_log(), wall_s)

    def stop(self) -> None:
        """Ask the running episode to end."""
        self._send_messages(bc.Status(bc.Role.RUNNER, bc.State.STOP, 0, 0))

    def end(self) -> None:
        """Ask the nodes to end themselves."""
        self._send_messages(bc.Status(bc.Role.RUNNER, bc.State.END, 0, 0))

    def _send_messages(self, *messages: Any) -> None:
        self.bench.send([bc.encode(message) for message in messages])

    def _receive(self) -> list[Any]:
        frames = self.bench.receive(LOOK_S)
        self.check()
        return [message for frame in frames if (message := bc.decode(frame)) is not None]

    def _await_ready(self) -> None:
        limit = time.monotonic() + LOAD_LIMIT_S
        waiting = {bc.Role.ECU, bc.Role.CONTROLLER}
        while waiting:
            for message in self._receive():
                self._refuse_leaving(message)
                if isinstance(message, bc.Status) and message.role in waiting:
                    self._refuse_failed(message)
                    if message.state == bc.State.READY:
                        waiting.discard(bc.Role(message.role))
            if time.monotonic() > limit:
                names = " and ".join(sorted(role.name.lower() for role in waiting))
                raise NoAnswer(f"{names} did not load the episode within {LOAD_LIMIT_S:g} s", code="no_answer")

    def _refuse_leaving(self, message: Any) -> None:
        """Raise PeerGone when a node announces its end; `check` raises its own message first, where we started it."""
        if isinstance(message, bc.Status) and message.state == bc.State.END:
            for _ in range(LEAVING_LOOKS):
                time.sleep(LEAVING_LOOK_S)
                self.check()
            name = bc.Role(message.role).name.lower()
            raise PeerGone(
                name,
                f"the {name} has left the bench",
                code="node_lost",
                hint="its own output gives the reason; start it again, then repeat the command",
            )

    def _refuse_failed(self, message: bc.Status) -> None:
        if message.state != bc.State.FAILED:
            return
        time.sleep(0.3)  # the node prints its error and ends; check() then quotes it
        self.check()
        role = bc.Role(message.role).name.lower()
        raise BenchError(
            f"the {role} cannot load this episode: {bc.error_text(message.error_code)}",
            code=bc.ErrorCode(message.error_code).name.lower(),
            hint=f"the output of the {role} gives the reason; do both have the same files?",
        )

    def _await_end(self) -> tuple[int, int]:
        """(ticks, error code) that the ECU ends with; a failure that the controller announced first counts."""
        watch = Silence(self.owner)
        code, ended = 0, None
        while ended is None:
            for message in self._receive():
                self._refuse_leaving(message)
                if not isinstance(message, bc.Status):
                    continue
                if message.role == bc.Role.CONTROLLER:
                    code = code or message.error_code
                elif message.role == bc.Role.ECU and message.state in (bc.State.FINISHED, bc.State.FAILED):
                    ended = message
            watch.check()
        return ended.tick, code or ended.error_code or self._late_failure()

    def _late_failure(self) -> int:
        """The controller's failure in the last tick, which in real time may arrive after the ECU's end; 0: none.
        Left on the bus it would count as a failure to load the next episode.
        """
        time.sleep(LATE_S)
        messages = [bc.decode(frame) for frame in self.bench.receive(0.0)]
        statuses = [
            message for message in messages if isinstance(message, bc.Status) and message.role == bc.Role.CONTROLLER
        ]
        return next((status.error_code for status in statuses if status.state == bc.State.FAILED), 0)


class HubSilent(NoAnswer):
    """The hub, or the recorder, does not answer itself."""


class Silence:
    """Detects a silent bench: the hub's or recorder's count of frames does not change."""

    def __init__(self, owner: Owner | RecorderOwner) -> None:
        self.owner = owner
        self._frames = -1
        self._moved = self._looked = time.monotonic()

    def check(self) -> None:
        """Raise NoAnswer when no frame has passed for SILENT_LIMIT_S."""
        now_s = time.monotonic()
        if now_s - self._looked < 1.0:
            return
        self._looked = now_s
        try:
            frames = sum(self.owner.stats().frames.values())
        except NoAnswer as error:
            raise HubSilent(error.message, code="no_answer", hint="is it stopped? look where it runs") from error
        if frames != self._frames:
            self._frames, self._moved = frames, now_s
        elif now_s - self._moved > SILENT_LIMIT_S:
            raise NoAnswer(
                f"no frame has passed for {SILENT_LIMIT_S:g} s",
                code="no_answer",
                hint="are the ECU and the controller stopped? look where they run",
            )
