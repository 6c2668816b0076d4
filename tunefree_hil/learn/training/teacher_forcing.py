"""Guided run: kind hybrid along the measured motion, whole windows in one call of the library's own LSTM.

The residual is summed up as in free run, but physics and cell are told the measured motion at every tick. What differs
from free run is only how an error in speed acts back on the forces, which is little over ten seconds; in return a tick
costs a tenth. So long windows can be learned from, in which a bias of hundredths of a m/s2 shows.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from tunefree_hil.learn.training.nets import UNITS, CellNet
from tunefree_hil.learn.training.rollout import PhysicsRunner, Ran
from tunefree_hil.learn.training.windows import SPEED, YAW, Pool, Window
from tunefree_hil.plant.hybrid import FADE_MPS


class GuidedRunner:
    """The physics' features along a pool, and the net that is trained on them."""

    def __init__(self, base: PhysicsRunner, net: CellNet) -> None:
        self.base, self.net = base, net
        self.layer = nn.LSTM(len(net.mean), UNITS)  # lends its loop; the weights are the net's

    def run(self, pool: Pool, window: Window) -> Ran:
        """Guided run; gradients reach the net. Within 1e-5 of the cell's own step: the loop is in float32."""
        warm, dt, behind_m = window.warm, pool.dt_s, self.base.physics.p.rear_axle_m
        features = self.base.features[window.rows[1:]]  # [T, B, 7]
        known = features[warm:]
        motion = pool.motion[window.rows[warm:]]
        own = self.base.own[window.rows[warm:]]  # side speed and yaw rate of the physics
        reached = motion[:-1, :, SPEED] + dt * known[..., 5]
        residual = self.outputs(features)[warm:] * (reached / FADE_MPS).clamp(0.0, 1.0).unsqueeze(-1)
        speed = motion[:1, :, SPEED] + torch.cumsum(dt * (known[..., 5] + residual[..., 0]), 0)
        yaw_rate = known[..., 6] + residual[..., 1]
        return Ran(
            torch.cat([motion[:1, :, SPEED], speed]),
            torch.cat([motion[:1, :, YAW], yaw_rate]),
            own[..., 0] - behind_m * own[..., 1],
        )

    def outputs(self, features: Tensor) -> Tensor:
        """The cell's two outputs [T, B, 2], bounded, for features [T, B, I], from memory 0."""
        net = self.net
        weights = {
            "weight_ih_l0": net.w_in.float(), "weight_hh_l0": net.w_rec.float(), "bias_ih_l0": net.bias.float(),
            "bias_hh_l0": torch.zeros(4 * UNITS),
        }  # fmt: skip
        seen = ((features - net.mean) / net.scale).float()
        hidden, _ = torch.func.functional_call(self.layer, weights, (seen,))
        return net.bound * torch.tanh(hidden.double() @ net.w_out.T + net.b_out)
