"""Free run in torch: the kernels of plant/hybrid.py and lstm.py over many windows at once, with gradients.

Each agrees with its kernel within 1e-5 a tick and 1 mm over 10 s (tests/learn/training/test_rollout.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.learn.training.nets import CellNet, cell_outputs
from tunefree_hil.learn.training.physics import BatchedSingleTrack, step_physics
from tunefree_hil.learn.training.windows import ACCEL, HEADING, SPEED, YAW, TrackPool, WindowBatch, X, Y
from tunefree_hil.plant.hybrid import FADE_MPS
from tunefree_hil.plant.learned.kinematics import DEFAULTS, LEAST_MPS, PULL_AWAY_MPS2, carriage_of

LEAD_IN_S, SEGMENT_S = 1.5, 4.0  # the memory of the tyres is far shorter than the lead-in


class FreeRun(NamedTuple):
    """Motion from the start of free run on, shape (ahead + 1, n_windows). slip: side speed of the rear axle."""

    speed: Tensor
    yaw_rate: Tensor
    slip: Tensor


class FreeRunner(Protocol):
    """A model that runs freely from the end of a window's warm-up."""

    def run(self, pool: TrackPool, window: WindowBatch) -> FreeRun: ...


class PhysicsRunner:
    """The single track alone.

    Its response to the measured motion does not depend on a net, so it is computed once along the whole pool, for the
    tick that ends in each row.

    Attributes:
        inputs: As from `BatchedSingleTrack.compute_inputs`.
        features: Inputs of kind hybrid, shape (n_rows, 7).
        lateral: Side speed and yaw rate, shape (n_rows, 2).
    """

    def __init__(self, physics: BatchedSingleTrack, pool: TrackPool) -> None:
        self.physics = physics
        self.inputs = physics.compute_inputs(pool.inputs.numpy(), pool.grade_rad.numpy())
        self.features, self.lateral = self._run_along(pool)

    def _run_along(self, pool: TrackPool) -> tuple[Tensor, Tensor]:
        """Segments of all spans in parallel, each with a lead-in of LEAD_IN_S."""
        physics, dt = self.physics, pool.dt_s
        lead_in, length = round(LEAD_IN_S / dt), round(SEGMENT_S / dt)
        segments = [
            (max(begin, row - lead_in), row, min(row + length, end - 1))
            for begin, end in pool.spans
            for row in range(begin, end - 1, length)
        ]
        first, begin, end = (np.array([segment[i] for segment in segments]) for i in range(3))
        motion, inputs = pool.motion.numpy(), pool.inputs.numpy() - np.array([pool.rest, pool.rest, 0.0])
        features, lateral = np.zeros((len(motion), 7)), np.zeros((len(motion), 2))
        state = np.zeros((3, len(first)))
        for k in range(1, int((end - first).max(initial=0)) + 1):
            row = np.minimum(first + k, end)
            speed = motion[row - 1, SPEED]
            state[0] = speed
            state = physics.step(state, self.inputs[row].T)
            inside = (first + k > begin) & (first + k <= end)
            columns = [speed, motion[row - 1, YAW], *inputs[row].T, (state[0] - speed) / dt, state[2]]
            features[row[inside]] = np.stack(columns, axis=1)[inside]
            lateral[row[inside]] = state[1:].T[inside]
        return torch.from_numpy(features), torch.from_numpy(lateral)

    def run(self, pool: TrackPool, window: WindowBatch) -> FreeRun:
        """Free run without a residual; no gradients."""
        com_to_rear_m = self.physics.p.rear_axle_m
        start = window.rows[window.warm_up]
        state = np.concatenate([pool.motion[start][:, :1], self.lateral[start]], axis=1).T
        inputs = self.inputs[window.rows.numpy()].transpose(0, 2, 1)
        states = [state]
        for t in range(window.warm_up + 1, len(window.rows)):
            state = self.physics.step(state, inputs[t])
            states.append(state)
        speed, side, yaw = torch.from_numpy(np.stack(states, axis=1)).unbind(0)
        return FreeRun(speed, yaw, side - com_to_rear_m * yaw)


class HybridRunner(PhysicsRunner):
    """The single track with the residual of a cell."""

    def __init__(self, base: PhysicsRunner, net: CellNet) -> None:
        self.physics, self.inputs, self.features, self.lateral = base.physics, base.inputs, base.features, base.lateral
        self.net = net

    def run(self, pool: TrackPool, window: WindowBatch) -> FreeRun:
        """Free run, with gradients to the net."""
        physics, net, dt, com_to_rear_m = self.physics, self.net, pool.dt_s, self.physics.p.rear_axle_m
        motion, inputs = _select_windows(pool, window)
        physics_inputs = np.ascontiguousarray(self.inputs[window.rows.numpy()].transpose(0, 2, 1))
        features = self.features[window.rows[1 : window.warm_up + 1]].transpose(1, 2)
        side, physics_yaw = self.lateral[window.rows[window.warm_up]].unbind(1)
        weights = net.rollout_weights()
        hidden, memory = net.run(weights, features)
        reached = motion[window.warm_up - 1, SPEED] + dt * features[-1, 5]  # by the physics, in the last measured tick
        last_yaw = cell_outputs(weights, hidden)[1] * (reached / FADE_MPS).clamp(0.0, 1.0)
        speed, yaw = motion[window.warm_up, SPEED], motion[window.warm_up, YAW]
        speeds, yaws, slips = [speed], [yaw], [side + com_to_rear_m * (last_yaw - yaw)]
        for t in range(window.warm_up + 1, len(window.rows)):
            after = step_physics(physics, torch.stack([speed, side, physics_yaw]), physics_inputs[t])
            reached, side, physics_yaw = after.unbind(0)
            physics_features = torch.stack([(reached - speed) / dt, physics_yaw])
            cell_inputs = torch.cat([torch.stack([speed, yaw]), inputs[t], physics_features, hidden])
            hidden, memory = net.step(torch.addmm(weights.bias, weights.both, cell_inputs), memory)
            residual = cell_outputs(weights, hidden)
            is_slow = bool((reached < FADE_MPS).any())
            if is_slow:
                residual = residual * (reached / FADE_MPS).clamp(0.0, 1.0)
            slip = side - com_to_rear_m * physics_yaw
            speed, yaw = reached + dt * residual[0], physics_yaw + residual[1]
            if is_slow:
                is_moving = speed > 0.0
                speed = speed.clamp(min=0.0)
                yaw, slip = yaw * is_moving, slip * is_moving
            speeds.append(speed)
            yaws.append(yaw)
            slips.append(slip)
        return FreeRun(torch.stack(speeds), torch.stack(yaws), torch.stack(slips))


class _KinematicState(NamedTuple):
    """Speed, yaw rate and acceleration on level ground, each of shape (n_windows,)."""

    speed: Tensor
    yaw: Tensor
    level_accel: Tensor


class KinematicRunner:
    """Kind lstm: the net gives acceleration and yaw rate, plant/learned/kinematics.py moves the vehicle."""

    def __init__(self, params: Mapping[str, float], net: CellNet) -> None:
        kinematic = {key: value for key, value in params.items() if key in DEFAULTS}
        self.grip = carriage_of("lstm", DEFAULTS, kinematic, BodyChange()).grip_mps2
        self.net = net

    def run(self, pool: TrackPool, window: WindowBatch) -> FreeRun:
        """Free run, with gradients to the net."""
        net, dt = self.net, pool.dt_s
        motion, inputs = _select_windows(pool, window)
        slope = _slope_accel(pool, window)
        level_accel = motion[window.warm_up, ACCEL] + slope[window.warm_up]
        state = _KinematicState(motion[window.warm_up, SPEED], motion[window.warm_up, YAW], level_accel)
        speeds, yaws = [state.speed], [state.yaw]
        weights = net.rollout_weights()
        hidden, memory = net.run(weights, kinematic_features(pool, window, window.warm_up + 1))
        for t in range(window.warm_up + 1, len(window.rows)):
            features = torch.cat([state.speed.unsqueeze(0), inputs[t], torch.stack([state.level_accel, state.yaw])])
            gates = torch.addmm(weights.bias, weights.both, torch.cat([features, hidden]))
            hidden, memory = net.step(gates, memory)
            state = self._step(state.speed, cell_outputs(weights, hidden), slope[t], dt)
            speeds.append(state.speed)
            yaws.append(state.yaw)
        speed = torch.stack(speeds)
        return FreeRun(speed, torch.stack(yaws), torch.zeros_like(speed))

    def _step(self, before: Tensor, outputs: Tensor, slope: Tensor, dt: float) -> _KinematicState:
        """The state after a tick, as in plant/learned/kinematics.py."""
        accel = outputs[0].clamp(-self.grip, self.grip)
        speed = before + dt * (accel - slope)
        yaw = outputs[1]
        if bool((speed < FADE_MPS).any()):
            stays = (speed < 0.0) | ((before <= 0.0) & (accel < PULL_AWAY_MPS2))
            speed = torch.where(stays, torch.zeros_like(speed), speed)
        max_yaw = self.grip / speed.detach().clamp(min=LEAST_MPS)
        if bool((yaw.detach().abs() > max_yaw).any()):
            yaw = torch.minimum(torch.maximum(yaw, -max_yaw), max_yaw)
        return _KinematicState(speed, yaw * (speed / FADE_MPS).clamp(0.0, 1.0), accel * (speed > 0.0))


def kinematic_features(pool: TrackPool, window: WindowBatch, end: int) -> Tensor:
    """Inputs of kind lstm in ticks 1 to end - 1 along the measured motion, shape (end - 1, 6, n_windows)."""
    motion, inputs = _select_windows(pool, window)
    before, level_accel = motion[: end - 1], (motion[:, ACCEL] + _slope_accel(pool, window))[: end - 1]
    parts = [before[:, SPEED : SPEED + 1], inputs[1:end], level_accel.unsqueeze(1), before[:, YAW : YAW + 1]]
    return torch.cat(parts, dim=1)


def _slope_accel(pool: TrackPool, window: WindowBatch) -> Tensor:
    """Deceleration by the slope, m/s2, shape (n_ticks, n_windows)."""
    return G_MPS2 * torch.sin(pool.grade_rad[window.rows])


def _select_windows(pool: TrackPool, window: WindowBatch) -> tuple[Tensor, Tensor]:
    """Motion and inputs over rest of the windows, shapes (n_ticks, 6, n_windows) and (n_ticks, 3, n_windows)."""
    rest = torch.tensor([pool.rest, pool.rest, 0.0], dtype=torch.float64)
    inputs = (pool.inputs[window.rows] - rest).transpose(1, 2).contiguous()
    return pool.motion[window.rows].transpose(1, 2).contiguous(), inputs


class FreeRunBatchErrors(NamedTuple):
    """Free run minus measured motion, shape (ahead, n_windows).

    Attributes:
        heading_rad: Error of the heading since the start.
        position_m: Distance.
    """

    speed_mps: Tensor
    yaw_rate_radps: Tensor
    heading_rad: Tensor
    position_m: Tensor


class RelativePose(NamedTuple):
    """Pose since the start, shape (ahead, n_windows); x ahead, y to the left."""

    heading_rad: Tensor
    x_m: Tensor
    y_m: Tensor


def integrate_pose(run: FreeRun, dt_s: float) -> RelativePose:
    """The pose since the start, by midpoints as in plant/kinematics.py."""
    mean_yaw = 0.5 * (run.yaw_rate[1:] + run.yaw_rate[:-1])
    heading = torch.cumsum(dt_s * mean_yaw, 0)
    middle = heading - 0.5 * dt_s * mean_yaw
    along, across = 0.5 * dt_s * (run.speed[1:] + run.speed[:-1]), 0.5 * dt_s * (run.slip[1:] + run.slip[:-1])
    cosine, sine = torch.cos(middle), torch.sin(middle)
    x, y = torch.cumsum(along * cosine - across * sine, 0), torch.cumsum(along * sine + across * cosine, 0)
    return RelativePose(heading, x, y)


def compute_errors(run: FreeRun, pool: TrackPool, window: WindowBatch) -> FreeRunBatchErrors:
    """Errors of a free run; the distance stays above 0, where it is not differentiable."""
    truth = pool.motion[window.rows[window.warm_up :]]  # shape (ahead + 1, n_windows, 6)
    heading, x, y = integrate_pose(run, pool.dt_s)
    turned = truth[1:, :, HEADING] - truth[:1, :, HEADING]
    cosine, sine = torch.cos(truth[:1, :, HEADING]), torch.sin(truth[:1, :, HEADING])
    dx, dy = truth[1:, :, X] - truth[:1, :, X], truth[1:, :, Y] - truth[:1, :, Y]
    ahead, left = dx * cosine + dy * sine, dy * cosine - dx * sine
    distance = torch.sqrt((x - ahead) ** 2 + (y - left) ** 2 + 1e-12)
    return FreeRunBatchErrors(
        speed_mps=run.speed[1:] - truth[1:, :, SPEED],
        yaw_rate_radps=run.yaw_rate[1:] - truth[1:, :, YAW],
        heading_rad=heading - turned,
        position_m=distance,
    )
