"""A block around the steering actuator of the data sheet, with all that a bench has between them.

Dead time, lag, motor, a tick each way, the low-pass filter of the command, and a noisy angle in steps of 0.1 degrees.
"""

from __future__ import annotations

import math
import random
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.kernel import Block
from tunefree_hil.control.contract import Settings, Setup, VehicleConstants
from tunefree_hil.control.filters import SecondOrderState, butterworth, second_order_step
from tunefree_hil.control.inner import mrac
from tunefree_hil.control.parameters import BASELINES

DT_S = 0.01
DEAD_TICKS, LAG_S, MOTOR_S = 12, 0.07, 0.015
STEP_RAD, NOISE_RAD = math.radians(0.1), 0.001
SLOPE_RADPS = 7.0
CALM = VehicleConstants(lateral_accel_mps2=1e6)  # the wheel's own limit is then the only bound


class Loop(NamedTuple):
    """Of each tick: demand, wheel, command and the reference's angle in rad, the gains, that of the command last."""

    demand_rad: np.ndarray
    wheel_rad: np.ndarray
    command_rad: np.ndarray
    reference_rad: np.ndarray
    gains: np.ndarray

    def second_half(self) -> Loop:
        return Loop(*(rows[len(rows) // 2 :] for rows in self))

    def reference_error_rad(self) -> float:
        """RMS of wheel against reference in the second half."""
        half = self.second_half()
        return float(np.sqrt(np.mean((half.wheel_rad - half.reference_rad) ** 2)))

    def command_rate_radps(self) -> float:
        """RMS in the second half."""
        return float(np.sqrt(np.mean(np.diff(self.second_half().command_rad) ** 2)) / DT_S)


def make_block(settings: Settings, vehicle: VehicleConstants = CALM, **values: float) -> Block:
    """MRAC with the shipped values and the study's clamp, others by name without 'mrac.'."""
    full = {**BASELINES["mrac_on"], "mrac.clamp_s": 0.01, **{f"mrac.{key}": value for key, value in values.items()}}
    return mrac.make(Setup(full, vehicle, None, settings, DT_S))


def drive(block: Block, seconds: float = 40.0, swing_rad: float = 2.0, lag_s: float = LAG_S) -> Loop:
    """Five seconds to each swing, with edges of SLOPE_RADPS."""
    state, chance, demand_rad = block.init(block.params, DT_S), random.Random(1), 0.0
    low_pass, delays, line = butterworth(10.0, DT_S), SecondOrderState(0.0, 0.0), [0.0] * DEAD_TICKS
    motor_rad = wheel_rad = 0.0
    rows: list[tuple[float, ...]] = []
    for k in range(round(seconds / DT_S)):
        goal_rad = swing_rad if (k * DT_S) % 5.0 < 2.5 else -swing_rad
        demand_rad += max(-SLOPE_RADPS * DT_S, min(SLOPE_RADPS * DT_S, goal_rad - demand_rad))
        measured_rad = round((wheel_rad + chance.gauss(0.0, NOISE_RAD)) / STEP_RAD) * STEP_RAD
        state, answer = block.step(block.params, state, (demand_rad, measured_rad, 8.0), DT_S)
        delays, smooth_rad = second_order_step(low_pass, delays, answer.steer_rad)
        line.append(smooth_rad)
        motor_rad += (1.0 - math.exp(-DT_S / lag_s)) * (line.pop(0) - motor_rad)
        wheel_rad += (1.0 - math.exp(-DT_S / MOTOR_S)) * (motor_rad - wheel_rad)
        reference_rad = state.reference[0] / block.params.percent_per_rad
        rows.append((demand_rad, wheel_rad, answer.steer_rad, reference_rad, *state.gains, state.command_gain))
    columns = np.array(rows)
    demand, wheel, command, reference = columns[:, :4].T
    return Loop(demand, wheel, command, reference, columns[:, 4:])
