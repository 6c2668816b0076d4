"""The single-track car on tyres that relax: an axle's side force F follows its steady value F0 by

    dF/dt = (F0 - F) |v| / length

so the force builds up over a rolled distance. The step is the ROS2 of plant/single_track.py with the two forces
as states; in its matrix they are eliminated by hand, which leaves the same two equations with the stiffnesses times
w / (1 + w), w = gamma dt |v| / length. For length -> 0 it is the step without relaxation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from tunefree_hil.base.kernel import kernel
from tunefree_hil.plant.data_sheet import SingleTrack
from tunefree_hil.plant.forces.track_forces import GAMMA, LOW_MPS, Push, axle_n, forward_n
from tunefree_hil.plant.kinematics import Velocity


class Axles(NamedTuple):
    """Side forces of both axles, to the left: the state of relaxing tyres."""

    front_n: float
    rear_n: float


class Rates(NamedTuple):
    """Rates of forward speed, side speed, yaw rate and of the two forces."""

    speed: float
    side: float
    yaw: float
    front: float
    rear: float


AT_EASE = Axles(0.0, 0.0)


@kernel
def relaxed_rates(
    p: SingleTrack, push: Push, grip: float, steer: tuple[float, float, float], velocity: Velocity, axles: Axles
) -> Rates:
    """Newton and Euler with the forces as they are; steer is road-wheel angle with its cosine and sine."""
    speed, side, yaw = velocity.speed_mps, velocity.side_speed_mps, velocity.yaw_rate_radps
    base_mps = max(speed, LOW_MPS)
    front_slip = steer[0] - math.atan((side + p.front_axle_m * yaw) / base_mps)
    rear_slip = -math.atan((side - p.rear_axle_m * yaw) / base_mps)
    follow = base_mps / p.relaxation_m  # not 0: only called where there is a length
    across_n = axles.front_n * steer[1]
    return Rates(
        (forward_n(p, push, speed) - axles.front_n * steer[2]) * p.inverse_mass + side * yaw,
        (across_n + axles.rear_n + push.side_n) * p.inverse_mass - speed * yaw,
        (p.front_axle_m * across_n - p.rear_axle_m * axles.rear_n) * p.inverse_inertia,
        follow * (axle_n(front_slip, p.front_stiffness, grip * p.front_load_n) - axles.front_n),
        follow * (axle_n(rear_slip, p.rear_stiffness, grip * p.rear_load_n) - axles.rear_n),
    )


@kernel
def solved(p: SingleTrack, speed: float, rate: Rates, step_s: float) -> Rates:
    """(1 - step_s * A)^-1 times the rates; A: their linear slopes by side speed, yaw rate and forces at that speed."""
    base_mps = max(speed, LOW_MPS)
    a, b = p.front_axle_m, p.rear_axle_m
    step_lengths = step_s * base_mps / p.relaxation_m  # not 0: only called where there is a length
    left = 1.0 / (1.0 + step_lengths)  # not 0: the distance is not negative
    front, rear = step_lengths * left * p.front_stiffness, step_lengths * left * p.rear_stiffness
    scale = step_s / base_mps
    turn = a * front - b * rear
    m11 = 1.0 + scale * (front + rear) * p.inverse_mass
    m12 = scale * turn * p.inverse_mass + step_s * speed
    m21 = scale * turn * p.inverse_inertia
    m22 = 1.0 + scale * (a * a * front + b * b * rear) * p.inverse_inertia
    inverse = 1.0 / (m11 * m22 - m12 * m21)  # not 0: as in dynamic_step
    front_left, rear_left = left * rate.front, left * rate.rear
    side_rate = rate.side + step_s * (front_left + rear_left) * p.inverse_mass
    yaw_rate = rate.yaw + step_s * (a * front_left - b * rear_left) * p.inverse_inertia
    side = inverse * (m22 * side_rate - m12 * yaw_rate)
    yaw = inverse * (m11 * yaw_rate - m21 * side_rate)
    return Rates(
        rate.speed,
        side,
        yaw,
        front_left - front / base_mps * (side + a * yaw),
        rear_left - rear / base_mps * (side - b * yaw),
    )


@kernel
def relaxed_step(
    p: SingleTrack,
    push: Push,
    grip: float,
    steer: tuple[float, float, float],
    velocity: Velocity,
    axles: Axles,
    dt_s: float,
) -> tuple[Velocity, Axles]:
    """ROS2 over one step: new velocities (forward not below 0) and forces."""
    gamma_s, speed = GAMMA * dt_s, velocity.speed_mps
    start = relaxed_rates(p, push, grip, steer, velocity, axles)
    first = solved(p, speed, start, gamma_s)
    reached = Velocity(
        max(speed + dt_s * start.speed, 0.0),
        velocity.side_speed_mps + dt_s * first.side,
        velocity.yaw_rate_radps + dt_s * first.yaw,
    )
    grown = Axles(axles.front_n + dt_s * first.front, axles.rear_n + dt_s * first.rear)
    end = relaxed_rates(p, push, grip, steer, reached, grown)
    twice = Rates(
        end.speed, end.side - 2.0 * first.side, end.yaw - 2.0 * first.yaw, end.front - 2.0 * first.front,
        end.rear - 2.0 * first.rear,
    )  # fmt: skip
    second = solved(p, speed, twice, gamma_s)
    return Velocity(
        max(speed + 0.5 * dt_s * (start.speed + end.speed), 0.0),
        velocity.side_speed_mps + dt_s * (1.5 * first.side + 0.5 * second.side),
        velocity.yaw_rate_radps + dt_s * (1.5 * first.yaw + 0.5 * second.yaw),
    ), Axles(
        axles.front_n + dt_s * (1.5 * first.front + 0.5 * second.front),
        axles.rear_n + dt_s * (1.5 * first.rear + 0.5 * second.rear),
    )
