"""Apply Blocks on one signal to a field of a Report; the other fields are unchanged.

A step is wrapped once for all its effects, so it is compiled once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from tunefree_hil.base.contracts import Block
from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.records import Report

Step = Callable[..., Any]


@kernel
def replace_sensed(
    x: Report, steer: float, speed: float, wheels: tuple[float, float, float, float], accel: float, yaw: float
) -> Report:
    """The report with other values of the chassis sensors."""
    return Report(
        x.throttle_input_frac, x.throttle_command_frac, x.throttle_frac, x.brake_input_frac, x.brake_command_frac,
        x.brake_frac, x.steer_command_rad, steer, speed, wheels[0], wheels[1], wheels[2], wheels[3], accel,
        x.lateral_accel_mps2, yaw, x.gear, x.accel_command_mps2, x.steer_torque_command_nm, x.steer_torque_nm,
    )  # fmt: skip


@kernel
def wheels_of(x: Report) -> tuple[float, float, float, float]:
    """Wheel speeds, FL FR RL RR."""
    return x.wheel_fl_radps, x.wheel_fr_radps, x.wheel_rl_radps, x.wheel_rr_radps


@cache
def _on_steer(inner: Step) -> Step:
    @kernel
    def step(params: Any, state: Any, x: Report, dt_s: float) -> tuple[Any, Report]:
        new, steer = inner(params, state, x.steer_rad, dt_s)
        return new, replace_sensed(x, steer, x.speed_mps, wheels_of(x), x.accel_mps2, x.yaw_rate_radps)

    return step


@cache
def _on_accel(inner: Step) -> Step:
    @kernel
    def step(params: Any, state: Any, x: Report, dt_s: float) -> tuple[Any, Report]:
        new, accel = inner(params, state, x.accel_mps2, dt_s)
        return new, replace_sensed(x, x.steer_rad, x.speed_mps, wheels_of(x), accel, x.yaw_rate_radps)

    return step


@cache
def _on_yaw_rate(inner: Step) -> Step:
    @kernel
    def step(params: Any, state: Any, x: Report, dt_s: float) -> tuple[Any, Report]:
        new, yaw = inner(params, state, x.yaw_rate_radps, dt_s)
        return new, replace_sensed(x, x.steer_rad, x.speed_mps, wheels_of(x), x.accel_mps2, yaw)

    return step


def on_steer(block: Block) -> Block:
    """`block`, on the reported steering-wheel angle [rad]."""
    return Block(block.init, _on_steer(block.step), block.params)


def on_accel(block: Block) -> Block:
    """`block`, on the reported longitudinal acceleration [m/s2]."""
    return Block(block.init, _on_accel(block.step), block.params)


def on_yaw_rate(block: Block) -> Block:
    """`block`, on the reported yaw rate [rad/s]."""
    return Block(block.init, _on_yaw_rate(block.step), block.params)
