"""The compiled loops over a drive: from commands to reported outputs, from outputs to motion and other reports."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.kernel import kept, kernel
from tunefree_hil.base.records import NAN, Actuation, Command, Disturbance, Ins, Motion, Report
from tunefree_hil.plant.actuation.actuators import step_actuator
from tunefree_hil.plant.measurement.sensors import WIDTH, SensorInput, SensorParams, ins_of, report_of
from tunefree_hil.plant.types import NOBODY, ChassisInput

TAKEN = 12  # numbers of a row of inputs
SHOWN = ("throttle_frac", "brake_frac", "steer_rad", "rate_mps2", "speed_mps", "yaw_rate_radps", "accel_mps2",
         "lateral_accel_mps2", "ins_speed_mps", "ins_yaw_rate_radps", "ins_accel_mps2", "ins_x_m", "ins_y_m",
         "ins_heading_rad", "wheels_radps")  # fmt: skip
WIDE = len(SHOWN)
SAID = 6  # numbers of a row of what actuators do: outputs of the three as their reports say them, and as they are
INS_COLUMNS = [i for i, name in enumerate(SHOWN) if name.startswith("ins_")]
STILL = Motion(*(0.0,) * len(Motion._fields))
EYES = SensorParams((0.0,) * WIDTH, 0.0, 0.0)


class Heads(NamedTuple):
    """Of the actuators (params or states): effects A, the channels' own, effects on their outputs, those on reports."""

    before: tuple[Any, Any, Any]
    own: tuple[Any, Any, Any]
    ends: tuple[Any, Any, Any]
    report: Any


class Bodies(NamedTuple):
    """Of the car behind them (params or states): effects B, chassis, effects on reports and INS."""

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


def make_heads(steps: Sequence[Any]) -> Callable[..., int]:
    """The loop over a drive from commands to outputs. steps: of throttle, brake, steer A, the same three on
    the actuators' outputs, report.
    """
    throttle_a, brake_a, steer_a, throttle_out, brake_out, steer_out, on_report = steps

    @kernel
    def heads(params: Heads, state: Heads, inputs: Any, said: Any, dt_s: float) -> int:
        before, own, ends, report = state
        rows = len(inputs) // TAKEN
        for k in range(1, rows):
            told = _told(inputs, k * TAKEN)
            state_1, throttle = throttle_a(params.before[0], before[0], told.throttle_frac, dt_s)
            state_2, brake = brake_a(params.before[1], before[1], told.brake_frac, dt_s)
            state_3, steer = steer_a(params.before[2], before[2], told.steer_rad, dt_s)
            before = (state_1, state_2, state_3)
            own_1, throttle = step_actuator(params.own[0], own[0], throttle, dt_s)
            own_2, brake = step_actuator(params.own[1], own[1], brake, dt_s)
            own_3, steer = step_actuator(params.own[2], own[2], steer, dt_s)
            own = (own_1, own_2, own_3)
            end_1, throttle = throttle_out(params.ends[0], ends[0], throttle, dt_s)
            end_2, brake = brake_out(params.ends[1], ends[1], brake, dt_s)
            end_3, steer = steer_out(params.ends[2], ends[2], steer, dt_s)
            ends = (end_1, end_2, end_3)
            look = SensorInput(STILL, Actuation(throttle, brake, steer, told.gear), told, NOBODY)
            report, heard = on_report(params.report, report, report_of(look, EYES.noise, 0), dt_s)
            at = k * SAID
            said[at] = heard.throttle_frac
            said[at + 1] = heard.brake_frac
            said[at + 2] = heard.steer_rad
            said[at + 3] = throttle
            said[at + 4] = brake
            said[at + 5] = steer
        return rows

    return kept(heads)


def make_ride(steps: Sequence[Any], chassis_step: Any, observe: Any) -> Callable[..., int]:
    """The loop over a drive from outputs to motion. steps: of throttle B, brake B, steer B, report, INS."""
    throttle_b, brake_b, steer_b, on_report, on_ins = steps

    @kernel
    def ride(params: Bodies, state: Bodies, inputs: Any, shown: Any, dt_s: float) -> int:
        behind, chassis, report, ins = state
        rows = len(inputs) // TAKEN
        road = Disturbance(0.0, 1.0)
        for k in range(1, rows):
            at = k * TAKEN
            told = _told(inputs, at)
            behind_1, throttle = throttle_b(params.behind[0], behind[0], float(inputs[at + 3]), dt_s)
            behind_2, brake = brake_b(params.behind[1], behind[1], float(inputs[at + 4]), dt_s)
            behind_3, steer = steer_b(params.behind[2], behind[2], float(inputs[at + 5]), dt_s)
            behind = (behind_1, behind_2, behind_3)
            if inputs[at + 11] > 0.5:
                chassis = observe(chassis, _measured(inputs, at - TAKEN))
            felt = Actuation(throttle, brake, steer, told.gear)
            chassis, motion = chassis_step(params.chassis, chassis, ChassisInput(felt, road), dt_s)
            look = SensorInput(motion, felt, told, NOBODY)
            report, said = on_report(params.report, report, report_of(look, EYES.noise, 0), dt_s)
            ins, placed = on_ins(params.ins, ins, ins_of(EYES, motion), dt_s)
            show(shown, k * WIDE, motion, said, placed)
        return rows

    return kept(ride)


@kernel
def show(shown: Any, at: int, motion: Motion, said: Report, placed: Ins) -> int:
    """A row of SHOWN but for the outputs, which are the actuators' to say."""
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
