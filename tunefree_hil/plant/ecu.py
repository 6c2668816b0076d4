"""The whole vehicle as the bus sees it, as one Block: command delay, by-wire unit, body, report delay
(docs/reference/bench_channel.md).

An effect that delays the chassis reports delays the by-wire unit's bits as well, as they are in the same frames.

The input at tick k are the command frames of tick k; the output is the content of the reports of tick k + 1. In real
time the bus itself is one tick of each delay, so `make_unit` then gets one tick less.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.records import Disturbance, Measurement
from tunefree_hil.plant.actuation.bywire import ByWireInput, ByWireStatus, ReceivedCommand
from tunefree_hil.plant.actuation.delay import init_delay, step_delay
from tunefree_hil.plant.measurement.report_latency import delay_with_status, init_status_delay
from tunefree_hil.plant.types import BodyInput, Driver
from tunefree_hil.plant.vehicle import Body, first_output


class UnitInput(NamedTuple):
    """One tick: received commands, driver, road."""

    received: ReceivedCommand
    driver: Driver
    road: Disturbance


class ReportedState(NamedTuple):
    """Content of the vehicle's frames."""

    measurement: Measurement
    status: ByWireStatus


class UnitParams(NamedTuple):
    """Params of the parts."""

    bywire: Any
    body: Any


class UnitState(NamedTuple):
    """States of the parts; speed_mps and steer_rad are the by-wire unit's own measurements."""

    commands: Any
    bywire: Any
    body: Any
    reports: Any
    speed_mps: float
    steer_rad: float


class EcuStart(NamedTuple):
    """An episode at tick 0: params, state, and the content of the first frames."""

    params: UnitParams
    state: UnitState
    reported: ReportedState


class Unit(NamedTuple):
    """A vehicle's step, made (and compiled) once for all its episodes."""

    step: Any
    bywire: Block
    command_ticks: int
    report_ticks: int

    def start(self, body: Body, dt_s: float) -> EcuStart:
        """The start of an episode; `body` comes from `for_episode`."""
        body_state, first = first_output(body, dt_s)
        reported = ReportedState(first.measurement, ByWireStatus())
        reports = init_delay(self.report_ticks)(reported, dt_s)
        state = UnitState(
            init_delay(self.command_ticks)(ReceivedCommand(), dt_s),
            self.bywire.init(self.bywire.params, dt_s),
            body_state,
            (init_status_delay(body.block.params.late_s, dt_s), reports) if body.late else reports,
            float(first.motion.speed_mps),
            float(first.actuation.steer_rad),
        )
        return EcuStart(UnitParams(self.bywire.params, body.block.params), state, reported)


def make_unit(body: Body, bywire: Block, command_ticks: int, report_ticks: int) -> Unit:
    """The vehicle's step for the structure of `body`; the numbers are given by `Unit.start`."""
    command_step, report_step = step_delay(command_ticks), step_delay(report_ticks)
    bywire_step, body_step = bywire.step, body.block.step
    if body.late:
        report_step = delay_with_status(report_step, ReportedState)

    @kernel
    def step(params: UnitParams, state: UnitState, x: UnitInput, dt_s: float) -> tuple[UnitState, ReportedState]:
        commands, received = command_step(0.0, state.commands, x.received, dt_s)
        bywire_input = ByWireInput(received, x.driver, state.speed_mps, state.steer_rad)
        bywire_state, applied = bywire_step(params.bywire, state.bywire, bywire_input, dt_s)
        body_state, out = body_step(params.body, state.body, BodyInput(applied.command, x.driver, x.road), dt_s)
        reports, reported = report_step(0.0, state.reports, ReportedState(out.measurement, applied.status), dt_s)
        speed_mps, steer_rad = out.motion.speed_mps, out.actuation.steer_rad
        return UnitState(commands, bywire_state, body_state, reports, speed_mps, steer_rad), reported

    return Unit(step, bywire, command_ticks, report_ticks)
