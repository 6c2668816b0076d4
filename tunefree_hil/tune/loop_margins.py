"""Margins of the lateral loop over speed, from its frequency response, and the LQR weights that keep them.

The loop is cut at the steering command: LQR gains, dead time, lag of the steering, single-track model. No drive is
needed: all numbers come from the data sheet and from what was identified.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tunefree_hil.control.contract import VehicleConstants
from tunefree_hil.control.lateral.lqr import SPEED_FLOOR_MPS, gain_rows

Array = np.ndarray
Weights = tuple[float, float, float, float]  # Q1 to Q4

FREQUENCIES_RADPS = np.geomspace(0.02, 200.0, 400)
SPEEDS_MPS = (2.0, 4.0, 8.0, 12.0, 16.0, 20.0, 25.0)  # and the top speed: at and between the nodes of the gain schedule
ERROR_STEPS = 32  # factors of Q1 and Q3 down to 1/65536
RATE_STEPS = 16  # factors of Q2 and Q4 down to 1/65536


class LoopMarginCriteria(NamedTuple):
    """Least margins of the lateral loop that a textbook set has, at every speed."""

    min_phase_deg: float = 45.0  # 30 to 60 are usual in textbooks (Astrom and Murray, Feedback Systems, 10.3)
    delay_factor: float = 2.0  # the loop stays stable with so many times its dead time and lag


CRITERIA = LoopMarginCriteria()


class LateralLoop(NamedTuple):
    """The lateral loop of a vehicle.

    controller: Constants by which the LQR computes its gains.
    plant: Constants as identified.
    dead_time_s: Of the whole loop: steering, bus, sampling, filter.
    lag_s: Of the steering actuator.
    top_speed_mps: Highest speed at which the margins count.
    """

    controller: VehicleConstants
    plant: VehicleConstants
    dead_time_s: float
    lag_s: float
    top_speed_mps: float
    dt_s: float

    @property
    def speeds_mps(self) -> tuple[float, ...]:
        """The speeds at which the margins are computed."""
        return (*(speed for speed in SPEEDS_MPS if speed < self.top_speed_mps), self.top_speed_mps)


class LoopMargin(NamedTuple):
    """Phase margin and delay margin of a loop, the smallest over its gain crossovers; negative where it is unstable."""

    phase_deg: float
    delay_s: float


def margin_at(loop: LateralLoop, weights: Weights, speed_mps: float) -> LoopMargin:
    """The margins at one speed."""
    (gains,) = gain_rows([speed_mps], weights, loop.controller, loop.dt_s, shipped=False)
    return margin_from_response(FREQUENCIES_RADPS, open_loop_response(loop, max(speed_mps, SPEED_FLOOR_MPS), gains))


def keeps_margins(loop: LateralLoop, weights: Weights, criteria: LoopMarginCriteria = CRITERIA) -> bool:
    """Whether the loop has the margins of `criteria` at every speed."""
    more_delay_s = (criteria.delay_factor - 1.0) * (loop.dead_time_s + loop.lag_s)
    margins = (margin_at(loop, weights, speed) for speed in reversed(loop.speeds_mps))  # fast ones fail first
    return all(m.phase_deg >= criteria.min_phase_deg and m.delay_s >= more_delay_s for m in margins)


def open_loop_response(loop: LateralLoop, speed_mps: float, gains: list[float]) -> Array:
    """Response from steering command to LQR feedback at FREQUENCIES_RADPS, without its negative sign."""
    car = loop.plant
    cf, cr = car.front_stiffness_n_per_rad, car.rear_stiffness_n_per_rad
    lf, lr, mass_kg, inertia = car.front_axle_m, car.rear_axle_m, car.mass_kg, car.yaw_inertia_kgm2
    s, v = 1j * FREQUENCIES_RADPS, speed_mps
    turning = lr * cr - lf * cf
    # lateral speed and yaw rate of the vehicle: [vy', r'] = [[a11, a12], [a21, a22]] [vy, r] + [b1, b2] angle
    a11, a12 = -(cf + cr) / (mass_kg * v), turning / (mass_kg * v) - v
    a21, a22 = turning / (inertia * v), -(lf * lf * cf + lr * lr * cr) / (inertia * v)
    b1, b2 = cf / mass_kg, lf * cf / inertia
    determinant = (s - a11) * (s - a22) - a12 * a21
    lateral_mps = ((s - a22) * b1 + a12 * b2) / determinant
    yaw_radps = (a21 * b1 + (s - a11) * b2) / determinant
    heading_rad = yaw_radps / s
    rate_mps = lateral_mps + v * heading_rad
    feedback = gains[0] * rate_mps / s + gains[1] * rate_mps + gains[2] * heading_rad + gains[3] * yaw_radps
    return feedback * np.exp(-s * loop.dead_time_s) / (1.0 + s * loop.lag_s)


def margin_from_response(frequencies_radps: Array, response: Array) -> LoopMargin:
    """The smallest margins over all gain crossovers; infinite without one. The loop starts as a double integrator."""
    phase_rad = np.unwrap(np.angle(response))
    phase_rad = phase_rad - 2.0 * np.pi * np.round((phase_rad[0] + np.pi) / (2.0 * np.pi))
    level = np.log(np.abs(response))
    at = np.flatnonzero(level[:-1] * level[1:] < 0.0)
    if not len(at):
        return LoopMargin(math.inf, math.inf)
    share = level[at] / (level[at] - level[at + 1])
    crossover_radps = frequencies_radps[at] * (frequencies_radps[at + 1] / frequencies_radps[at]) ** share
    margin_rad = np.pi + phase_rad[at] + share * (phase_rad[at + 1] - phase_rad[at])
    return LoopMargin(math.degrees(float(np.min(margin_rad))), float(np.min(margin_rad / crossover_radps)))


@lru_cache(maxsize=8)
def reduce_to_margins(loop: LateralLoop, weights: Weights, criteria: LoopMarginCriteria = CRITERIA) -> Weights:
    """Reduce LQR weights until the loop keeps its margins at every speed.

    Q1 and Q3 (errors) share one factor, Q2 and Q4 (rates) another. The largest factor of the errors wins, and with it
    the largest of the rates. Factors are powers of sqrt(2) and 2: numbers far apart, so that rounding decides nothing.

    Returns:
        The weights; the smallest ones tried where none keeps the margins.
    """

    def scaled(error_step: int, rate_step: int) -> Weights:
        errors, rates = 2.0 ** (-0.5 * error_step), 2.0**-rate_step
        return (weights[0] * errors, weights[1] * rates, weights[2] * errors, weights[3] * rates)

    best, best_step = scaled(ERROR_STEPS, RATE_STEPS), ERROR_STEPS
    for rate_step in range(RATE_STEPS + 1):
        step = _first_true(best_step, lambda step: keeps_margins(loop, scaled(step, rate_step), criteria))  # noqa: B023
        if step is not None:
            best, best_step = scaled(step, rate_step), step
    return best


def _first_true(count: int, holds: Callable[[int], bool]) -> int | None:
    """The first step below `count` at which `holds`, by bisection; None where it holds at none.

    `holds` is false up to some step and true from it on.
    """
    if count == 0 or not holds(count - 1):
        return None
    low, high = 0, count - 1
    while low < high:
        middle = (low + high) // 2
        if holds(middle):
            high = middle
        else:
            low = middle + 1
    return low
