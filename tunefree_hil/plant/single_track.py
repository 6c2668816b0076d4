"""Plant kind `physics`: a single-track car on data-sheet constants (the nominal model).

Tyres that saturate, kinematic below walking pace, force balance along the car with a smooth power-limited drive map
and a linear brake. One step a tick: an L-stable Rosenbrock method of order 2 (Verwer et al. 1999, ROS2) for side speed
and yaw rate, whose time constants fall below the tick at low speed, which is Heun's method for the slow forward speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.records import Motion
from tunefree_hil.plant.data_sheet import DEFAULTS, SingleTrack, constants_of
from tunefree_hil.plant.forces.track_forces import GAMMA, LOW_MPS, Push, axle_n, forward_n, push_of
from tunefree_hil.plant.forces.tyre_relaxation import AT_EASE, Axles, relaxed_step
from tunefree_hil.plant.kinematics import Velocity, moved, with_velocity
from tunefree_hil.plant.types import ChassisInput, ChassisParams, Plant, rolling_motion

FULL_MPS = 1.5  # dynamic above, kinematic below LOW_MPS, blended between
BLEND_MPS = FULL_MPS - LOW_MPS


class SingleTrackState(NamedTuple):
    """The motion, energy dissipated by the brakes, and side forces of relaxing tyres."""

    motion: Motion
    braked_j: float
    axles: Axles = AT_EASE


class Advance(NamedTuple):
    """Result of a tick: velocities at its end, gravity forward and to the left, brake force, cosine and sine of the
    front wheels, and side forces of relaxing tyres.
    """

    velocity: Velocity
    gravity_mps2: tuple[float, float]
    brake_n: float
    wheel: tuple[float, float]
    axles: Axles


@kernel
def planar(
    p: SingleTrack, push: Push, grip: float, steer: tuple[float, float, float], speed: float, side: float, yaw: float
) -> tuple[float, float, float]:
    """Rates of forward speed, side speed and yaw rate; steer is road-wheel angle with its cosine and sine."""
    base_mps = max(speed, LOW_MPS)
    front_n = axle_n(
        steer[0] - math.atan((side + p.front_axle_m * yaw) / base_mps), p.front_stiffness, grip * p.front_load_n
    )
    rear_n = axle_n(-math.atan((side - p.rear_axle_m * yaw) / base_mps), p.rear_stiffness, grip * p.rear_load_n)
    across_n = front_n * steer[1]
    return (
        (forward_n(p, push, speed) - front_n * steer[2]) * p.inverse_mass + side * yaw,
        (across_n + rear_n + push.side_n) * p.inverse_mass - speed * yaw,
        (p.front_axle_m * across_n - p.rear_axle_m * rear_n) * p.inverse_inertia,
    )


@kernel
def dynamic_step(
    p: SingleTrack, push: Push, grip: float, steer: tuple[float, float, float], velocity: Velocity, dt_s: float
) -> tuple[float, float, float]:
    """ROS2 over one step: new forward speed (not below 0), side speed and yaw rate."""
    speed, side, yaw = velocity.speed_mps, velocity.side_speed_mps, velocity.yaw_rate_radps
    front, rear, a, b = p.front_stiffness, p.rear_stiffness, p.front_axle_m, p.rear_axle_m
    scale = GAMMA * dt_s / max(speed, LOW_MPS)
    turn = a * front - b * rear
    m11 = 1.0 + scale * (front + rear) * p.inverse_mass
    m12 = scale * turn * p.inverse_mass + GAMMA * dt_s * speed
    m21 = scale * turn * p.inverse_inertia
    m22 = 1.0 + scale * (a * a * front + b * b * rear) * p.inverse_inertia
    inverse = 1.0 / (m11 * m22 - m12 * m21)  # not 0: m11 m22 exceeds it, the stiffness matrix being positive definite
    first, side_rate, yaw_rate = planar(p, push, grip, steer, speed, side, yaw)
    side_1 = inverse * (m22 * side_rate - m12 * yaw_rate)
    yaw_1 = inverse * (m11 * yaw_rate - m21 * side_rate)
    reached = speed + dt_s * first
    if reached < 0.0:
        reached = 0.0
    second, side_rate, yaw_rate = planar(p, push, grip, steer, reached, side + dt_s * side_1, yaw + dt_s * yaw_1)
    side_rate, yaw_rate = side_rate - 2.0 * side_1, yaw_rate - 2.0 * yaw_1
    side_2 = inverse * (m22 * side_rate - m12 * yaw_rate)
    yaw_2 = inverse * (m11 * yaw_rate - m21 * side_rate)
    speed = speed + 0.5 * dt_s * (first + second)
    return (
        speed if speed > 0.0 else 0.0,
        side + dt_s * (1.5 * side_1 + 0.5 * side_2),
        yaw + dt_s * (1.5 * yaw_1 + 0.5 * yaw_2),
    )


@kernel
def slow_speed(p: SingleTrack, push: Push, speed: float, dt_s: float) -> float:
    """Forward speed without tyre forces, by Heun's method; it stops where the passive forces are larger."""
    first = forward_n(p, push, speed) * p.inverse_mass
    reached = speed + dt_s * first
    if reached < 0.0:
        reached = 0.0
    speed = speed + 0.5 * dt_s * (first + forward_n(p, push, reached) * p.inverse_mass)
    return speed if speed > 0.0 else 0.0


@kernel
def pushed(
    p: SingleTrack, was: Velocity, braked_j: float, x: ChassisInput, dt_s: float, axles: Axles = AT_EASE
) -> Advance:
    """The velocities after the forces of one tick; axles: side forces of relaxing tyres."""
    push = push_of(p, x, braked_j)
    after = AT_EASE
    angle = x.actuation.steer_rad * p.inverse_ratio
    angle *= 1.0 - p.linkage_bend * angle * angle
    cosine, sine = math.cos(angle), math.sin(angle)
    if was.speed_mps > LOW_MPS:
        grip = p.friction * x.road.friction_frac
        if p.relaxation_m > 0.0:
            velocity, after = relaxed_step(p, push, grip, (angle, cosine, sine), was, axles, dt_s)
            speed, side, yaw = velocity.speed_mps, velocity.side_speed_mps, velocity.yaw_rate_radps
        else:
            speed, side, yaw = dynamic_step(p, push, grip, (angle, cosine, sine), was, dt_s)
    else:
        speed, side, yaw = slow_speed(p, push, was.speed_mps, dt_s), 0.0, 0.0
    if speed < FULL_MPS:
        share = (speed - LOW_MPS) / BLEND_MPS if speed > LOW_MPS and was.speed_mps > LOW_MPS else 0.0
        rolled = speed * sine / max(cosine, 0.1) * p.inverse_wheelbase
        yaw = share * yaw + (1.0 - share) * rolled
        side = share * side + (1.0 - share) * rolled * p.rear_axle_m
    gravity_mps2 = (push.slope_n * p.inverse_mass, push.bank_mps2)
    return Advance(Velocity(speed, side, yaw), gravity_mps2, push.brake_n, (cosine, sine), after)


@kernel
def step_single_track(
    params: ChassisParams, memory: SingleTrackState, x: ChassisInput, dt_s: float
) -> tuple[SingleTrackState, Motion]:
    """One tick."""
    p, motion = params.constants, memory.motion
    before = Velocity(motion.speed_mps, motion.side_speed_mps, motion.yaw_rate_radps)
    after = pushed(p, before, memory.braked_j, x, dt_s, memory.axles)
    new = moved(p, motion, after.velocity, after.gravity_mps2, after.wheel, dt_s)
    mean_speed = 0.5 * (motion.speed_mps + new.speed_mps)
    return SingleTrackState(new, memory.braked_j + dt_s * mean_speed * after.brake_n, after.axles), new


def init_single_track(params: ChassisParams, dt_s: float) -> SingleTrackState:
    """Rolling straight at the start, brakes cold."""
    return SingleTrackState(rolling_motion(params.start, params.constants.wheel_radius_m), 0.0, AT_EASE)


@kernel
def observe_single_track(state: SingleTrackState, measured: Motion) -> SingleTrackState:
    """The state with the measured pose and speed in it; side speed and yaw rate are kept."""
    velocity = Velocity(measured.speed_mps, state.motion.side_speed_mps, state.motion.yaw_rate_radps)
    return SingleTrackState(with_velocity(measured, velocity), state.braked_j, state.axles)


def make(params: Mapping[str, float], change: BodyChange) -> Block:
    """The chassis Block ChassisInput -> Motion; InputError for a key that is not in DEFAULTS."""
    return Block(init_single_track, step_single_track, ChassisParams(constants_of(params, change)))


PLANT = Plant(make, DEFAULTS, observe=observe_single_track)
