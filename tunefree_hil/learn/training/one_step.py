"""Kinds mlp and paper: trained one step ahead on labels, as in the Baidu paper."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from tunefree_hil.base.units import G_MPS2
from tunefree_hil.learn.drives.drive import Array
from tunefree_hil.learn.training.learners import (
    MIN_INPUT_SPREAD,
    TrainingPlan,
    compute_scaling,
    cosine_rate,
    require_rows,
)
from tunefree_hil.learn.training.nets import CellNet, LayerNet
from tunefree_hil.learn.training.windows import ACCEL, SPEED, YAW, TrackPool, draw_rows, spread_evenly
from tunefree_hil.plant.paper import SAMPLES

BATCH_ROWS = 2048
MAX_HOLDOUT_ROWS = 20_000
BOUND_MARGIN = 1.5  # bound of the outputs over the largest label


class OneStepLearner:
    """Predicts rate of speed (on level ground) and yaw rate of the next tick (mlp) or sample (paper).

    Errors are in units of the standard deviation of the labels.
    """

    def __init__(self, plan: TrainingPlan, training: TrackPool, held_out: TrackPool) -> None:
        self.plan, self.training, self.held_out, self.steps = plan, training, held_out, max(plan.steps, 1)
        self.gap = max(round(plan.sample_spacing_s / training.dt_s), 1) if plan.kind == "paper" else 1
        back = 1 + (SAMPLES - 1) * self.gap if plan.kind == "paper" else 1
        self.rows, held_out_rows = (find_rows_with_context(pool, back, self.gap) for pool in (training, held_out))
        require_rows(self.rows, training, "training")
        require_rows(held_out_rows, held_out, "held-out")
        self.held_out_rows = spread_evenly(held_out_rows, MAX_HOLDOUT_ROWS)
        labels = self._labels(training, self.rows)
        self.mean, self.spread = labels.mean(1, keepdim=True), labels.std(1, keepdim=True).clamp(min=MIN_INPUT_SPREAD)
        self.bound = (BOUND_MARGIN * labels.abs().amax(1)).clamp(min=MIN_INPUT_SPREAD)
        self.net = self._make_net()

    def loss(self, step: int) -> Tensor:
        """Mean squared error of the batch of a step."""
        rows = draw_rows(self.rows, BATCH_ROWS, self.plan.seed, step)
        return (self._errors(self.training, rows) ** 2).mean()

    def score(self) -> float:
        """Root mean square error on held-out rows."""
        with torch.no_grad():
            errors = [self._errors(self.held_out, rows) for rows in np.array_split(self.held_out_rows, 10) if len(rows)]
        return float(torch.sqrt((torch.cat(errors, dim=1) ** 2).mean()))

    def cost(self, step: int) -> float:
        """All steps cost the same."""
        return 1.0

    def rate_share(self, step: int) -> float:
        """Share of the initial rate: one cosine."""
        return cosine_rate(step / self.steps)

    def arrays(self) -> dict[str, Array]:
        """The arrays of plant.npz; outputs of kind paper are in m/s2 and rad/s."""
        arrays = self.net.arrays()
        if self.plan.kind == "paper":
            arrays["w_out"] = arrays["w_out"] * self.spread.numpy()
            arrays["b_out"] = arrays["b_out"] * self.spread[:, 0].numpy() + self.mean[:, 0].numpy()
        return arrays

    def _errors(self, pool: TrackPool, rows: Array) -> Tensor:
        """Scaled errors, shape (2, n_rows)."""
        labels = self._labels(pool, rows)
        if isinstance(self.net, LayerNet):
            return (self.net(self._features(pool, rows)[0]) - labels) / self.spread
        weights = self.net.rollout_weights()
        hidden, _ = self.net.run(weights, self._features(pool, rows))
        return torch.addmm(weights.out_bias, weights.out, hidden) - (labels - self.mean) / self.spread

    def _labels(self, pool: TrackPool, rows: Array) -> Tensor:
        """Targets of the net at the ticks that end in `rows`, shape (2, n_rows)."""
        after = torch.from_numpy(rows) - 1 + self.gap
        if self.gap > 1 or self.plan.kind == "paper":
            return torch.stack([_level_accel(pool, after), pool.motion[after, YAW]])
        rate = (pool.motion[after, SPEED] - pool.motion[after - 1, SPEED]) / pool.dt_s
        return torch.stack([rate + _slope_accel(pool, after), pool.motion[after, YAW]])

    def _features(self, pool: TrackPool, rows: Array) -> Tensor:
        """Inputs of the net at the ticks that end in `rows`, shape (n_ticks, n_inputs, n_rows).

        Kind mlp has one tick, kind paper the SAMPLES before, oldest first.
        """
        rest = torch.tensor([pool.rest, pool.rest, 0.0], dtype=torch.float64)
        ends = torch.from_numpy(rows)
        if self.plan.kind == "mlp":
            before = pool.motion[ends - 1]
            accel = _level_accel(pool, ends - 1).unsqueeze(1)
            parts = [before[:, SPEED : SPEED + 1], pool.inputs[ends] - rest, accel, before[:, YAW : YAW + 1]]
            return torch.cat(parts, dim=1).T.unsqueeze(0)
        times = ends.unsqueeze(0) - self.gap * torch.arange(SAMPLES - 1, -1, -1).unsqueeze(1)
        speed = pool.motion[times - 1][..., SPEED : SPEED + 1]
        accel = _level_accel(pool, times - 1).unsqueeze(-1)
        return torch.cat([pool.commands[times] - rest, speed, accel], 2).transpose(1, 2)

    def _make_net(self) -> CellNet | LayerNet:
        features = self._features(self.training, spread_evenly(self.rows, MAX_HOLDOUT_ROWS))
        scaling = compute_scaling(features, self.bound.tolist())
        if self.plan.kind == "mlp":
            return LayerNet(scaling, self.plan.seed)
        return CellNet(scaling, self.plan.seed, relu=True, zero_outputs=False)


def _slope_accel(pool: TrackPool, rows: Tensor) -> Tensor:
    """Deceleration by the slope, m/s2, which plant/learned/kinematics.py subtracts again."""
    return G_MPS2 * torch.sin(pool.grade_rad[rows])


def _level_accel(pool: TrackPool, rows: Tensor) -> Tensor:
    """Rate of speed on level ground."""
    return pool.motion[rows][..., ACCEL] + _slope_accel(pool, rows)


def find_rows_with_context(pool: TrackPool, back: int, ahead: int) -> Array:
    """Rows of the pool with so many usable rows before and behind them."""
    rows = [np.arange(begin + back, end - ahead) for begin, end in pool.spans if end - begin > back + ahead]
    return np.concatenate(rows) if rows else np.zeros(0, dtype=int)
