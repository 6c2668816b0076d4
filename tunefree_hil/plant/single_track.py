"""Plant kind `physics`: a single-track car on data-sheet constants (the nominal model, design D5).

Tyres that saturate, kinematic below walking pace, force balance along the car with a smooth power-limited drive map
and a linear brake. One step a tick: an L-stable Rosenbrock method of order 2 (Verwer et al. 1999, ROS2) for side speed
and yaw rate, whose time constants fall below the tick at low speed, which is Heun's method for the slow forward speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from tunefree_hil.base.contracts import LEAST_BRAKE_GAIN, BodyChange
from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import GEAR_DRIVE, GEAR_PARK, Motion
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.plant.body import ChassisInput, ChassisParams, Plant, rolling_motion
from tunefree_hil.plant.data_sheet import DEFAULTS, SingleTrack, constants_of
from tunefree_hil.plant.kinematics import Velocity, moved, with_velocity

GAMMA = 1.0 - math.sqrt(0.5)  # makes ROS2 L-stable
LOW_MPS, FULL_MPS = 0.5, 1.5  # kinematic below, dynamic above, blended between
BLEND_MPS = FULL_MPS - LOW_MPS
PARKED_N = 1.0e6  # what a locked gearbox holds


class Push(NamedTuple):
    """Forces along the car that hold for one tick, drive in terms of speed."""

    drive_n: float  # at standstill
    drive_power_w: float
    creep_n: float
    passive_n: float  # brake and rolling: never push, only oppose
    slope_n: float
    brake_n: float  # the brakes' part of passive_n


class SingleTrackState(NamedTuple):
    """The motion, and what the brakes have dissipated."""

    motion: Motion
    braked_j: float


class Advance(NamedTuple):
    """A tick's work: velocities at its end, gravity along the car, brake force, cosine and sine of the front wheels."""

    velocity: Velocity
    slope_mps2: float
    brake_n: float
    wheel: tuple[float, float]


@kernel
def push_of(p: SingleTrack, x: ChassisInput, braked_j: float) -> Push:
    """Drive, creep, brake and slope from pedals, gear and road; braked_j: what the brakes have dissipated."""
    act, road = x.actuation, x.road
    throttle = clamp((act.throttle_frac - p.throttle_zero_frac) * p.inverse_throttle_span, 0.0, 1.0)
    braked = act.brake_frac - p.rest_frac
    left = 1.0 - p.brake_loss_per_j * braked_j
    gain_n = p.brake_gain_n * (left if left > LEAST_BRAKE_GAIN else LEAST_BRAKE_GAIN)
    brake_n = gain_n * braked if braked > 0.0 else 0.0
    grip_n = p.friction * road.friction_frac * p.mass_kg * G_MPS2
    if brake_n > grip_n:
        brake_n = grip_n
    slope_n = p.mass_kg * G_MPS2 * math.sin(road.grade_rad + p.grade_rad)
    if act.gear < GEAR_DRIVE:
        held_n = PARKED_N if act.gear == GEAR_PARK else 0.0
        return Push(0.0, 0.0, 0.0, brake_n + p.rolling_n + p.brake_drag_n + held_n, slope_n, brake_n)
    drive_n = p.drive_force_n * (1.0 - math.exp(-throttle * p.inverse_knee))
    if drive_n > 0.5 * grip_n:
        drive_n = 0.5 * grip_n
    passive_n = brake_n + p.rolling_n + p.brake_drag_n
    return Push(drive_n, p.drive_power_w * throttle, p.creep_force_n, passive_n, slope_n, brake_n)


@kernel
def forward_n(p: SingleTrack, push: Push, speed_mps: float) -> float:
    """Force along the car at a speed, tyre forces of cornering aside. Drive: P F / sqrt(P^2 + (F v)^2)."""
    force_n = -push.passive_n - push.slope_n - p.drag_kgpm * speed_mps * speed_mps
    if push.drive_n > 0.0:
        asked_w = push.drive_n * speed_mps
        share = asked_w / max(push.drive_power_w, 1.0)
        drive_n = push.drive_n / math.sqrt(1.0 + share * share)
        if drive_n * speed_mps > p.power_w:
            drive_n = p.power_w / speed_mps  # not 0: the power above is not 0
        force_n = force_n + drive_n
    fade = 1.0 - speed_mps * p.inverse_creep_speed
    if fade > 0.0:
        force_n = force_n + push.creep_n * fade
    return force_n


@kernel
def axle_n(slip_rad: float, stiffness: float, grip_n: float) -> float:
    """Side force of an axle: linear for small slip, grip_n for large."""
    linear_n = stiffness * slip_rad
    share = linear_n / max(grip_n, 1.0)
    return linear_n / math.sqrt(1.0 + share * share)


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
        (across_n + rear_n) * p.inverse_mass - speed * yaw,
        (p.front_axle_m * across_n - p.rear_axle_m * rear_n) * p.inverse_inertia,
    )


@kernel
def dynamic_step(
    p: SingleTrack, push: Push, grip: float, steer: tuple[float, float, float], was: Velocity, dt_s: float
) -> tuple[float, float, float]:
    """ROS2 over one step: new forward speed (not below 0), side speed and yaw rate."""
    speed, side, yaw = was.speed_mps, was.side_speed_mps, was.yaw_rate_radps
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
    """Forward speed without tyre forces, by Heun's method; it stops where the passive forces are the stronger."""
    first = forward_n(p, push, speed) * p.inverse_mass
    reached = speed + dt_s * first
    if reached < 0.0:
        reached = 0.0
    speed = speed + 0.5 * dt_s * (first + forward_n(p, push, reached) * p.inverse_mass)
    return speed if speed > 0.0 else 0.0


@kernel
def pushed(p: SingleTrack, was: Velocity, braked_j: float, x: ChassisInput, dt_s: float) -> Advance:
    """What the forces of one tick make of the velocities."""
    push = push_of(p, x, braked_j)
    angle = x.actuation.steer_rad * p.inverse_ratio
    cosine, sine = math.cos(angle), math.sin(angle)
    if was.speed_mps > LOW_MPS:
        grip = p.friction * x.road.friction_frac
        speed, side, yaw = dynamic_step(p, push, grip, (angle, cosine, sine), was, dt_s)
    else:
        speed, side, yaw = slow_speed(p, push, was.speed_mps, dt_s), 0.0, 0.0
    if speed < FULL_MPS:
        share = (speed - LOW_MPS) / BLEND_MPS if speed > LOW_MPS and was.speed_mps > LOW_MPS else 0.0
        rolled = speed * sine / max(cosine, 0.1) * p.inverse_wheelbase
        yaw = share * yaw + (1.0 - share) * rolled
        side = share * side + (1.0 - share) * rolled * p.rear_axle_m
    return Advance(Velocity(speed, side, yaw), push.slope_n * p.inverse_mass, push.brake_n, (cosine, sine))


@kernel
def step_single_track(
    params: ChassisParams, memory: SingleTrackState, x: ChassisInput, dt_s: float
) -> tuple[SingleTrackState, Motion]:
    """One tick."""
    p, was = params.constants, memory.motion
    before = Velocity(was.speed_mps, was.side_speed_mps, was.yaw_rate_radps)
    after = pushed(p, before, memory.braked_j, x, dt_s)
    new = moved(p, was, after.velocity, after.slope_mps2, after.wheel, dt_s)
    mean_speed = 0.5 * (was.speed_mps + new.speed_mps)
    return SingleTrackState(new, memory.braked_j + dt_s * mean_speed * after.brake_n), new


def init_single_track(params: ChassisParams, dt_s: float) -> SingleTrackState:
    """Rolling straight at the start, brakes cold."""
    return SingleTrackState(rolling_motion(params.start, params.constants.wheel_radius_m), 0.0)


@kernel
def observe_single_track(state: SingleTrackState, seen: Motion) -> SingleTrackState:
    """The state with the measured pose and speed in it; side speed and yaw rate go on as the tyres have made them."""
    own = Velocity(seen.speed_mps, state.motion.side_speed_mps, state.motion.yaw_rate_radps)
    return SingleTrackState(with_velocity(seen, own), state.braked_j)


def make(params: Mapping[str, float], change: BodyChange) -> Block:
    """The chassis Block ChassisInput -> Motion; InputError for a key that is not in DEFAULTS."""
    return Block(init_single_track, step_single_track, ChassisParams(constants_of(params, change)))


PLANT = Plant(make, DEFAULTS, observe=observe_single_track)
