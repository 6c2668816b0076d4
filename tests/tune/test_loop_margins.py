"""Margins of the lateral loop against known transfer functions and a simulated loop, and weights that keep them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tunefree_hil.control.contract import VehicleConstants
from tunefree_hil.control.lateral.lqr import gain_rows
from tunefree_hil.tune.loop_margins import (
    FREQUENCIES_RADPS,
    LateralLoop,
    LoopMarginCriteria,
    keeps_margins,
    margin_at,
    margin_from_response,
    reduce_to_margins,
)

MKZ = VehicleConstants()
LOOP = LateralLoop(MKZ, MKZ, dead_time_s=0.147, lag_s=0.07, top_speed_mps=30.0, dt_s=0.01)
CALM = (0.015, 0.0, 0.3, 0.0)


def test_the_margins_of_a_double_integrator_with_lead() -> None:
    """L = k (1 + s T) / s^2 with crossover at 2 rad/s: phase margin atan(2 T)."""
    s = 1j * FREQUENCIES_RADPS
    lead_s = 0.8
    gain = 4.0 / math.hypot(1.0, 2.0 * lead_s)
    margin = margin_from_response(FREQUENCIES_RADPS, gain * (1.0 + s * lead_s) / s**2)
    assert margin.phase_deg == pytest.approx(math.degrees(math.atan(2.0 * lead_s)), abs=0.1)
    assert margin.delay_s == pytest.approx(math.atan(2.0 * lead_s) / 2.0, rel=0.01)
    assert margin_from_response(FREQUENCIES_RADPS, 1e-9 / (1.0 + s)).phase_deg == math.inf


def swing_after(loop: LateralLoop, gains: list[float], speed_mps: float, extra_delay_s: float) -> float:
    """Lateral error at the end of 40 s over its largest one, of a loop in steps of 1 ms that starts 1 m off."""
    dt_s, car = 0.001, loop.plant
    cf, cr = car.front_stiffness_n_per_rad, car.rear_stiffness_n_per_rad
    queue = [0.0] * round((loop.dead_time_s + extra_delay_s) / dt_s)
    lateral_m, lateral_mps, heading_rad, yaw_radps, wheel_rad = 1.0, 0.0, 0.0, 0.0, 0.0
    errors = []
    for _ in range(40_000):
        rate_mps = lateral_mps + speed_mps * heading_rad
        queue.append(-float(np.dot(gains, (lateral_m, rate_mps, heading_rad, yaw_radps))))
        wheel_rad += (queue.pop(0) - wheel_rad) * dt_s / loop.lag_s
        front_n = cf * (wheel_rad - (lateral_mps + car.front_axle_m * yaw_radps) / speed_mps)
        rear_n = -cr * (lateral_mps - car.rear_axle_m * yaw_radps) / speed_mps
        lateral_mps += dt_s * ((front_n + rear_n) / car.mass_kg - speed_mps * yaw_radps)
        yaw_radps += dt_s * (car.front_axle_m * front_n - car.rear_axle_m * rear_n) / car.yaw_inertia_kgm2
        heading_rad += dt_s * yaw_radps
        lateral_m += dt_s * (lateral_mps + speed_mps * heading_rad)
        errors.append(abs(lateral_m))
        if abs(lateral_m) > 1e3:
            return math.inf
    return max(errors[-5000:]) / max(errors)


@pytest.mark.parametrize("speed_mps", [8.0, 20.0])
def test_the_delay_margin_is_where_a_simulated_loop_becomes_unstable(speed_mps: float) -> None:
    loop = LOOP._replace(top_speed_mps=speed_mps)
    (gains,) = gain_rows([speed_mps], CALM, MKZ, loop.dt_s, shipped=False)
    margin = margin_at(loop, CALM, speed_mps)
    assert 0.05 < margin.delay_s < 0.5
    assert swing_after(loop, gains, speed_mps, 0.9 * margin.delay_s) < 0.1
    assert swing_after(loop, gains, speed_mps, 1.1 * margin.delay_s) > 0.5


def test_weights_that_keep_their_margins_stay() -> None:
    """A loop without much delay at low speed bears any weight."""
    quick = LOOP._replace(dead_time_s=0.005, lag_s=0.005, top_speed_mps=3.0)
    weights = (0.1, 0.1, 0.1, 0.1)
    assert keeps_margins(quick, weights) and reduce_to_margins(quick, weights) == weights


@pytest.mark.parametrize("dead_time_s", [0.05, 0.15, 0.3])
def test_reduced_weights_keep_the_margins_and_the_next_larger_do_not(dead_time_s: float) -> None:
    loop = LOOP._replace(dead_time_s=dead_time_s)
    weights = (0.02, 0.02, 0.02, 0.02)
    reduced = reduce_to_margins(loop, weights)
    assert keeps_margins(loop, reduced) and not keeps_margins(loop, weights)
    assert reduced[0] == reduced[2] and reduced[1] == reduced[3]
    for rate_step in range(17):
        error, rate = reduced[0] * math.sqrt(2.0), 0.02 * 2.0**-rate_step
        larger = (error, rate, error, rate)
        assert reduced[0] == weights[0] or not keeps_margins(loop, larger)


def test_more_delay_gives_smaller_weights() -> None:
    weights = (0.02, 0.02, 0.02, 0.02)
    first = [reduce_to_margins(LOOP._replace(dead_time_s=delay_s), weights)[0] for delay_s in (0.02, 0.15, 0.3)]
    assert first == sorted(first, reverse=True) and first[0] > first[-1]


def test_where_no_weight_keeps_the_margins_the_smallest_are_taken() -> None:
    impossible = LoopMarginCriteria(min_phase_deg=170.0)
    assert reduce_to_margins(LOOP, (1.0, 1.0, 1.0, 1.0), impossible) == (2.0**-16,) * 4
