"""Teacher forcing: kind hybrid along the measured motion, whole windows in one call of torch's LSTM.

The residual is integrated as in free run, but physics and cell receive the measured motion at every tick. A speed error
does not feed back on the forces, which matters little over ten seconds; but a tick costs a tenth. So the net can be
trained on long windows, in which a bias of hundredths of a m/s2 is visible.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from tunefree_hil.learn.training.nets import N_CELL_UNITS, CellNet
from tunefree_hil.learn.training.rollout import FreeRun, PhysicsRunner
from tunefree_hil.learn.training.windows import SPEED, YAW, TrackPool, WindowBatch
from tunefree_hil.plant.hybrid import FADE_MPS


class TeacherForcedRunner:
    """The features of the physics along a pool, and the net that is trained on them."""

    def __init__(self, base: PhysicsRunner, net: CellNet) -> None:
        self.base, self.net = base, net
        self.layer = nn.LSTM(len(net.mean), N_CELL_UNITS)  # provides the fast loop; the weights are those of the net

    def run(self, pool: TrackPool, window: WindowBatch) -> FreeRun:
        """Run along the measured motion, with gradients to the net.

        Agrees with the cell's own step within 1e-5, since the loop is in float32.
        """
        warm_up, dt, com_to_rear_m = window.warm_up, pool.dt_s, self.base.physics.p.rear_axle_m
        features = self.base.features[window.rows[1:]]  # shape (n_ticks, n_windows, 7)
        known = features[warm_up:]
        motion = pool.motion[window.rows[warm_up:]]
        lateral = self.base.lateral[window.rows[warm_up:]]  # side speed and yaw rate of the physics
        reached = motion[:-1, :, SPEED] + dt * known[..., 5]
        residual = self.outputs(features)[warm_up:] * (reached / FADE_MPS).clamp(0.0, 1.0).unsqueeze(-1)
        speed = motion[:1, :, SPEED] + torch.cumsum(dt * (known[..., 5] + residual[..., 0]), 0)
        yaw_rate = known[..., 6] + residual[..., 1]
        return FreeRun(
            torch.cat([motion[:1, :, SPEED], speed]),
            torch.cat([motion[:1, :, YAW], yaw_rate]),
            lateral[..., 0] - com_to_rear_m * lateral[..., 1],
        )

    def outputs(self, features: Tensor) -> Tensor:
        """The two bounded outputs of the cell, from memory 0.

        Args:
            features: Shape (n_ticks, n_windows, n_inputs).

        Returns:
            Shape (n_ticks, n_windows, 2).
        """
        net = self.net
        weights = {
            "weight_ih_l0": net.w_in.float(),
            "weight_hh_l0": net.w_rec.float(),
            "bias_ih_l0": net.bias.float(),
            "bias_hh_l0": torch.zeros(4 * N_CELL_UNITS),
        }
        scaled = ((features - net.mean) / net.scale).float()
        hidden, _ = torch.func.functional_call(self.layer, weights, (scaled,))
        return net.bound * torch.tanh(hidden.double() @ net.w_out.T + net.b_out)
