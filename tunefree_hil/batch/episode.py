"""One drive in one kernel: ECU, bus and controller tick by tick as in the nodes (docs/explanation/architecture.md).

It ends with the course, or at the tick at which the controller fails. Rows: values on the bus and the output of the
reference follower, column by column, as episode/columns.py reads them from a log.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from tunefree_hil.base.kernel import compiled, kernel
from tunefree_hil.base.records import Disturbance, Ins, Measurement
from tunefree_hil.batch.bits import BitParams, BitState, receive_bits, set_bits, vehicle_state
from tunefree_hil.batch.commands import (
    CommandParams,
    CommandState,
    received_command,
    send,
    send_nothing,
    send_quiet,
)
from tunefree_hil.bus.dbc.wire_block import WireParams, WireState, ins_heard, pass_on, report_heard
from tunefree_hil.control.cascade import ControllerInput
from tunefree_hil.nodes.handshake import CLEARING, NOT_ENABLED, Limits, Progress, advance
from tunefree_hil.plant.actuation.bywire import ByWireStatus
from tunefree_hil.plant.ecu import ReportedState, UnitInput
from tunefree_hil.plant.types import Driver

NEEDS_THE_BUS = -1.0  # an override latched before the take-over: clear frames are not modelled here
REPORT, INS, COMMAND, TRACKING = 0, 20, 26, 32  # first column of each record
WIDTH = 52


class LinkParams(NamedTuple):
    """The bus. bits: of the messages with states, with their periods, phases and numbers of rejected first frames.
    missing_tick: at which the controller lacks a needed message (-1: never). stage_codes: error code by stage.
    """

    report: WireParams
    ins: WireParams
    bits: BitParams
    bit_period: Any
    bit_phase: Any
    bit_unproven: Any
    command: CommandParams
    missing_tick: int
    missing_code: float
    stage_codes: Any
    limits: Limits


class WireStates(NamedTuple):
    """States of the bus. bit_sent: frames sent of each message with states."""

    report: WireState
    ins: WireState
    bits: BitState
    bit_sent: Any
    command: CommandState


class Setting(NamedTuple):
    """Setting of a drive: length, road by tick, and driver (rows of 6; the last one is kept)."""

    ticks: int
    dt_s: float
    grade_rad: Any
    friction_frac: Any
    bank_rad: Any
    side_wind_mps2: Any
    driver: Any


class ControllerStart(NamedTuple):
    """Params and first state of controller and follower."""

    control: Any
    control_state: Any
    follower: Any
    follower_state: Any


class VehicleStart(NamedTuple):
    """Params, first state and first reports of the vehicle."""

    params: Any
    state: Any
    reported: ReportedState


class End(NamedTuple):
    """Ticks driven, and the error code that ended the drive (0: none)."""

    ticks: int
    code: float


@kernel
def same_status(a: ByWireStatus, b: ByWireStatus) -> bool:
    """Whether all bits of the reports are the same."""
    for i in range(6):
        if a.throttle[i] != b.throttle[i] or a.brake[i] != b.brake[i] or a.steer[i] != b.steer[i]:
            return False
    return (
        a.gear_override == b.gear_override
        and a.watchdog_braking == b.watchdog_braking
        and a.watchdog_cause == b.watchdog_cause
    )


@kernel
def publish_bits(p: LinkParams, state: WireStates, tick: int) -> None:
    """Send and receive the state bits that are due at this tick."""
    for m in range(len(p.bit_period)):
        if int(tick + p.bit_phase[m]) % int(p.bit_period[m]) == 0:  # not 0: a period is a tick or more
            state.bit_sent[m] += 1.0
            if state.bit_sent[m] > p.bit_unproven[m]:
                receive_bits(state.bits, m)


@kernel
def driver_at(rows: Any, tick: int) -> Driver:
    """The driver's inputs."""
    start = min(tick, len(rows) // 6 - 1) * 6
    return Driver(
        float(rows[start]), float(rows[start + 1]), float(rows[start + 2]),
        float(rows[start + 3]), float(rows[start + 4]), float(rows[start + 5]),
    )  # fmt: skip


@kernel
def ins_sent(state: WireState) -> Ins:
    """The INS record as sent on the bus."""
    s = state.sent
    return Ins(float(s[0]), float(s[1]), float(s[2]), float(s[3]), float(s[4]), float(s[5]))


@kernel
def write_row(out: Any, rows: int, tick: int, link: WireStates, tracking: Any) -> None:
    """Row `tick` of the columns."""
    for i in range(20):
        out[(REPORT + i) * rows + tick] = float(link.report.sent[i])
        out[(TRACKING + i) * rows + tick] = tracking[i]
    for i in range(6):
        out[(INS + i) * rows + tick] = float(link.ins.sent[i])
        out[(COMMAND + i) * rows + tick] = float(link.command.wire.sent[i])


def make_episode(control: Callable[..., Any], unit: Callable[..., Any], follow: Callable[..., Any]) -> Any:
    """The kernel of a structure: drive(p, link, setting, controller, car, out) -> End.

    control, unit, follow: steps of the controller, the vehicle (plant/ecu.py) and the reference follower. out: a
    buffer of WIDTH * ticks numbers. The states in `link`, `controller` and `car` are overwritten.

    The columns come from the controller's own follower as long as its input is that of the log; from the first tick
    at which it differs (a rejected INS frame, a discarded step) a second follower runs on the logged input.
    """

    @kernel
    def drive(
        p: LinkParams, link: WireStates, setting: Setting, controller: ControllerStart, car: VehicleStart, out: Any
    ) -> End:
        rows, dt_s = setting.ticks, setting.dt_s
        control_state, follower_state = controller.control_state, controller.follower_state
        car_state, reported, status = car.state, car.reported, car.reported.status
        progress = Progress(0, 0, False)
        apart = False
        set_bits(p.bits, link.bits, status)
        for k in range(rows):
            if not same_status(reported.status, status):
                status = reported.status
                set_bits(p.bits, link.bits, status)
            pass_on(p.report, link.report, reported.measurement.report)
            pass_on(p.ins, link.ins, reported.measurement.ins)
            publish_bits(p, link, k)
            fix = ins_sent(link.ins)
            code = 0.0
            if k == p.missing_tick:
                code = p.missing_code
                send_nothing(p.command, link.command)
                follower_state, tracking = follow(controller.follower, follower_state, (k, fix), dt_s)
            else:
                progress = advance(progress, k, vehicle_state(p.bits, link.bits), p.limits)
                if progress.stage >= NOT_ENABLED or progress.stage == CLEARING:
                    code = float(p.stage_codes[progress.stage])
                    send_quiet(p.command, link.command)
                    follower_state, tracking = follow(controller.follower, follower_state, (k, fix), dt_s)
                else:
                    measurement = Measurement(report_heard(link.report), ins_heard(link.ins))
                    before = control_state
                    control_state, decision = control(
                        controller.control, control_state, ControllerInput(k, measurement), dt_s
                    )
                    send(p.command, link.command, k, decision.command)
                    code = decision.error_code
                    tracking = decision.tracking
                    if not apart:
                        thrown_away = decision.accel_cmd_mps2 != decision.accel_cmd_mps2
                        if thrown_away or not same_ins(measurement.ins, fix):
                            apart = True
                            follower_state = before[0]
                    if apart:
                        follower_state, tracking = follow(controller.follower, follower_state, (k, fix), dt_s)
                    else:
                        follower_state = control_state[0]
            write_row(out, rows, k, link, tracking)
            if code != 0.0:
                return End(k + 1, code)
            road = Disturbance(
                float(setting.grade_rad[k]),
                float(setting.friction_frac[k]),
                float(setting.bank_rad[k]),
                float(setting.side_wind_mps2[k]),
            )
            received = received_command(p.command, link.command)
            car_state, reported = unit(
                car.params, car_state, UnitInput(received, driver_at(setting.driver, k), road), dt_s
            )
        return End(rows, 0.0)

    return compiled(drive)


@kernel
def same_ins(a: Ins, b: Ins) -> bool:
    """Whether two fixes are the same; NaN (not received) equals NaN."""
    for i in range(6):
        unheard = a[i] != a[i] and b[i] != b[i]
        if a[i] != b[i] and not unheard:
            return False
    return True
