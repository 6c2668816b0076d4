"""The single-track tick of plant/single_track.py over many windows at once, and its slopes for training.

Only the gear 'drive', brakes that do not fade and no power limit: what a model has before effects are put on it.
State is forward speed, side speed at the centre of mass, yaw rate. Equal to the kernel within 1e-9 a tick
(tests/learn/training/test_physics.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.learn.drives.drive import Array
from tunefree_hil.plant.data_sheet import constants_of
from tunefree_hil.plant.single_track import BLEND_MPS, FULL_MPS, GAMMA, LOW_MPS

NUDGE = 1e-6  # of a state, for its slopes: far above rounding, far below any curvature


class Physics:
    """The car of [plant.params]; nothing in it is trained. Arrays are numpy's: so small, they are twice as fast."""

    def __init__(self, params: Mapping[str, float], dt_s: float, change: BodyChange | None = None) -> None:
        p = constants_of(params, change or BodyChange())
        self.p, self.dt_s = p, dt_s
        shape = (2, 1, 1)  # front and rear axle, beside nudges and windows
        self.arm = np.array([p.front_axle_m, -p.rear_axle_m]).reshape(shape)
        self.stiffness = np.array([p.front_stiffness, p.rear_stiffness]).reshape(shape)
        grip = np.array([p.front_load_n, p.rear_load_n]).reshape(shape) * p.friction
        self.yielding = self.stiffness / np.maximum(grip, 1.0)  # share of the grip per rad of slip

    def push(self, outputs: Array, grade_rad: Array) -> Array:
        """[n, 9] of what acts in a tick, from actuator outputs [n, 3] (duty, duty, wheel rad) and grade [n].

        Resistance and slope in N, drive force at standstill in N, its inverse power in s/m, creep in N, and of the road
        wheel angle, cosine, sine and the curvature (1/m) that rolling wheels give; last, overrun in N.
        """
        p = self.p
        throttle = np.clip((outputs[:, 0] - p.throttle_zero_frac) * p.inverse_throttle_span, 0.0, 1.0)
        grip_n = p.friction * p.mass_kg * G_MPS2
        braked = np.maximum(outputs[:, 1] - p.rest_frac, 0.0)
        brake_n = np.minimum(p.brake_gain_n * braked * (1.0 + p.brake_rise_per_frac * braked), grip_n)
        slope_n = p.mass_kg * G_MPS2 * np.sin(grade_rad + p.grade_rad)
        released = np.exp(-throttle * p.inverse_knee)
        drive_n = np.minimum(p.drive_force_n * (1.0 - released), 0.5 * grip_n)
        ratio = drive_n / np.maximum(p.drive_power_w * throttle, 1.0)
        angle = outputs[:, 2] * p.inverse_ratio
        angle *= 1.0 - p.linkage_bend * angle * angle
        cosine, sine = np.cos(angle), np.sin(angle)
        curvature = sine / np.maximum(cosine, 0.1) * p.inverse_wheelbase
        creep_n = np.full_like(angle, p.creep_force_n)
        resist_n = brake_n + p.rolling_n + p.brake_drag_n + slope_n
        overrun_n = p.overrun_force_n * released
        return np.stack([resist_n, drive_n, ratio, creep_n, angle, cosine, sine, curvature, overrun_n], axis=1)

    def after(self, state: Array, push: Array) -> Array:
        """The state [3, B] after one tick; push: the nine of `push`, [9, B]."""
        return self.tick(state[:, None], push)[:, 0]

    def tick(self, state: Array, push: Array) -> Array:
        """The same for several states at once, [3, K, B]."""
        p, dt = self.p, self.dt_s
        speed, side, yaw = state
        force = self._forward(speed, push)
        moving = speed > LOW_MPS
        after = np.empty_like(state)
        after[0], after[1], after[2] = self._dynamic(speed, side, yaw, force, push)
        if not moving.all():
            first = force * p.inverse_mass
            second = self._forward(np.maximum(speed + dt * first, 0.0), push) * p.inverse_mass
            slow = np.maximum(speed + 0.5 * dt * (first + second), 0.0)
            after[0] = np.where(moving, after[0], slow)
            after[1:] = np.where(moving, after[1:], 0.0)
        if (after[0] < FULL_MPS).any():
            rolled = after[0] * push[7]
            share = np.clip((after[0] - LOW_MPS) / BLEND_MPS, 0.0, 1.0) * moving
            after[1] = share * after[1] + (1.0 - share) * rolled * p.rear_axle_m
            after[2] = share * after[2] + (1.0 - share) * rolled
        return after

    def _forward(self, speed: Array, push: Array) -> Array:
        """Force along the car, cornering aside."""
        p = self.p
        share = speed * push[2]
        drive_n = push[1] / _yielded(share, p.drive_corner)
        fade = 1.0 - speed * p.inverse_creep_speed
        idle_n = push[3] * np.maximum(fade, 0.0) + push[8] * np.clip(fade, -1.0, 0.0)
        return drive_n + idle_n - push[0] - p.drag_kgpm * speed * speed

    def _planar(self, speed: Array, side: Array, yaw: Array, force: Array, push: Array) -> tuple[Array, Array, Array]:
        """Rates of forward speed, side speed, yaw rate."""
        p = self.p
        slip = -np.arctan((side + self.arm * yaw) / np.maximum(speed, LOW_MPS))
        slip[0] += push[4]
        share = self.yielding * slip
        front, rear = self.stiffness * slip / np.sqrt(1.0 + share * share)
        across = front * push[5]
        return (
            (force - front * push[6]) * p.inverse_mass + side * yaw,
            (across + rear) * p.inverse_mass - speed * yaw,
            (p.front_axle_m * across - p.rear_axle_m * rear) * p.inverse_inertia,
        )

    def _dynamic(self, speed: Array, side: Array, yaw: Array, force: Array, push: Array) -> tuple[Array, Array, Array]:
        """ROS2 over one tick, as dynamic_step."""
        p, dt = self.p, self.dt_s
        front, rear, a, b = p.front_stiffness, p.rear_stiffness, p.front_axle_m, p.rear_axle_m
        turn = a * front - b * rear
        scale = (GAMMA * dt) / np.maximum(speed, LOW_MPS)
        m11 = 1.0 + scale * ((front + rear) * p.inverse_mass)
        m12 = scale * (turn * p.inverse_mass) + (GAMMA * dt) * speed
        m21 = scale * (turn * p.inverse_inertia)
        m22 = 1.0 + scale * ((a * a * front + b * b * rear) * p.inverse_inertia)
        inverse = 1.0 / (m11 * m22 - m12 * m21)
        first, side_rate, yaw_rate = self._planar(speed, side, yaw, force, push)
        side_1 = inverse * (m22 * side_rate - m12 * yaw_rate)
        yaw_1 = inverse * (m11 * yaw_rate - m21 * side_rate)
        reached = np.maximum(speed + dt * first, 0.0)
        force = self._forward(reached, push)
        second, side_rate, yaw_rate = self._planar(reached, side + dt * side_1, yaw + dt * yaw_1, force, push)
        side_rate, yaw_rate = side_rate - 2.0 * side_1, yaw_rate - 2.0 * yaw_1
        side_2 = inverse * (m22 * side_rate - m12 * yaw_rate)
        yaw_2 = inverse * (m11 * yaw_rate - m21 * side_rate)
        return (
            np.maximum(speed + 0.5 * dt * (first + second), 0.0),
            side + dt * (1.5 * side_1 + 0.5 * side_2),
            yaw + dt * (1.5 * yaw_1 + 0.5 * yaw_2),
        )


def _yielded(share: Array, corner: float) -> Array:
    if corner == 2.0:
        return np.sqrt(1.0 + share * share)  # type: ignore[no-any-return]
    near, far = np.minimum(share, 1.0), np.maximum(share, 1.0)
    return far * (1.0 + np.minimum(near, 1.0 / far) ** corner) ** (1.0 / corner)


NUDGES = np.zeros((3, 4, 1))
NUDGES[[0, 1, 2], [1, 2, 3]] = NUDGE


class Tick(torch.autograd.Function):
    """Physics.tick of state [3, B] with slopes by small differences: in one call, far faster than autograd."""

    @staticmethod
    def forward(ctx: Any, state: Tensor, push: Array, physics: Physics) -> Tensor:
        """The tick at the state and at it nudged in each of its three parts."""
        found = physics.tick(state.detach().numpy()[:, None] + NUDGES, push)
        ctx.slopes = torch.from_numpy((found[:, 1:] - found[:, :1]) / NUDGE)  # [out, in, B]
        return torch.from_numpy(found[:, 0].copy())

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor, None, None]:
        """Chain rule to the state; nothing else is trained."""
        return (ctx.slopes * grads[0].unsqueeze(1)).sum(0), None, None


def tick(physics: Physics, state: Tensor, push: Array) -> Tensor:
    """One tick of state [3, B] that gradients can pass; without the slopes where nobody asks for them."""
    if not torch.is_grad_enabled():
        return torch.from_numpy(physics.after(state.numpy(), push))
    return Tick.apply(state, push, physics)  # type: ignore[no-any-return]
