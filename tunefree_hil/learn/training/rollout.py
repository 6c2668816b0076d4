"""Free run in torch: the kernels of plant/hybrid.py, lstm.py and mlp.py over many windows at once, with gradients.

Each agrees with its kernel within 1e-5 a tick and 1 mm over 10 s (tests/learn/training/test_kernels.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.learn.training.nets import CellNet, LayerNet, put_out
from tunefree_hil.learn.training.physics import Physics, tick
from tunefree_hil.learn.training.windows import ACCEL, HEADING, SPEED, YAW, Pool, Window, X, Y
from tunefree_hil.plant.hybrid import FADE_MPS
from tunefree_hil.plant.learned.kinematics import DEFAULTS, LEAST_MPS, PULL_AWAY_MPS2, carriage_of

LEAD_S, PIECE_S = 1.5, 4.0  # the tyres' memory is far shorter than the lead


class Ran(NamedTuple):
    """Rows 0 (where free run began) to `ahead`, [ahead + 1, B]: speed, yaw rate, and side speed of the rear axle."""

    speed: Tensor
    yaw_rate: Tensor
    slip: Tensor


class Runner(Protocol):
    """What can run freely from a window's row `warm` on."""

    def run(self, pool: Pool, window: Window) -> Ran: ...


class PhysicsRunner:
    """The single-track car alone.

    What it makes of the measured motion does not depend on any net, so it is driven along the whole pool once:
    features [n, 7] of kind hybrid, and its own side speed and yaw rate [n, 2], of the tick that ends in each row.
    """

    def __init__(self, physics: Physics, pool: Pool) -> None:
        self.physics = physics
        self.push = physics.push(pool.inputs.numpy(), pool.grade_rad.numpy())
        self.features, self.own = self._along(pool)

    def _along(self, pool: Pool) -> tuple[Tensor, Tensor]:
        """Pieces of all spans side by side, each begun LEAD_S early from rest."""
        physics, dt = self.physics, pool.dt_s
        lead, piece = round(LEAD_S / dt), round(PIECE_S / dt)
        begins = [row for begin, end in pool.spans for row in range(begin, end - 1, piece)]
        firsts = [max(begin, row - lead) for begin, end in pool.spans for row in range(begin, end - 1, piece)]
        ends = [min(row + piece, end - 1) for begin, end in pool.spans for row in range(begin, end - 1, piece)]
        first, begin, end = (np.array(some) for some in (firsts, begins, ends))
        motion, inputs = pool.motion.numpy(), pool.inputs.numpy() - np.array([pool.rest, pool.rest, 0.0])
        features, own = np.zeros((len(motion), 7)), np.zeros((len(motion), 2))
        state = np.zeros((3, len(first)))
        for k in range(1, int((end - first).max(initial=0)) + 1):
            row = np.minimum(first + k, end)
            speed = motion[row - 1, SPEED]
            state[0] = speed
            state = physics.after(state, self.push[row].T)
            keep = (first + k > begin) & (first + k <= end)
            told = [speed, motion[row - 1, YAW], *inputs[row].T, (state[0] - speed) / dt, state[2]]
            features[row[keep]] = np.stack(told, axis=1)[keep]
            own[row[keep]] = state[1:].T[keep]
        return torch.from_numpy(features), torch.from_numpy(own)

    def run(self, pool: Pool, window: Window) -> Ran:
        """Free run without a residual; no gradients."""
        behind_m = self.physics.p.rear_axle_m
        at = window.rows[window.warm]
        state = np.concatenate([pool.motion[at][:, :1], self.own[at]], axis=1).T
        pushes = self.push[window.rows.numpy()].transpose(0, 2, 1)
        rows = [state]
        for t in range(window.warm + 1, len(window.rows)):
            state = self.physics.after(state, pushes[t])
            rows.append(state)
        speed, side, yaw = torch.from_numpy(np.stack(rows, axis=1)).unbind(0)
        return Ran(speed, yaw, side - behind_m * yaw)


class HybridRunner(PhysicsRunner):
    """The single-track car with the cell's residual."""

    def __init__(self, base: PhysicsRunner, net: CellNet) -> None:
        self.physics, self.push, self.features, self.own = base.physics, base.push, base.features, base.own
        self.net = net

    def run(self, pool: Pool, window: Window) -> Ran:
        """Free run; gradients reach the net."""
        physics, net, dt, behind_m = self.physics, self.net, pool.dt_s, self.physics.p.rear_axle_m
        motion, inputs = _cut(pool, window)
        pushes = np.ascontiguousarray(self.push[window.rows.numpy()].transpose(0, 2, 1))
        features = self.features[window.rows[1 : window.warm + 1]].transpose(1, 2)
        side, own_yaw = self.own[window.rows[window.warm]].unbind(1)
        ready = net.ready()
        hidden, memory = net.over(ready, features)
        reached = motion[window.warm - 1, SPEED] + dt * features[-1, 5]  # by the physics, in the last measured tick
        last = put_out(ready, hidden)[1] * (reached / FADE_MPS).clamp(0.0, 1.0)
        speed, yaw = motion[window.warm, SPEED], motion[window.warm, YAW]
        speeds, yaws, slips = [speed], [yaw], [side + behind_m * (last - yaw)]
        for t in range(window.warm + 1, len(window.rows)):
            after = tick(physics, torch.stack([speed, side, own_yaw]), pushes[t])
            reached, side, own_yaw = after.unbind(0)
            told = torch.stack([(reached - speed) / dt, own_yaw])
            seen = torch.cat([torch.stack([speed, yaw]), inputs[t], told, hidden])
            hidden, memory = net.turn(torch.addmm(ready.bias, ready.both, seen), memory)
            residual = put_out(ready, hidden)
            slow = bool((reached < FADE_MPS).any())
            if slow:
                residual = residual * (reached / FADE_MPS).clamp(0.0, 1.0)
            speed, yaw, slip = reached + dt * residual[0], own_yaw + residual[1], side - behind_m * own_yaw
            if slow:
                moves = speed > 0.0
                speed = speed.clamp(min=0.0)
                yaw, slip = yaw * moves, slip * moves
            speeds.append(speed)
            yaws.append(yaw)
            slips.append(slip)
        return Ran(torch.stack(speeds), torch.stack(yaws), torch.stack(slips))


class CarriageRunner:
    """Kinds lstm and mlp: the network says acceleration and yaw rate, plant/learned/kinematics.py moves the car."""

    def __init__(self, params: Mapping[str, float], net: CellNet | LayerNet) -> None:
        own = {key: value for key, value in params.items() if key in DEFAULTS}
        self.grip = carriage_of("lstm", DEFAULTS, own, BodyChange()).grip_mps2
        self.net = net

    def features(self, pool: Pool, window: Window, end: int) -> Tensor:
        """[end - 1, 6, B]: the inputs of ticks 1 to end - 1 on what was measured."""
        motion, inputs = _cut(pool, window)
        before, own = motion[: end - 1], self._own(pool, window, motion)[: end - 1]
        return torch.cat(
            [before[:, SPEED : SPEED + 1], inputs[1:end], own.unsqueeze(1), before[:, YAW : YAW + 1]], dim=1
        )

    def _own(self, pool: Pool, window: Window, motion: Tensor) -> Tensor:
        """[T, B]: the rate of speed as it were on level ground."""
        return motion[:, ACCEL] + G_MPS2 * torch.sin(pool.grade_rad[window.rows])

    def run(self, pool: Pool, window: Window) -> Ran:
        """Free run; gradients reach the net."""
        net, dt = self.net, pool.dt_s
        motion, inputs = _cut(pool, window)
        slope = G_MPS2 * torch.sin(pool.grade_rad[window.rows])
        speed, yaw = motion[window.warm, SPEED], motion[window.warm, YAW]
        own = self._own(pool, window, motion)[window.warm]
        speeds, yaws = [speed], [yaw]
        ready = hidden = memory = None
        if isinstance(net, CellNet):
            ready = net.ready()
            hidden, memory = net.over(ready, self.features(pool, window, window.warm + 1))
        for t in range(window.warm + 1, len(window.rows)):
            seen = torch.cat([speed.unsqueeze(0), inputs[t], torch.stack([own, yaw])])
            if isinstance(net, CellNet) and ready is not None and hidden is not None and memory is not None:
                hidden, memory = net.turn(torch.addmm(ready.bias, ready.both, torch.cat([seen, hidden])), memory)
                said = put_out(ready, hidden)
            else:
                said = net(seen)
            speed, yaw, own = self._moved(speed, said, slope[t], dt)
            speeds.append(speed)
            yaws.append(yaw)
        shown = torch.stack(speeds)
        return Ran(shown, torch.stack(yaws), torch.zeros_like(shown))

    def _moved(self, before: Tensor, said: Tensor, slope: Tensor, dt: float) -> tuple[Tensor, Tensor, Tensor]:
        """Speed, yaw rate and own acceleration after a tick, as `driven` and `said_of` of plant/learned/kinematics.py."""
        own = said[0].clamp(-self.grip, self.grip)
        speed = before + dt * (own - slope)
        yaw = said[1]
        if bool((speed < FADE_MPS).any()):
            stays = (speed < 0.0) | ((before <= 0.0) & (own < PULL_AWAY_MPS2))
            speed = torch.where(stays, torch.zeros_like(speed), speed)
        most = self.grip / speed.detach().clamp(min=LEAST_MPS)
        if bool((yaw.detach().abs() > most).any()):
            yaw = torch.minimum(torch.maximum(yaw, -most), most)
        return speed, yaw * (speed / FADE_MPS).clamp(0.0, 1.0), own * (speed > 0.0)


def _cut(pool: Pool, window: Window) -> tuple[Tensor, Tensor]:
    """(motion [T, 6, B], inputs over rest [T, 3, B]) of the windows."""
    over = torch.tensor([pool.rest, pool.rest, 0.0], dtype=torch.float64)
    inputs = (pool.inputs[window.rows] - over).transpose(1, 2).contiguous()
    return pool.motion[window.rows].transpose(1, 2).contiguous(), inputs


class Errors(NamedTuple):
    """Free run minus what was measured, [ahead, B]: speed, yaw rate, heading turned since the start, distance apart."""

    speed_mps: Tensor
    yaw_rate_radps: Tensor
    heading_rad: Tensor
    position_m: Tensor


def pose_of(ran: Ran, dt_s: float) -> tuple[Tensor, Tensor, Tensor]:
    """(heading turned, x ahead, y to the left) since the start, [ahead, B], by midpoints as plant/kinematics.py."""
    mean_yaw = 0.5 * (ran.yaw_rate[1:] + ran.yaw_rate[:-1])
    heading = torch.cumsum(dt_s * mean_yaw, 0)
    middle = heading - 0.5 * dt_s * mean_yaw
    along, across = 0.5 * dt_s * (ran.speed[1:] + ran.speed[:-1]), 0.5 * dt_s * (ran.slip[1:] + ran.slip[:-1])
    cosine, sine = torch.cos(middle), torch.sin(middle)
    return heading, torch.cumsum(along * cosine - across * sine, 0), torch.cumsum(along * sine + across * cosine, 0)


def errors_of(ran: Ran, pool: Pool, window: Window) -> Errors:
    """What the free run missed; the distance is kept from 0, where it would have no slope."""
    truth = pool.motion[window.rows[window.warm :]]  # [ahead + 1, B, 6]
    heading, x, y = pose_of(ran, pool.dt_s)
    turned = truth[1:, :, HEADING] - truth[:1, :, HEADING]
    cosine, sine = torch.cos(truth[:1, :, HEADING]), torch.sin(truth[:1, :, HEADING])
    dx, dy = truth[1:, :, X] - truth[:1, :, X], truth[1:, :, Y] - truth[:1, :, Y]
    ahead, left = dx * cosine + dy * sine, dy * cosine - dx * sine
    apart = torch.sqrt((x - ahead) ** 2 + (y - left) ** 2 + 1e-12)
    return Errors(ran.speed[1:] - truth[1:, :, SPEED], ran.yaw_rate[1:] - truth[1:, :, YAW], heading - turned, apart)
