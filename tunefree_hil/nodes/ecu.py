"""The simulated by-wire vehicle as a process: command frames in, Block, report and INS frames out.

In lockstep it owns time: it opens each tick, and steps only on the full set of command frames of that tick.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.clock import Clock
from tunefree_hil.base.course import Course
from tunefree_hil.base.records import CanFrame, Disturbance
from tunefree_hil.bus import bench_channel as bc
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.link import Sending
from tunefree_hil.bus.recording.frame_writer import FrameWriter
from tunefree_hil.nodes.command_decoder import CommandDecoder
from tunefree_hil.nodes.exchange import Exchange
from tunefree_hil.nodes.faults import FaultFilter, ScriptedFault
from tunefree_hil.nodes.node import print_line
from tunefree_hil.nodes.status_bits import StatusSignals, cause_name
from tunefree_hil.nodes.timing import CycleTimes
from tunefree_hil.plant.actuation.bywire import ReceivedCommand
from tunefree_hil.plant.ecu import Unit, UnitInput
from tunefree_hil.plant.types import Driver
from tunefree_hil.plant.vehicle import Body


class Vehicle(NamedTuple):
    """What one episode asks of the ECU."""

    unit: Unit
    body: Body
    course: Course
    dt_s: float
    phases: Mapping[str, int]  # tick of its period on which each message goes out
    driver: Callable[[int], Driver]  # the person in the seat, by tick
    faults: Sequence[ScriptedFault] = ()
    ahead: bool = False  # the unit applies at each tick the commands of the tick before


class EcuPart:
    """The vehicle's share of an episode (nodes/node.py)."""

    role = bc.Role.ECU

    def __init__(
        self,
        codec: Codec,
        assign: Callable[[bytes, int], Vehicle],
        times: CycleTimes,
        print_line: Callable[[str], None] = print_line,
    ) -> None:
        self.codec = codec
        self.assign = assign
        self.times = times
        self.print_line = print_line
        self._signals = StatusSignals(codec)
        self._writer = FrameWriter(codec)
        self._failure = 0

    def load(self, scenario: bytes, seed: int, parameters: dict[int, float]) -> None:
        """Put a vehicle at the scenario's start: power-up, no frame received yet."""
        self.car = self.assign(scenario, seed)
        self._start_vehicle()
        self._decoder = CommandDecoder(self.codec)
        self._writer.restart()
        self._faults = FaultFilter(self.car.faults)
        self._cause = 0.0
        self._causes: list[bc.Fault] = []  # of the watchdog, not announced yet
        self._failure = 0

    def _start_vehicle(self) -> None:
        """Start it after one step thrown away: where kernels are compiled, that is now and not in tick 0."""
        car = self.car
        params, state, _ = car.unit.start(car.body, car.dt_s)
        car.unit.step(params, state, UnitInput(ReceivedCommand(), car.driver(0), Disturbance()), car.dt_s)
        self._params, self._state, self._output = car.unit.start(car.body, car.dt_s)

    def lockstep(self, exchange: Exchange, stopped: Callable[[Any], bool]) -> None:
        """Open tick after tick; end with the course, a failure of the controller, or a request.

        A vehicle that steps ahead decodes the commands of the tick before, and steps, while the controller computes;
        its frames are then packed when the tick ends.
        """
        self.times.begin()
        self._stopped = stopped
        self._decoder.reception.expect_every_period()
        ahead, arrived, ticks = self.car.ahead, None, 0
        announce = exchange.prepare(0, 0, self._publish(0, 0), bc.Tick(0))
        for k in range(self.car.course.ticks):
            announce()
            started = time.perf_counter()
            if ahead:
                received = ReceivedCommand() if arrived is None else self._decode(arrived)
                announce = self._advance(exchange, k, received)
            spent_s = time.perf_counter() - started
            arrived = exchange.await_phase(k, 1, self._interrupt)
            if arrived is None:
                self._failure = self._failure or int(bc.ErrorCode.STOPPED)
                break
            started = time.perf_counter()
            if not ahead:
                announce = self._advance(exchange, k, self._decode(arrived))
            self._announce_faults(exchange, k)
            self.times.note(0.0, spent_s + time.perf_counter() - started)
            ticks = k + 1
            if self._failure:
                break
        if ahead and arrived is not None:
            self._decode(arrived)  # for the counts and the notices of the last tick
        self._end(exchange, ticks)

    def _advance(self, exchange: Exchange, k: int, received: ReceivedCommand) -> Sending:
        """The step of tick k, and the announcement of the tick after it."""
        self._step(k, received)
        return exchange.prepare(k + 1, 0, self._publish(k + 1, k + 1), bc.Tick(k + 1))

    def realtime(self, exchange: Exchange, clock: Clock, zero_s: float, stopped: Callable[[Any], bool]) -> None:
        """At each deadline: publish the state reached, then step with the commands stamped before the deadline."""
        self.times.begin()
        self._stopped = stopped
        ticks = 0
        exchange.announce(0, 0, self._publish(0, 0))  # announced too: the recorder counts frames by it
        for k in range(self.car.course.ticks):
            deadline_s = zero_s + k * self.car.dt_s
            clock.sleep_until(deadline_s)
            late_s = clock.now_s() - deadline_s
            started = time.perf_counter()
            exchange.announce(k, 0, self._publish(k, k + 1), bc.Tick(k))
            if exchange.interrupted(self._interrupt):
                self._failure = self._failure or int(bc.ErrorCode.STOPPED)
            self._step(k, self._decode(exchange.take_before(1, deadline_s)))
            self._announce_faults(exchange, k)
            self.times.note(late_s, time.perf_counter() - started)
            ticks = k + 1
            if self._failure:
                break
        self._end(exchange, ticks)

    def _interrupt(self, message: Any) -> bool:
        """Note a failure of the controller (its DONE still comes); True where the runner requests a stop."""
        if isinstance(message, bc.Status) and message.role == bc.Role.CONTROLLER and message.state == bc.State.FAILED:
            self._failure = self._failure or message.error_code
            return False
        return self._stopped(message)

    def _end(self, exchange: Exchange, ticks: int) -> None:
        state = bc.State.FAILED if self._failure else bc.State.FINISHED
        reception = self._decoder.reception
        self.times.save("ecu", reception.troubles())
        if words := reception.summary():
            self.print_line(f"ecu: received: {words}")
        exchange.send_messages(*self._causes, bc.Status(self.role, state, self._failure, ticks), k=ticks)

    def _publish(self, k: int, used_at: int) -> list[CanFrame]:
        """What is sent at tick k: the frames that are due at the tick that uses them."""
        car, reported = self.car, self._output
        records = {"report": reported.measurement.report, "ins": reported.measurement.ins}
        signals = self._signals.of(reported.status)
        stamp_s = k * car.dt_s
        write = self._writer.write
        frames = [
            write(m, records, signals[m.name], stamp_s)
            for m in self.codec.telemetry
            if (used_at + car.phases[m.name]) % m.period_ticks == 0
        ]
        return self._faults.apply(k, frames, car.dt_s)

    def _announce_faults(self, exchange: Exchange, k: int) -> None:
        """Announce the scripted faults that begin at tick k, and the watchdog's: after the controller's DONE.

        Where the vehicle steps ahead, the order of the two would else be chance.
        """
        scripted = [bc.Fault(self.role, fault.index, fault.code, k) for fault in self._faults.begun(k)]
        if scripted or self._causes:
            exchange.send_messages(*scripted, *self._causes, k=k)
            self._causes.clear()

    def _decode(self, frames: Sequence[CanFrame]) -> ReceivedCommand:
        """Decode the command frames of one tick, and print notices."""
        received = self._decoder.receive(frames)
        for notice in self._decoder.reception.notices():
            self.print_line(f"ecu: {notice}")
        return received

    def _step(self, k: int, received: ReceivedCommand) -> None:
        car = self.car
        road = car.course.road_at(k)
        x = UnitInput(received, car.driver(k), road)
        self._state, self._output = car.unit.step(self._params, self._state, x, car.dt_s)
        cause = self._output.status.watchdog_cause
        if cause != self._cause:
            self._cause = cause
            self.print_line(f"ecu: tick {k}: watchdog: {cause_name(cause)}; brakes applied")
            self._causes.append(bc.Fault(self.role, bc.NOT_SCRIPTED, int(cause), k))
