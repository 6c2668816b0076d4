"""Kinds mlp and paper: trained one step ahead on labels, as the paper's are (apollo_facts 5.3)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from tunefree_hil.base.units import G_MPS2
from tunefree_hil.learn.drives.drive import Array
from tunefree_hil.learn.training.learners import LEAST_SPREAD, Wish, cosine, require_some
from tunefree_hil.learn.training.nets import CellNet, LayerNet
from tunefree_hil.learn.training.windows import ACCEL, SPEED, YAW, Pool, drawn, spread
from tunefree_hil.plant.paper import SAMPLES

ROWS = 2048  # a step
HELD_OUT_ROWS = 20_000
BOUND_TIMES = 1.5  # of the largest label


class OneStepLearner:
    """Labels are the rate of speed (on level ground) and the yaw rate of the next tick (mlp) or sample (paper).

    Errors count in units of the labels' spread.
    """

    def __init__(self, wish: Wish, training: Pool, held_out: Pool) -> None:
        self.wish, self.training, self.held_out, self.steps = wish, training, held_out, max(wish.steps, 1)
        self.gap = max(round(wish.sample_spacing_s / training.dt_s), 1) if wish.kind == "paper" else 1
        back = 1 + (SAMPLES - 1) * self.gap if wish.kind == "paper" else 1
        self.rows, held = (rows_with(pool, back, self.gap) for pool in (training, held_out))
        require_some(self.rows, training, "training")
        require_some(held, held_out, "held-out")
        self.held_rows = spread(held, HELD_OUT_ROWS)
        labels = self._labels(training, self.rows)
        self.mean, self.spread = labels.mean(1, keepdim=True), labels.std(1, keepdim=True).clamp(min=LEAST_SPREAD)
        self.bound = (BOUND_TIMES * labels.abs().amax(1)).clamp(min=LEAST_SPREAD)
        self.net = self._made()

    def plan(self, steps: int) -> None:
        """How many steps the training is to have, at least one."""
        self.steps = max(steps, 1)

    def loss(self, step: int) -> Tensor:
        """Mean square error of a batch."""
        rows = drawn(self.rows, ROWS, self.wish.seed, step)
        return (self._missed(self.training, rows) ** 2).mean()

    def score(self) -> float:
        """Root mean square error on held-out rows."""
        with torch.no_grad():
            missed = [self._missed(self.held_out, some) for some in np.array_split(self.held_rows, 10) if len(some)]
        return float(torch.sqrt((torch.cat(missed, dim=1) ** 2).mean()))

    def cost(self, step: int) -> float:
        """Every step costs the same."""
        return 1.0

    def pace(self, step: int) -> float:
        """One cosine."""
        return cosine(step / self.steps)

    def arrays(self) -> dict[str, Array]:
        """Of plant.npz; the paper's outputs leave the net in m/s2 and rad/s."""
        found = self.net.arrays()
        if self.wish.kind == "paper":
            found["w_out"] = found["w_out"] * self.spread.numpy()
            found["b_out"] = found["b_out"] * self.spread[:, 0].numpy() + self.mean[:, 0].numpy()
        return found

    def _missed(self, pool: Pool, rows: Array) -> Tensor:
        """[2, M] in units of the labels' spread."""
        labels = self._labels(pool, rows)
        if isinstance(self.net, LayerNet):
            return (self.net(self._features(pool, rows)[0]) - labels) / self.spread
        ready = self.net.ready()
        hidden, _ = self.net.over(ready, self._features(pool, rows))
        return torch.addmm(ready.out_bias, ready.out, hidden) - (labels - self.mean) / self.spread

    def _labels(self, pool: Pool, rows: Array) -> Tensor:
        """[2, M]: what the net is to say at the ticks that end in `rows`."""
        after = torch.from_numpy(rows) - 1 + self.gap
        if self.gap > 1 or self.wish.kind == "paper":
            return torch.stack([_level(pool, after), pool.motion[after, YAW]])
        rate = (pool.motion[after, SPEED] - pool.motion[after - 1, SPEED]) / pool.dt_s
        return torch.stack([rate + _slope(pool, after), pool.motion[after, YAW]])

    def _features(self, pool: Pool, rows: Array) -> Tensor:
        """[T, I, M]: the inputs of the ticks that end in `rows`; of kind paper the SAMPLES before, oldest first."""
        over = torch.tensor([pool.rest, pool.rest, 0.0], dtype=torch.float64)
        ends = torch.from_numpy(rows)
        if self.wish.kind == "mlp":
            was = pool.motion[ends - 1]
            own = _level(pool, ends - 1).unsqueeze(1)
            parts = [was[:, SPEED : SPEED + 1], pool.inputs[ends] - over, own, was[:, YAW : YAW + 1]]
            return torch.cat(parts, dim=1).T.unsqueeze(0)
        times = ends.unsqueeze(0) - self.gap * torch.arange(SAMPLES - 1, -1, -1).unsqueeze(1)
        speed = pool.motion[times - 1][..., SPEED : SPEED + 1]
        own = _level(pool, times - 1).unsqueeze(-1)
        return torch.cat([pool.commands[times] - over, speed, own], 2).transpose(1, 2)

    def _made(self) -> CellNet | LayerNet:
        features = self._features(self.training, spread(self.rows, HELD_OUT_ROWS))
        flat = features.transpose(1, 2).reshape(-1, features.shape[1])
        mean, scale = flat.mean(0).numpy(), flat.std(0).clamp(min=LEAST_SPREAD).numpy()
        if self.wish.kind == "mlp":
            return LayerNet(mean, scale, self.bound.tolist(), self.wish.seed)
        return CellNet(mean, scale, self.bound.tolist(), self.wish.seed, relu=True, still=False)


def _slope(pool: Pool, rows: Tensor) -> Tensor:
    """What the road takes off the acceleration, m/s2: plant/learned/kinematics.py takes it off again."""
    return G_MPS2 * torch.sin(pool.grade_rad[rows])


def _level(pool: Pool, rows: Tensor) -> Tensor:
    """The rate of speed as it were on level ground."""
    return pool.motion[rows][..., ACCEL] + _slope(pool, rows)


def rows_with(pool: Pool, back: int, ahead: int) -> Array:
    """Rows of the pool that have so many good rows before and behind them."""
    found = [np.arange(begin + back, end - ahead) for begin, end in pool.spans if end - begin > back + ahead]
    return np.concatenate(found) if found else np.zeros(0, dtype=int)
