"""The compiled loops over a drive: from commands to reported outputs, and from outputs to motion, reports and INS.

Each loop takes and gives flat rows of floats; a row is a record of this module, its fields in order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Port
from tunefree_hil.base.kernel import inlined, kept, kernel
from tunefree_hil.base.records import NAN, Actuation, Command, Disturbance, Ins, Measurement, Motion, Report
from tunefree_hil.base.rows import pack_ins
from tunefree_hil.gap.model.effect_chain import PORTS_B
from tunefree_hil.plant.actuation.actuators import ActuatorParams, actuators
from tunefree_hil.plant.measurement.sensors import WIDTH, SensorInput, SensorParams, ins_of, report_of
from tunefree_hil.plant.ports import Effects, channels_of, make_measurement_effects, upto_report
from tunefree_hil.plant.types import NO_DRIVER, BodyInput, ChassisInput
from tunefree_hil.plant.vehicle import BodyParams, BodyState, BodySteps, make_tick

AT_REST = Motion(*(0.0,) * len(Motion._fields))
IDEAL_SENSORS = SensorParams((0.0,) * WIDTH, 0.0, 0.0)
NOT_USED: Any = 0.0  # params or state of a part that a loop lacks


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
    """One tick of what is compared with the measurement; it ends with an INS record."""

    throttle_frac: Any
    brake_frac: Any
    steer_rad: Any
    rate_mps2: Any
    speed_mps: Any
    yaw_rate_radps: Any
    accel_mps2: Any
    lateral_accel_mps2: Any
    wheels_radps: Any
    ins_x_m: Any
    ins_y_m: Any
    ins_heading_rad: Any
    ins_speed_mps: Any
    ins_accel_mps2: Any
    ins_yaw_rate_radps: Any


N_INPUTS, N_OUTPUTS, N_SIMULATED = len(InputRow._fields), len(OutputRow._fields), len(SimulatedRow._fields)
SIMULATED_FIELDS = SimulatedRow._fields
INS_COLUMNS = [i for i, name in enumerate(SIMULATED_FIELDS) if name.startswith("ins_")]


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
    rows[start + 8] = 0.5 * (report.wheel_rl_radps + report.wheel_rr_radps)
    return pack_ins(rows, start + 9, ins)


@kernel
def _park(params: float, state: float, x: ChassisInput, dt_s: float) -> tuple[float, Motion]:
    """A chassis that stands."""
    return state, AT_REST


@kernel
def _take_output(params: float, state: Actuation, x: Command, dt_s: float) -> tuple[Actuation, Actuation]:
    """Actuators whose output is their state."""
    return state, state


@kernel
def _measure(params: float, state: float, x: SensorInput, dt_s: float) -> tuple[float, Measurement]:
    """Sensors without noise and delay."""
    return state, Measurement(report_of(x, IDEAL_SENSORS.noise, 0), ins_of(IDEAL_SENSORS, x.motion))


def make_actuator_loop(effects: Effects) -> Callable[..., int]:
    """The loop from commands to outputs: a vehicle whose chassis stands.

    Args:
        effects: chains on commands, on the actuators' outputs and on the report, by port; other ports are not used.

    Returns:
        Kernel (params, state, input rows, output rows, dt_s) -> number of rows; it leaves row 0 as it is.
    """
    front = upto_report(effects, actuators(*(ActuatorParams(),) * 3))
    behind = channels_of((), PORTS_B, Actuation)
    ends = make_measurement_effects([one for one in effects if one[0] is Port.REPORT])
    tick = inlined(make_tick(BodySteps(front.step, behind.step, _park, _measure, ends.step)))

    @kernel
    def run_actuators(params: BodyParams, state: BodyState, inputs: Any, outputs: Any, dt_s: float) -> int:
        rows = len(inputs) // N_INPUTS
        road = Disturbance(0.0, 1.0, 0.0, 0.0)
        for k in range(1, rows):
            command = unpack_command(inputs, k * N_INPUTS)
            state, y = tick(params, state, BodyInput(command, NO_DRIVER, road), dt_s)
            pack_output(outputs, k * N_OUTPUTS, y.measurement.report, y.actuation)
        return rows

    return kept(run_actuators)


def make_vehicle_loop(effects: Effects, chassis_step: Any, observe: Any) -> Callable[..., int]:
    """The loop from outputs to motion: a vehicle whose actuators have the outputs of the input rows.

    Args:
        effects: chains between actuators and chassis, on report and INS, by port; other ports are not used.
        chassis_step: step of the chassis.
        observe: sets the chassis's state to a measured motion.

    Returns:
        Kernel (params, state, input rows, simulated rows, dt_s) -> number of rows; it leaves simulated row 0 as it is.
    """
    behind, ends = channels_of(effects, PORTS_B, Actuation), make_measurement_effects(effects)
    tick = inlined(make_tick(BodySteps(_take_output, behind.step, chassis_step, _measure, ends.step)))

    @kernel
    def run_vehicle(params: BodyParams, state: BodyState, inputs: Any, simulated: Any, dt_s: float) -> int:
        rows = len(inputs) // N_INPUTS
        road = Disturbance(0.0, 1.0, 0.0, 0.0)
        for k in range(1, rows):
            start = k * N_INPUTS
            chassis = state.chassis
            if is_pinned(inputs, start):
                chassis = observe(chassis, unpack_motion(inputs, start - N_INPUTS))
            state = BodyState(unpack_output(inputs, start), state.behind, chassis, state.sensors, state.ends)
            state, y = tick(params, state, BodyInput(unpack_command(inputs, start), NO_DRIVER, road), dt_s)
            pack_simulated(simulated, k * N_SIMULATED, y.motion, y.measurement.report, y.measurement.ins)
        return rows

    return kept(run_vehicle)
