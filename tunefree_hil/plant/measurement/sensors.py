"""Measurement of the motion: chassis reports and INS, with noise, bias and INS latency.

Noise is drawn before tick 0 by `noise_table`; the kernel only reads it. The codec quantises; the report delay is the
bench's (`plant/actuation/delay.py`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block, kernel, table
from tunefree_hil.base.maths import wrap_rad
from tunefree_hil.base.records import Actuation, Command, Ins, Measurement, Motion, Report
from tunefree_hil.plant.types import Driver

NOISY = (
    "report.throttle_frac", "report.brake_frac", "report.steer_rad", "report.speed_mps",
    "report.wheel_fl_radps", "report.wheel_fr_radps", "report.wheel_rl_radps", "report.wheel_rr_radps",
    "report.accel_mps2", "report.lateral_accel_mps2", "report.yaw_rate_radps",
    "ins.x_m", "ins.y_m", "ins.heading_rad", "ins.speed_mps", "ins.accel_mps2", "ins.yaw_rate_radps",
)  # fmt: skip
WIDTH = len(NOISY)


class SensorParams(NamedTuple):
    """noise: table of rows of WIDTH numbers in the order of NOISY, one a tick, added to the true values (bias
    included); after the last row it starts again. The INS is on the centre line, ins_ahead_m ahead of the rear axle;
    its acceleration is the rate of speed, or specific force where ins_specific_force is 1.
    """

    noise: Any
    ins_ahead_m: float = 0.0
    ins_specific_force: float = 0.0


class SensorInput(NamedTuple):
    """The quantities to measure in one tick."""

    motion: Motion
    actuation: Actuation
    command: Command  # as applied by the by-wire unit, echoed in the report
    driver: Driver


class SensorState(NamedTuple):
    """Row of the noise table, and the delayed INS records, oldest first."""

    row: int
    late: Any


def noise_table(sigma: Mapping[str, float], bias: Mapping[str, float], ticks: int, seed: int) -> Any:
    """Rows for ticks 0..ticks: white Gaussian noise of `sigma` about `bias`, by record field ('report.speed_mps').

    Every field has its own random stream. Raises InputError for a field that is not in NOISY. Without noise there is
    one row for all ticks.
    """
    unknown = sorted((set(sigma) | set(bias)) - set(NOISY))
    if unknown:
        raise InputError(
            f"no noise for {', '.join(unknown)}",
            code="unknown_noise_field",
            key=f"noise.{unknown[0]}",
            hint=f"there is noise for {', '.join(NOISY)}",
        )
    rows = ticks + 1 if any(sigma.values()) else 1
    drawn = np.zeros((rows, WIDTH))
    for column, name in enumerate(NOISY):
        if sigma.get(name, 0.0):
            stream = np.random.default_rng([seed, column])
            drawn[:, column] = sigma[name] * stream.standard_normal(rows)
        drawn[:, column] += bias.get(name, 0.0)
    return table(drawn.ravel().tolist())


@kernel
def report_of(x: SensorInput, noise: Any, offset: int) -> Report:
    """The chassis reports; offset: index of this tick's noise."""
    motion, out, command, driver = x.motion, x.actuation, x.command, x.driver
    return Report(
        driver.throttle_frac,
        command.throttle_frac,
        out.throttle_frac + noise[offset],
        driver.brake_frac,
        command.brake_frac,
        out.brake_frac + noise[offset + 1],
        command.steer_rad,
        out.steer_rad + noise[offset + 2],
        motion.speed_mps + noise[offset + 3],
        motion.wheel_fl_radps + noise[offset + 4],
        motion.wheel_fr_radps + noise[offset + 5],
        motion.wheel_rl_radps + noise[offset + 6],
        motion.wheel_rr_radps + noise[offset + 7],
        motion.accel_mps2 + noise[offset + 8],
        motion.lateral_accel_mps2 + noise[offset + 9],
        motion.yaw_rate_radps + noise[offset + 10],
        out.gear,
        command.accel_mps2,
        command.steer_torque_nm,
        driver.steer_torque_nm,
    )


@kernel
def ins_of(params: SensorParams, motion: Motion) -> Ins:
    """The INS record without latency and noise; the heading is wrapped after noise is added."""
    ahead_m, heading = params.ins_ahead_m, motion.heading_rad
    accel = motion.accel_mps2 if params.ins_specific_force > 0.5 else motion.speed_rate_mps2
    return Ins(
        motion.x_m + ahead_m * math.cos(heading),
        motion.y_m + ahead_m * math.sin(heading),
        heading,
        motion.speed_mps,
        accel,
        motion.yaw_rate_radps,
    )


@kernel
def noisy_ins(ins: Ins, noise: Any, offset: int) -> Ins:
    """The INS record with this tick's noise."""
    return Ins(
        ins.x_m + noise[offset + 11],
        ins.y_m + noise[offset + 12],
        wrap_rad(ins.heading_rad + noise[offset + 13]),
        ins.speed_mps + noise[offset + 14],
        ins.accel_mps2 + noise[offset + 15],
        ins.yaw_rate_radps + noise[offset + 16],
    )


def sensors(params: SensorParams, ins_ticks: int = 0) -> Block:
    """Block SensorInput -> Measurement whose INS is `ins_ticks` ticks late. `init` has no delayed INS record."""

    def init(params: SensorParams, dt_s: float) -> SensorState:
        return SensorState(0, (Ins(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),) * ins_ticks)

    if ins_ticks == 0:

        @kernel
        def step_now(params: SensorParams, state: SensorState, x: SensorInput, dt_s: float) -> Any:
            offset = state.row * WIDTH
            row = 0 if offset + WIDTH >= len(params.noise) else state.row + 1
            ins = noisy_ins(ins_of(params, x.motion), params.noise, offset)
            return SensorState(row, state.late), Measurement(report_of(x, params.noise, offset), ins)

        return Block(init, step_now, params)

    @kernel
    def step(params: SensorParams, state: SensorState, x: SensorInput, dt_s: float) -> Any:
        offset = state.row * WIDTH
        row = 0 if offset + WIDTH >= len(params.noise) else state.row + 1
        late = state.late[1:] + (ins_of(params, x.motion),)
        ins = noisy_ins(state.late[0], params.noise, offset)
        return SensorState(row, late), Measurement(report_of(x, params.noise, offset), ins)

    return Block(init, step, params)


def rolled_in(params: SensorParams, first: Motion, ins_ticks: int, dt_s: float) -> SensorState:
    """State at tick 0 of a car that has been rolling straight as in `first`, with its delayed INS records."""
    late = []
    for k in range(ins_ticks, 0, -1):
        back_m = k * dt_s * first.speed_mps
        x_m = first.x_m - back_m * math.cos(first.heading_rad)
        y_m = first.y_m - back_m * math.sin(first.heading_rad)
        late.append(ins_of(params, first._replace(x_m=x_m, y_m=y_m)))
    return SensorState(0, tuple(late))
