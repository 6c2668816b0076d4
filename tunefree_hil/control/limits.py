"""Limits of the steering demand after the inner loop, in the order of docs/reference/apollo.md.

clamp to atan(a_lat L / v^2) -> low-pass -> clamp to the wheel's limit -> hold near standstill -> clamp of the rate.

The published bound is without side slip: the MKZ, which understeers, gets half of a_lat with it at 27 m/s, and leaves
the lane in a bend that it could drive. With a lateral part that knows the steering map, the bound is that of the map.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.control.contract import Setup
from tunefree_hil.control.filters import SecondOrder, SecondOrderState, butterworth, second_order_step
from tunefree_hil.control.steering_map import steady_slip_rad


class SteerBound(NamedTuple):
    """Bound of the steering-wheel angle by speed."""

    lateral_accel_mps2: float
    wheelbase_m: float
    steer_ratio: float
    steer_limit_rad: float
    slip_rad: float = 0.0  # at the road wheel: what understeer adds at lateral_accel_mps2; 0 as published


class LimitParams(NamedTuple):
    """Constants of the chain."""

    bound: SteerBound
    low_pass: SecondOrder
    hold_speed_mps: float
    steer_rate_radps: float


class LimitState(NamedTuple):
    """The filter's delays and the last command."""

    low_pass: SecondOrderState
    steer_rad: float


def steer_bound_of(setup: Setup) -> SteerBound:
    """The bound of a vehicle: as published, or with the understeer of its steering map. Oversteer narrows nothing."""
    vehicle, steering = setup.vehicle, setup.steering
    accel_mps2, limit_rad = vehicle.lateral_accel_mps2, vehicle.steer_limit_rad
    if not setup.is_bound_by_map:
        return SteerBound(accel_mps2, vehicle.wheelbase_m, vehicle.steer_ratio, limit_rad)
    slip_rad = max(steady_slip_rad(steering, accel_mps2), 0.0)
    return SteerBound(accel_mps2, steering.length_m, steering.steer_ratio, limit_rad, slip_rad)


def make(setup: Setup) -> Block:
    """x = (steer demand rad, speed m/s) -> steer command rad. The rate limit is the vehicle's (Apollo: none)."""
    low_pass = butterworth(setup.settings.cutoff_hz, setup.dt_s)
    bound = steer_bound_of(setup)
    return Block(
        init, step, LimitParams(bound, low_pass, setup.settings.hold_speed_mps, setup.vehicle.steer_rate_radps)
    )


def init(params: LimitParams, dt_s: float) -> LimitState:
    return LimitState(SecondOrderState(0.0, 0.0), 0.0)


@kernel
def steer_bound(bound: SteerBound, speed_mps: float) -> float:
    """Largest steering-wheel angle at a speed: atan(a_lat L / v^2) and slip at the road wheel, within its limit."""
    square = speed_mps * speed_mps
    if square < 1e-6:
        return bound.steer_limit_rad
    rolling_rad = math.atan(bound.lateral_accel_mps2 * bound.wheelbase_m / square)
    wheel_rad = (rolling_rad + bound.slip_rad) * bound.steer_ratio
    return wheel_rad if wheel_rad < bound.steer_limit_rad else bound.steer_limit_rad


@kernel
def step(params: LimitParams, state: LimitState, x: tuple[float, float], dt_s: float) -> tuple[LimitState, float]:
    """One tick of the chain."""
    demand_rad, speed_mps = x
    bound_rad = steer_bound(params.bound, speed_mps)
    low_pass, smooth_rad = second_order_step(params.low_pass, state.low_pass, clamp(demand_rad, -bound_rad, bound_rad))
    steer_rad = clamp(smooth_rad, -params.bound.steer_limit_rad, params.bound.steer_limit_rad)
    if abs(speed_mps) < params.hold_speed_mps:
        steer_rad = state.steer_rad
    reach_rad = params.steer_rate_radps * dt_s
    steer_rad = clamp(steer_rad, state.steer_rad - reach_rad, state.steer_rad + reach_rad)
    return LimitState(low_pass, steer_rad), steer_rad
