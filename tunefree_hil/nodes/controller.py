"""The controller process: frames in, Block, frames out. It takes a vehicle folder, a course and parameters.

It runs unchanged on any bus. It stops commanding, and reports why, when INS or chassis frames are missing for 0.2 s,
when the driver takes over, when a by-wire channel faults, or when its own supervision ends the drive.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.clock import Clock
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import CanFrame, Command
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.message_map import MessageMap
from tunefree_hil.bus.recording.frame_writer import FrameWriter
from tunefree_hil.control.cascade import ControllerInput
from tunefree_hil.control.mpc.plan import plan_failure_text, solve_counts
from tunefree_hil.nodes.exchange import Exchange
from tunefree_hil.nodes.faults import FaultFilter, ScriptedFault
from tunefree_hil.nodes.handshake import Handshake, Stage, limits_of
from tunefree_hil.nodes.measurement_decoder import CHASSIS, INS, MeasurementDecoder
from tunefree_hil.nodes.node import print_line
from tunefree_hil.nodes.timing import CycleTimes

STAGE_CODES = {
    Stage.NOT_ENABLED: bc.ErrorCode.NOT_ENABLED,
    Stage.OVERRIDE: bc.ErrorCode.OVERRIDE,
    Stage.FAULT: bc.ErrorCode.BYWIRE_FAULT,
    Stage.DROPPED: bc.ErrorCode.NOT_ENABLED,
}
MISSING_CODES = {INS: bc.ErrorCode.INS_MISSING, CHASSIS: bc.ErrorCode.CHASSIS_MISSING}

SHORT = 4  # bytes of a clear frame
ASKS_NOTHING = {"command": Command(*[0.0] * len(Command._fields))}  # a signal with an offset is not at 0 by raw 0


class Assignment(NamedTuple):
    """The controller's task in one episode."""

    block: Block
    ticks: int
    dt_s: float
    faults: Sequence[ScriptedFault] = ()


class ControllerPart:
    """The controller's share of an episode (nodes/node.py)."""

    role = bc.Role.CONTROLLER

    def __init__(
        self,
        codec: Codec,
        needed: Mapping[str, Sequence[str]],
        assign: Callable[[bytes, Mapping[int, float]], Assignment],
        times: CycleTimes,
        print_line: Callable[[str], None] = print_line,
    ) -> None:
        self.codec = codec
        self.needed = needed
        self.assign = assign
        self.times = times
        self.print_line = print_line
        self._writer = FrameWriter(codec)
        self._signals: dict[tuple[MessageMap, float, float], dict[str, float]] = {}  # enable and clear, made once
        self._failed = 0

    def load(self, scenario: bytes, seed: int, parameters: dict[int, float]) -> None:
        """Build the controller for this scenario and these parameters; forget the last episode."""
        self.task = self.assign(scenario, parameters)
        block = self.task.block
        self._state = block.init(block.params, self.task.dt_s)
        self.decoder = MeasurementDecoder(self.codec, self.task.dt_s)
        self.handshake = Handshake(limits_of(self.task.dt_s))
        self._failed = 0
        self._writer.restart()
        self._faults = FaultFilter(self.task.faults)

    def lockstep(self, exchange: Exchange, stopped: Callable[[Any], bool]) -> None:
        """One step for each full phase 0."""
        self.times.begin()
        self.decoder.reception.expect_every_period()
        for k in range(self.task.ticks):
            frames = exchange.await_phase(k, 0, stopped)
            if frames is None:
                break
            started = time.perf_counter()
            reply, words = self.cycle(k, frames)
            self.times.note(0.0, time.perf_counter() - started)
            exchange.announce(k, 1, reply, *words)
        self._save()

    def realtime(self, exchange: Exchange, clock: Clock, zero_s: float, stopped: Callable[[Any], bool]) -> None:
        """One step at each deadline, with the frames stamped before it."""
        self.times.begin()
        for k in range(self.task.ticks):
            deadline_s = zero_s + k * self.task.dt_s
            clock.sleep_until(deadline_s)
            late_s = clock.now_s() - deadline_s
            started = time.perf_counter()
            reply, words = self.cycle(k, exchange.take_before(0, deadline_s))
            self.times.note(late_s, time.perf_counter() - started)
            exchange.announce(k, 1, reply, *words)
            if exchange.interrupted(stopped):
                break
        self._save()

    def cycle(self, k: int, frames: Sequence[CanFrame]) -> tuple[list[CanFrame], list[Any]]:
        """One control cycle: the command frames to send, with scripted faults, and the messages to announce."""
        reply, words = self._decide(k, frames)
        begun = [bc.Fault(self.role, fault.index, fault.code, k) for fault in self._faults.begun(k)]
        return self._faults.apply(k, reply, self.task.dt_s), [*begun, *words]

    def _decide(self, k: int, frames: Sequence[CanFrame]) -> tuple[list[CanFrame], list[bc.Status]]:
        decoder = self.decoder
        decoder.receive(k, frames)
        for notice in decoder.reception.notices():
            self.print_line(f"controller: {notice}")
        if self._failed:
            return [], []
        missing = decoder.missing(k, self.needed)
        if missing is not None:
            late = ", ".join(decoder.why(name) for name in missing[1])
            return [], [self._fail(k, MISSING_CODES[missing[0]], f"no valid frame for 0.2 s: {late}")]
        stage = self.handshake.advance(k, decoder.state())
        if stage in STAGE_CODES:
            return self._quiet_frames(k), [self._fail(k, STAGE_CODES[stage], stage.value)]
        block = self.task.block
        sight = ControllerInput(k, decoder.measurement())
        self._state, decision = block.step(block.params, self._state, sight, self.task.dt_s)
        words = []
        if decision.error_code:
            words.append(self._fail(k, bc.ErrorCode(int(decision.error_code)), "supervision ended the drive"))
        return self._frames(k, decision.command), words

    def _save(self) -> None:
        """Times and counts of the episode, and a summary of faulty frames."""
        reception = self.decoder.reception
        counts = solve_counts(self._state)
        self.times.save("controller", reception.troubles(), counts)
        if words := reception.summary():
            self.print_line(f"controller: received: {words}")
        for name, row in counts.items():
            if row.failed:
                self.print_line(f"controller: {plan_failure_text(name, row)}")

    def _fail(self, k: int, code: bc.ErrorCode, why: str) -> bc.Status:
        self._failed = int(code)
        self.print_line(f"controller: tick {k}: {code.name.lower()}: {why}; commands stop")
        return bc.Status(self.role, bc.State.FAILED, int(code), k)

    def _frames(self, k: int, command: Any) -> list[CanFrame]:
        enable, clear_now = (1.0 if self.handshake.enable else 0.0), self.handshake.clear_now
        records = {"command": command} if enable else ASKS_NOTHING
        return [
            self._frame(k, message, records, enable, 0.0)
            for message in self.codec.commands
            if k % message.period_ticks == 0 and not (clear_now and message.clear)
        ] + (self._clear_frames(k) if clear_now else [])

    def _clear_frames(self, k: int) -> list[CanFrame]:
        """Clear frames: of DLC 4 where the vehicle accepts them and the clear bit lies in them, else whole frames.

        An 8-byte frame without a proper counter would trip the watchdog (docs/reference/by_wire.md).
        """
        return [
            self._short_clear(k, message)
            if message.allow_truncated and message.signals[message.clear].end_bit <= 8 * SHORT
            else self._frame(k, message, ASKS_NOTHING, 0.0, 1.0)
            for message in self.codec.commands
            if message.clear
        ]

    def _short_clear(self, k: int, message: MessageMap) -> CanFrame:
        length = min(SHORT, message.length)
        return self._writer.write_short(message, ASKS_NOTHING, {message.clear: 1.0}, length, k * self.task.dt_s)

    def _quiet_frames(self, k: int) -> list[CanFrame]:
        """Commands without their enable bit: sent once when the drive ends, then nothing."""
        return [self._frame(k, message, ASKS_NOTHING, 0.0, 0.0) for message in self.codec.commands if message.enable]

    def _frame(self, k: int, message: MessageMap, records: dict[str, Any], enable: float, clear: float) -> CanFrame:
        key = message, enable, clear
        signals = self._signals.get(key)
        if signals is None:
            signals = self._signals[key] = {}
            if message.enable:
                signals[message.enable] = enable
            if message.clear:
                signals[message.clear] = clear
        return self._writer.write(message, records, signals, k * self.task.dt_s)
