"""The compiled loops over a drive: from commands to reported outputs, and from outputs to motion, reports and INS.

Each loop takes and gives flat rows of floats; a row is a record of this module, its fields in order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.kernel import kept, kernel
from tunefree_hil.base.records import NAN, Actuation, Command, Disturbance, Ins, Motion, Report
from tunefree_hil.plant.actuation.actuators import step_actuator
from tunefree_hil.plant.measurement.sensors import WIDTH, SensorInput, SensorParams, ins_of, report_of
from tunefree_hil.plant.types import NO_DRIVER, ChassisInput

AT_REST = Motion(*(0.0,) * len(Motion._fields))
IDEAL_SENSORS = SensorParams((0.0,) * WIDTH, 0.0, 0.0)


class InputRow(NamedTuple):
    """One tick of a drive: commands, outputs that the chassis takes, and the measured motion.

    is_pinned: 1 where the chassis is set to the measured motion, else 0.
    """

    throttle_command_frac: Any
    brake_command_frac: Any
    steer_command_rad: Any
    throttle_frac: Any
    brake_frac: Any
    steer_rad: Any
    gear: Any
    speed_mps: Any
    yaw_rate_radps: Any
    side_speed_mps: Any
    speed_rate_mps2: Any
    is_pinned: Any


class OutputRow(NamedTuple):
    """One tick of the actuators' outputs, as they are reported and as they are."""

    reported_throttle_frac: Any
    reported_brake_frac: Any
    reported_steer_rad: Any
    throttle_frac: Any
    brake_frac: Any
    steer_rad: Any


class SimulatedRow(NamedTuple):
    """One tick of what is compared with the measurement."""

    throttle_frac: Any
    brake_frac: Any
    steer_rad: Any
    rate_mps2: Any
    speed_mps: Any
    yaw_rate_radps: Any
    accel_mps2: Any
    lateral_accel_mps2: Any
    ins_speed_mps: Any
    ins_yaw_rate_radps: Any
    ins_accel_mps2: Any
    ins_x_m: Any
    ins_y_m: Any
    ins_heading_rad: Any
    wheels_radps: Any


N_INPUTS, N_OUTPUTS, N_SIMULATED = len(InputRow._fields), len(OutputRow._fields), len(SimulatedRow._fields)
SIMULATED_FIELDS = SimulatedRow._fields
INS_COLUMNS = [i for i, name in enumerate(SIMULATED_FIELDS) if name.startswith("ins_")]


class ActuatorParts(NamedTuple):
    """Params or states before the chassis: effects on the commands, actuators, effects on outputs and reports."""

    command_effects: tuple[Any, Any, Any]
    actuators: tuple[Any, Any, Any]
    output_effects: tuple[Any, Any, Any]
    report: Any


class VehicleParts(NamedTuple):
    """Params or states from the outputs on: effects before the chassis, chassis, effects on reports and INS."""

    chassis_effects: tuple[Any, Any, Any]
    chassis: Any
    report: Any
    ins: Any


@kernel
def unpack_command(rows: Any, start: int) -> Command:
    """The command in the InputRow that begins at `start`."""
    return Command(float(rows[start]), float(rows[start + 1]), float(rows[start + 2]), float(rows[start + 6]), NAN, NAN)


@kernel
def unpack_output(rows: Any, start: int) -> Actuation:
    """The actuators' outputs in the InputRow that begins at `start`."""
    return Actuation(float(rows[start + 3]), float(rows[start + 4]), float(rows[start + 5]), float(rows[start + 6]))


@kernel
def unpack_motion(rows: Any, start: int) -> Motion:
    """The measured motion in the InputRow that begins at `start`; what is not measured is 0."""
    speed, yaw, side, rate = rows[start + 7], rows[start + 8], rows[start + 9], rows[start + 10]
    return Motion(0.0, 0.0, 0.0, float(speed), float(side), float(yaw), 0.0, 0.0, float(rate), 0.0, 0.0, 0.0, 0.0)


@kernel
def is_pinned(rows: Any, start: int) -> bool:
    """Whether the chassis is set to the measured motion, in the InputRow that begins at `start`."""
    return rows[start + 11] > 0.5


@kernel
def pack_output(rows: Any, start: int, reported: Report, output: Actuation) -> int:
    """Write an OutputRow; returns the index after it."""
    rows[start] = reported.throttle_frac
    rows[start + 1] = reported.brake_frac
    rows[start + 2] = reported.steer_rad
    rows[start + 3] = output.throttle_frac
    rows[start + 4] = output.brake_frac
    rows[start + 5] = output.steer_rad
    return start + 6


@kernel
def pack_simulated(rows: Any, start: int, motion: Motion, report: Report, ins: Ins) -> int:
    """Write a SimulatedRow without its outputs, which are the actuators'; returns the index after it."""
    rows[start + 3] = motion.speed_rate_mps2
    rows[start + 4] = report.speed_mps
    rows[start + 5] = report.yaw_rate_radps
    rows[start + 6] = report.accel_mps2
    rows[start + 7] = report.lateral_accel_mps2
    rows[start + 8] = ins.speed_mps
    rows[start + 9] = ins.yaw_rate_radps
    rows[start + 10] = ins.accel_mps2
    rows[start + 11] = ins.x_m
    rows[start + 12] = ins.y_m
    rows[start + 13] = ins.heading_rad
    rows[start + 14] = 0.5 * (report.wheel_rl_radps + report.wheel_rr_radps)
    return start + 15


def make_actuator_loop(
    command_steps: Sequence[Any], output_steps: Sequence[Any], report_step: Any
) -> Callable[..., int]:
    """The loop from commands to outputs.

    Args:
        command_steps: steps of the effects on the commands of throttle, brake, steer.
        output_steps: steps of the effects on the actuators' outputs.
        report_step: step of the effects on the report.

    Returns:
        Kernel (params, state, input rows, output rows, dt_s) -> number of rows; it leaves row 0 as it is.
    """
    throttle_a, brake_a, steer_a = command_steps
    throttle_out, brake_out, steer_out = output_steps

    @kernel
    def run_actuators(params: ActuatorParts, state: ActuatorParts, inputs: Any, outputs: Any, dt_s: float) -> int:
        effects, own, ends, report = state
        rows = len(inputs) // N_INPUTS
        for k in range(1, rows):
            command = unpack_command(inputs, k * N_INPUTS)
            throttle_effect, throttle = throttle_a(params.command_effects[0], effects[0], command.throttle_frac, dt_s)
            brake_effect, brake = brake_a(params.command_effects[1], effects[1], command.brake_frac, dt_s)
            steer_effect, steer = steer_a(params.command_effects[2], effects[2], command.steer_rad, dt_s)
            effects = (throttle_effect, brake_effect, steer_effect)
            throttle_own, throttle = step_actuator(params.actuators[0], own[0], throttle, dt_s)
            brake_own, brake = step_actuator(params.actuators[1], own[1], brake, dt_s)
            steer_own, steer = step_actuator(params.actuators[2], own[2], steer, dt_s)
            own = (throttle_own, brake_own, steer_own)
            throttle_end, throttle = throttle_out(params.output_effects[0], ends[0], throttle, dt_s)
            brake_end, brake = brake_out(params.output_effects[1], ends[1], brake, dt_s)
            steer_end, steer = steer_out(params.output_effects[2], ends[2], steer, dt_s)
            ends = (throttle_end, brake_end, steer_end)
            output = Actuation(throttle, brake, steer, command.gear)
            sensed = report_of(SensorInput(AT_REST, output, command, NO_DRIVER), IDEAL_SENSORS.noise, 0)
            report, reported = report_step(params.report, report, sensed, dt_s)
            pack_output(outputs, k * N_OUTPUTS, reported, output)
        return rows

    return kept(run_actuators)


def make_vehicle_loop(
    chassis_effect_steps: Sequence[Any], report_step: Any, ins_step: Any, chassis_step: Any, observe: Any
) -> Callable[..., int]:
    """The loop from outputs to motion.

    Args:
        chassis_effect_steps: steps of the effects on throttle, brake, steer between actuators and chassis.
        report_step: step of the effects on the report.
        ins_step: step of the effects on the INS.
        chassis_step: step of the chassis.
        observe: sets the chassis's state to a measured motion.

    Returns:
        Kernel (params, state, input rows, simulated rows, dt_s) -> number of rows; it leaves simulated row 0 as it is.
    """
    throttle_b, brake_b, steer_b = chassis_effect_steps

    @kernel
    def run_vehicle(params: VehicleParts, state: VehicleParts, inputs: Any, simulated: Any, dt_s: float) -> int:
        effects, chassis, report, ins = state
        rows = len(inputs) // N_INPUTS
        road = Disturbance(0.0, 1.0)
        for k in range(1, rows):
            start = k * N_INPUTS
            command, output = unpack_command(inputs, start), unpack_output(inputs, start)
            throttle_effect, throttle = throttle_b(params.chassis_effects[0], effects[0], output.throttle_frac, dt_s)
            brake_effect, brake = brake_b(params.chassis_effects[1], effects[1], output.brake_frac, dt_s)
            steer_effect, steer = steer_b(params.chassis_effects[2], effects[2], output.steer_rad, dt_s)
            effects = (throttle_effect, brake_effect, steer_effect)
            applied = Actuation(throttle, brake, steer, command.gear)
            if is_pinned(inputs, start):
                chassis = observe(chassis, unpack_motion(inputs, start - N_INPUTS))
            chassis, motion = chassis_step(params.chassis, chassis, ChassisInput(applied, road), dt_s)
            sensed = report_of(SensorInput(motion, applied, command, NO_DRIVER), IDEAL_SENSORS.noise, 0)
            report, reported = report_step(params.report, report, sensed, dt_s)
            ins, placed = ins_step(params.ins, ins, ins_of(IDEAL_SENSORS, motion), dt_s)
            pack_simulated(simulated, k * N_SIMULATED, motion, reported, placed)
        return rows

    return kept(run_vehicle)
