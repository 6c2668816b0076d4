"""The single-track step of plant/single_track.py over many windows at once, with derivatives for training.

Only gear 'drive', without brake fade and power limit: a model before its effects. The state is forward speed, side
speed at the centre of mass, and yaw rate. Agrees with the kernel within 1e-9 a tick
(tests/learn/training/test_physics.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.learn.drives.drive import Array
from tunefree_hil.plant.data_sheet import constants_of
from tunefree_hil.plant.single_track import BLEND_MPS, FULL_MPS, GAMMA, LOW_MPS

STATE_STEP = 1e-6  # for differences of the state: far above rounding, far below any curvature


class StateRates(NamedTuple):
    """Three numbers of a state or its rates, each of shape (n_states, n_windows)."""

    speed: Array
    side: Array
    yaw: Array


class BatchedSingleTrack:
    """The vehicle of [plant.params], which is not trained. Numpy is twice as fast as torch on such small arrays."""

    def __init__(self, params: Mapping[str, float], dt_s: float, change: BodyChange | None = None) -> None:
        p = constants_of(params, change or BodyChange())
        self.p, self.dt_s = p, dt_s
        shape = (2, 1, 1)  # front and rear axle, states, windows
        self.arm = np.array([p.front_axle_m, -p.rear_axle_m]).reshape(shape)
        self.stiffness = np.array([p.front_stiffness, p.rear_stiffness]).reshape(shape)
        grip = np.array([p.front_load_n, p.rear_load_n]).reshape(shape) * p.friction
        self.grip_per_slip = self.stiffness / np.maximum(grip, 1.0)  # share of the grip per rad of slip

    def compute_inputs(self, outputs: Array, grade_rad: Array) -> Array:
        """Forces and steering in a tick.

        Args:
            outputs: Of the actuators (duty, duty, wheel rad), shape (n_rows, 3).
            grade_rad: Shape (n_rows,).

        Returns:
            Shape (n_rows, 9): resistance and slope (N), drive force at standstill (N), its inverse power (s/m), creep
            (N), road wheel angle, its cosine and sine, curvature of rolling wheels (1/m), overrun (N).
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

    def step(self, state: Array, inputs: Array) -> Array:
        """The state, shape (3, n_windows), after one tick. inputs: as from `compute_inputs`, shape (9, n_windows)."""
        return self.step_states(state[:, None], inputs)[:, 0]

    def step_states(self, state: Array, inputs: Array) -> Array:
        """The same for several states at once, shape (3, n_states, n_windows)."""
        p, dt = self.p, self.dt_s
        speed, side, yaw = state
        force = self._longitudinal_force(speed, inputs)
        moving = speed > LOW_MPS
        after = np.empty_like(state)
        after[0], after[1], after[2] = self._dynamic_step(StateRates(speed, side, yaw), force, inputs)
        if not moving.all():
            first = force * p.inverse_mass
            second = self._longitudinal_force(np.maximum(speed + dt * first, 0.0), inputs) * p.inverse_mass
            slow = np.maximum(speed + 0.5 * dt * (first + second), 0.0)
            after[0] = np.where(moving, after[0], slow)
            after[1:] = np.where(moving, after[1:], 0.0)
        if (after[0] < FULL_MPS).any():
            rolled = after[0] * inputs[7]
            share = np.clip((after[0] - LOW_MPS) / BLEND_MPS, 0.0, 1.0) * moving
            after[1] = share * after[1] + (1.0 - share) * rolled * p.rear_axle_m
            after[2] = share * after[2] + (1.0 - share) * rolled
        return after

    def _longitudinal_force(self, speed: Array, inputs: Array) -> Array:
        """Force along the vehicle without cornering, N."""
        p = self.p
        share = speed * inputs[2]
        drive_n = inputs[1] / _saturated(share, p.drive_corner)
        fade = 1.0 - speed * p.inverse_creep_speed
        idle_n = inputs[3] * np.maximum(fade, 0.0) + inputs[8] * np.clip(fade, -1.0, 0.0)
        return drive_n + idle_n - inputs[0] - p.drag_kgpm * speed * speed

    def _planar_rates(self, state: StateRates, force: Array, inputs: Array) -> StateRates:
        p = self.p
        speed, side, yaw = state
        slip = -np.arctan((side + self.arm * yaw) / np.maximum(speed, LOW_MPS))
        slip[0] += inputs[4]
        share = self.grip_per_slip * slip
        front, rear = self.stiffness * slip / np.sqrt(1.0 + share * share)
        across = front * inputs[5]
        return StateRates(
            (force - front * inputs[6]) * p.inverse_mass + side * yaw,
            (across + rear) * p.inverse_mass - speed * yaw,
            (p.front_axle_m * across - p.rear_axle_m * rear) * p.inverse_inertia,
        )

    def _dynamic_step(self, state: StateRates, force: Array, inputs: Array) -> StateRates:
        """The Rosenbrock method ROS2 over one tick, as dynamic_step of plant/single_track.py."""
        p, dt = self.p, self.dt_s
        speed, side, yaw = state
        front, rear, a, b = p.front_stiffness, p.rear_stiffness, p.front_axle_m, p.rear_axle_m
        turn = a * front - b * rear
        scale = (GAMMA * dt) / np.maximum(speed, LOW_MPS)
        m11 = 1.0 + scale * ((front + rear) * p.inverse_mass)
        m12 = scale * (turn * p.inverse_mass) + (GAMMA * dt) * speed
        m21 = scale * (turn * p.inverse_inertia)
        m22 = 1.0 + scale * ((a * a * front + b * b * rear) * p.inverse_inertia)
        inverse = 1.0 / (m11 * m22 - m12 * m21)
        first, side_rate, yaw_rate = self._planar_rates(state, force, inputs)
        side_1 = inverse * (m22 * side_rate - m12 * yaw_rate)
        yaw_1 = inverse * (m11 * yaw_rate - m21 * side_rate)
        reached = StateRates(np.maximum(speed + dt * first, 0.0), side + dt * side_1, yaw + dt * yaw_1)
        force = self._longitudinal_force(reached.speed, inputs)
        second, side_rate, yaw_rate = self._planar_rates(reached, force, inputs)
        side_rate, yaw_rate = side_rate - 2.0 * side_1, yaw_rate - 2.0 * yaw_1
        side_2 = inverse * (m22 * side_rate - m12 * yaw_rate)
        yaw_2 = inverse * (m11 * yaw_rate - m21 * side_rate)
        return StateRates(
            np.maximum(speed + 0.5 * dt * (first + second), 0.0),
            side + dt * (1.5 * side_1 + 0.5 * side_2),
            yaw + dt * (1.5 * yaw_1 + 0.5 * yaw_2),
        )


def _saturated(share: Array, corner: float) -> Array:
    """(1 + share ** corner) ** (1 / corner), without overflow."""
    if corner == 2.0:
        return np.sqrt(1.0 + share * share)  # type: ignore[no-any-return]
    near, far = np.minimum(share, 1.0), np.maximum(share, 1.0)
    return far * (1.0 + np.minimum(near, 1.0 / far) ** corner) ** (1.0 / corner)


STATE_STEPS = np.zeros((3, 4, 1))
STATE_STEPS[[0, 1, 2], [1, 2, 3]] = STATE_STEP


class DifferentiableTick(torch.autograd.Function):
    """BatchedSingleTrack.step with derivatives by finite differences: one call, far faster than autograd."""

    @staticmethod
    def forward(ctx: Any, state: Tensor, inputs: Array, physics: BatchedSingleTrack) -> Tensor:
        """The step at the state, and at the state changed in each of its three numbers."""
        after = physics.step_states(state.detach().numpy()[:, None] + STATE_STEPS, inputs)
        ctx.jacobian = torch.from_numpy((after[:, 1:] - after[:, :1]) / STATE_STEP)  # shape (3 out, 3 in, n_windows)
        return torch.from_numpy(after[:, 0].copy())

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[Tensor | None, ...]:
        """Chain rule to the state alone."""
        return (ctx.jacobian * grads[0].unsqueeze(1)).sum(0), None, None


def step_physics(physics: BatchedSingleTrack, state: Tensor, inputs: Array) -> Tensor:
    """One step of a state, shape (3, n_windows); differentiable where gradients are enabled."""
    if not torch.is_grad_enabled():
        return torch.from_numpy(physics.step(state.numpy(), inputs))
    return DifferentiableTick.apply(state, inputs, physics)  # type: ignore[no-any-return]
