"""The loop over a drive that is compiled: a tick of commands, effects, actuators, car, sensors, effects on reports."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.kernel import kept, kernel
from tunefree_hil.base.records import NAN, Actuation, Command, Disturbance, Ins, Motion, Report
from tunefree_hil.plant.actuators import ActuatorParams, step_actuator
from tunefree_hil.plant.body import NOBODY, ChassisInput
from tunefree_hil.plant.sensors import WIDTH, SensorInput, SensorParams, ins_of, report_of

TAKEN = 12  # numbers of a row of inputs
SHOWN = ("throttle_frac", "brake_frac", "steer_rad", "rate_mps2", "speed_mps", "yaw_rate_radps", "accel_mps2",
         "lateral_accel_mps2", "ins_speed_mps", "ins_yaw_rate_radps", "ins_accel_mps2", "ins_x_m", "ins_y_m",
         "ins_heading_rad", "wheels_radps")  # fmt: skip
WIDE = len(SHOWN)
INS_COLUMNS = [i for i, name in enumerate(SHOWN) if name.startswith("ins_")]


class Params(NamedTuple):
    """Of the whole graph: effects A with actuators, effects B, chassis, effects on reports and INS."""

    before: tuple[Any, Any, Any]
    actuators: tuple[ActuatorParams, ActuatorParams, ActuatorParams]
    behind: tuple[Any, Any, Any]
    chassis: Any
    report: Any
    ins: Any


class State(NamedTuple):
    """Of the whole graph, part by part."""

    before: tuple[Any, Any, Any]
    actuators: tuple[Any, Any, Any]
    behind: tuple[Any, Any, Any]
    chassis: Any
    report: Any
    ins: Any


@kernel
def _told(commands: Any, at: int) -> Command:
    return Command(
        float(commands[at]), float(commands[at + 1]), float(commands[at + 2]), float(commands[at + 6]), NAN, NAN
    )


@kernel
def _measured(inputs: Any, at: int) -> Motion:
    speed, yaw, side, rate = inputs[at + 7], inputs[at + 8], inputs[at + 9], inputs[at + 10]
    return Motion(0.0, 0.0, 0.0, float(speed), float(side), float(yaw), 0.0, 0.0, float(rate), 0.0, 0.0, 0.0, 0.0)


def make_ride(steps: Sequence[Any], chassis_step: Any, observe: Any) -> Callable[..., int]:
    """The loop over a drive. steps: of the six scalar ports, of the report's and of the INS's effects."""
    throttle_a, brake_a, steer_a, throttle_b, brake_b, steer_b, on_report, on_ins = steps
    eyes = SensorParams((0.0,) * WIDTH, 0.0, 0.0)

    @kernel
    def ride(params: Params, state: State, inputs: Any, shown: Any, source: Any, dt_s: float) -> int:
        before, own, behind, chassis, report, ins = state
        rows = len(inputs) // TAKEN
        road = Disturbance(0.0, 1.0)
        for k in range(1, rows):
            at = k * TAKEN
            told = _told(inputs, at)
            state_1, throttle = throttle_a(params.before[0], before[0], told.throttle_frac, dt_s)
            state_2, brake = brake_a(params.before[1], before[1], told.brake_frac, dt_s)
            state_3, steer = steer_a(params.before[2], before[2], told.steer_rad, dt_s)
            before = (state_1, state_2, state_3)
            own_1, throttle = step_actuator(params.actuators[0], own[0], throttle, dt_s)
            own_2, brake = step_actuator(params.actuators[1], own[1], brake, dt_s)
            own_3, steer = step_actuator(params.actuators[2], own[2], steer, dt_s)
            own = (own_1, own_2, own_3)
            out = Actuation(throttle, brake, steer, told.gear)
            if source[0] > 0.5:
                throttle = float(inputs[at + 3])
            if source[1] > 0.5:
                brake = float(inputs[at + 4])
            if source[2] > 0.5:
                steer = float(inputs[at + 5])
            behind_1, throttle = throttle_b(params.behind[0], behind[0], throttle, dt_s)
            behind_2, brake = brake_b(params.behind[1], behind[1], brake, dt_s)
            behind_3, steer = steer_b(params.behind[2], behind[2], steer, dt_s)
            behind = (behind_1, behind_2, behind_3)
            if inputs[at + 11] > 0.5:
                chassis = observe(chassis, _measured(inputs, at - TAKEN))
            felt = Actuation(throttle, brake, steer, told.gear)
            chassis, motion = chassis_step(params.chassis, chassis, ChassisInput(felt, road), dt_s)
            look = SensorInput(motion, out, told, NOBODY)
            report, said = on_report(params.report, report, report_of(look, eyes.noise, 0), dt_s)
            ins, placed = on_ins(params.ins, ins, ins_of(eyes, motion), dt_s)
            show(shown, k * WIDE, motion, said, placed)
        return rows

    return kept(ride)


@kernel
def show(shown: Any, at: int, motion: Motion, said: Report, placed: Ins) -> int:
    """A row of SHOWN."""
    shown[at] = said.throttle_frac
    shown[at + 1] = said.brake_frac
    shown[at + 2] = said.steer_rad
    shown[at + 3] = motion.speed_rate_mps2
    shown[at + 4] = said.speed_mps
    shown[at + 5] = said.yaw_rate_radps
    shown[at + 6] = said.accel_mps2
    shown[at + 7] = said.lateral_accel_mps2
    shown[at + 8] = placed.speed_mps
    shown[at + 9] = placed.yaw_rate_radps
    shown[at + 10] = placed.accel_mps2
    shown[at + 11] = placed.x_m
    shown[at + 12] = placed.y_m
    shown[at + 13] = placed.heading_rad
    shown[at + 14] = 0.5 * (said.wheel_rl_radps + said.wheel_rr_radps)
    return at
