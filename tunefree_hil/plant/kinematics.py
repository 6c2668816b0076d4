"""Kinematics of a rigid car: pose, wheel speeds and specific forces from new velocities, for all plants."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.records import Motion


class Velocity(NamedTuple):
    """Forward, to the left at the centre of mass, and turning to the left."""

    speed_mps: float
    side_speed_mps: float
    yaw_rate_radps: float


@kernel
def moved(
    p: Any,
    motion: Motion,
    velocity: Velocity,
    gravity_mps2: tuple[float, float],
    wheel: tuple[float, float],
    dt_s: float,
) -> Motion:
    """The motion after a tick that ends with the new velocities; the pose by mean velocities.

    p: any constants with rear_axle_m, front_axle_m, half_track_m and inverse_radius. gravity_mps2: gravity as
    an accelerometer measures it, forward and to the left. wheel: cosine and sine of the front wheels' angle.
    """
    speed, side, yaw = velocity.speed_mps, velocity.side_speed_mps, velocity.yaw_rate_radps
    speed_was, side_was, yaw_was = motion.speed_mps, motion.side_speed_mps, motion.yaw_rate_radps
    mean_speed, mean_yaw = 0.5 * (speed_was + speed), 0.5 * (yaw_was + yaw)
    turned = dt_s * mean_yaw
    middle = motion.heading_rad + 0.5 * turned
    along = dt_s * mean_speed
    across = dt_s * (0.5 * (side_was + side) - p.rear_axle_m * mean_yaw)
    middle_cos, middle_sin = math.cos(middle), math.sin(middle)
    speed_rate = (speed - speed_was) / dt_s
    own_accel = speed_rate - 0.5 * (side_was + side) * mean_yaw
    left, right = speed - p.half_track_m * yaw, speed + p.half_track_m * yaw
    swing = (side + p.front_axle_m * yaw) * wheel[1]
    return Motion(
        motion.x_m + along * middle_cos - across * middle_sin,
        motion.y_m + along * middle_sin + across * middle_cos,
        motion.heading_rad + turned,
        speed,
        side,
        yaw,
        own_accel + gravity_mps2[0],
        (side - side_was) / dt_s + mean_speed * mean_yaw + gravity_mps2[1],
        speed_rate,
        (left * wheel[0] + swing) * p.inverse_radius,
        (right * wheel[0] + swing) * p.inverse_radius,
        left * p.inverse_radius,
        right * p.inverse_radius,
    )


@kernel
def with_velocity(motion: Motion, velocity: Velocity) -> Motion:
    """The same motion with other velocities."""
    return Motion(
        motion.x_m,
        motion.y_m,
        motion.heading_rad,
        velocity.speed_mps,
        velocity.side_speed_mps,
        velocity.yaw_rate_radps,
        motion.accel_mps2,
        motion.lateral_accel_mps2,
        motion.speed_rate_mps2,
        motion.wheel_fl_radps,
        motion.wheel_fr_radps,
        motion.wheel_rl_radps,
        motion.wheel_rr_radps,
    )
