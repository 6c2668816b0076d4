"""Blocks that apply the effects of a port to a channel of a record (docs/reference/effects.md)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tunefree_hil.base.contracts import Port
from tunefree_hil.base.kernel import Block, kernel, series
from tunefree_hil.base.records import Actuation, Command, Measurement

Effects = Sequence[tuple[Port, Any]]  # port, and the result of contracts.make_effect


def _identity() -> Block:
    @kernel
    def step(params: Any, state: Any, x: Any, dt_s: float) -> tuple[Any, Any]:
        return state, x

    return Block(lambda params, dt_s: 0.0, step, 0.0)


def _chain(effects: Effects, port: Port) -> Block:
    """The effects of one port in series."""
    blocks = [made for effect_port, made in effects if effect_port is port]
    if not blocks:
        return _identity()
    chain = blocks[0]
    for block in blocks[1:]:
        chain = series(chain, block)
    return chain


def channels_of(effects: Effects, ports: tuple[Port, Port, Port], record: Any) -> Block:
    """Block record -> record with effects on throttle, brake and steer; the rest of the record is unchanged."""
    if not any(port in ports for port, _ in effects):
        return _identity()
    throttle, brake, steer = (_chain(effects, port) for port in ports)
    throttle_step, brake_step, steer_step = throttle.step, brake.step, steer.step
    is_command = record is Command

    def init(params: Any, dt_s: float) -> Any:
        return (throttle.init(params[0], dt_s), brake.init(params[1], dt_s), steer.init(params[2], dt_s))

    @kernel
    def three(params: Any, state: Any, x: Any, dt_s: float) -> Any:
        throttle_state, throttle_frac = throttle_step(params[0], state[0], x.throttle_frac, dt_s)
        brake_state, brake_frac = brake_step(params[1], state[1], x.brake_frac, dt_s)
        steer_state, steer_rad = steer_step(params[2], state[2], x.steer_rad, dt_s)
        return (throttle_state, brake_state, steer_state), throttle_frac, brake_frac, steer_rad

    @kernel
    def on_command(params: Any, state: Any, x: Command, dt_s: float) -> tuple[Any, Command]:
        new, throttle_frac, brake_frac, steer_rad = three(params, state, x, dt_s)
        return new, Command(throttle_frac, brake_frac, steer_rad, x.gear, x.accel_mps2, x.steer_torque_nm)

    @kernel
    def on_actuation(params: Any, state: Any, x: Actuation, dt_s: float) -> tuple[Any, Actuation]:
        new, throttle_frac, brake_frac, steer_rad = three(params, state, x, dt_s)
        return new, Actuation(throttle_frac, brake_frac, steer_rad, x.gear)

    return Block(init, on_command if is_command else on_actuation, (throttle.params, brake.params, steer.params))


def upto_report(effects: Effects, actuators: Block) -> Block:
    """Effects A and the actuators, Command -> Actuation; those on an actuator's output come after its lag."""
    ports = (Port.THROTTLE_A, Port.BRAKE_A, Port.STEER_A)
    output_ports = (Port.THROTTLE_OUT, Port.BRAKE_OUT, Port.STEER_OUT)
    if any(port in ports for port, _ in effects):
        actuators = series(channels_of(effects, ports, Command), actuators)
    if any(port in output_ports for port, _ in effects):
        actuators = series(actuators, channels_of(effects, output_ports, Actuation))
    return actuators


def make_measurement_effects(effects: Effects) -> Block:
    """Effects on the measurement, Measurement -> Measurement."""
    if not any(port in (Port.REPORT, Port.INS) for port, _ in effects):
        return _identity()
    report, ins = _chain(effects, Port.REPORT), _chain(effects, Port.INS)
    report_step, ins_step = report.step, ins.step

    def init(params: Any, dt_s: float) -> Any:
        return (report.init(params[0], dt_s), ins.init(params[1], dt_s))

    @kernel
    def step(params: Any, state: Any, x: Measurement, dt_s: float) -> tuple[Any, Measurement]:
        report_state, new_report = report_step(params[0], state[0], x.report, dt_s)
        ins_state, new_ins = ins_step(params[1], state[1], x.ins, dt_s)
        return (report_state, ins_state), Measurement(new_report, new_ins)

    return Block(init, step, (report.params, ins.params))
