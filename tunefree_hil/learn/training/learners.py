"""What is trained, and on what: free run for kinds hybrid and lstm, one step ahead for mlp and paper.

A learner draws its batches from (seed, step) alone, so a training can be cut off and go on.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.learn.drives import Array
from tunefree_hil.learn.motion import body_change
from tunefree_hil.learn.training.nets import CellNet, LayerNet
from tunefree_hil.learn.training.physics import Physics
from tunefree_hil.learn.training.rollout import CarriageRunner, HybridRunner, PhysicsRunner, Runner, errors_of
from tunefree_hil.learn.training.windows import ACCEL, YAW, Pool, begins, drawn, spread, window_at

WARM_S = 1.0
STAGES = ((0.0, 1.0), (0.2, 2.0), (0.5, 3.0))  # from this share of the training on, so many seconds of free run
HELD_OUT_S = (10.0, 5.0, 3.0, 1.0)  # the longest that the held-out drives have room for
HELD_OUT_WINDOWS, SCALE_WINDOWS = 256, 512
FLOORS = (0.02, 0.003, 0.002, 0.02)  # m/s, rad/s, rad, m: what sensors can tell
WEIGHTS = (1.0, 0.5, 1.0, 2.0)  # of speed, yaw rate, heading and position in the loss
LEAST_SPREAD = 1e-3  # of an input: one that never changed is not blown up


class Wish(NamedTuple):
    """What decides a training. steps: of the optimiser; batch: windows (free run) a step."""

    kind: str
    seed: int
    steps: int
    batch: int = 256
    sample_spacing_s: float = 0.01


class Learner(Protocol):
    """A network with its data."""

    @property
    def net(self) -> nn.Module: ...

    def loss(self, step: int) -> Tensor: ...

    def score(self) -> float: ...

    def cost(self, step: int) -> float: ...

    def arrays(self) -> dict[str, Array]: ...


class FreeRunLearner:
    """Kinds hybrid and lstm: free run after a second of warm-up, over longer and longer windows.

    Errors are taken in units of what the fitted physics typically misses after the same time, so that every instant
    and every quantity counts alike.
    """

    def __init__(self, wish: Wish, training: Pool, held_out: Pool, model: ModelSpec) -> None:
        self.wish, self.training, self.held_out = wish, training, held_out
        self.warm = round(WARM_S / training.dt_s)
        self.ahead = [(share, round(seconds / training.dt_s)) for share, seconds in STAGES]
        self.begins = {ahead: begins(training, self.warm, ahead) for _, ahead in self.ahead}
        self.held_begins, self.held_ahead = held_out_windows(held_out, self.warm)
        require_some(self.begins[self.ahead[-1][1]], training, "training")
        physics = Physics(model.plant.params, training.dt_s, body_change(model))
        base = PhysicsRunner(physics, training)
        self.units = self._units(base)
        self.net, self.runner, self.held_runner = self._made(physics, base, model.plant.params)

    def loss(self, step: int) -> Tensor:
        """Of the batch of a step."""
        ahead = self._ahead(step)
        window = window_at(drawn(self.begins[ahead], self.wish.batch, self.wish.seed, step), self.warm, ahead)
        errors = errors_of(self.runner.run(self.training, window), self.training, window)
        parts = [
            weight * (torch.sqrt(1.0 + (error / unit[:ahead]) ** 2) - 1.0).mean()
            for weight, error, unit in zip(WEIGHTS, errors, self.units, strict=True)
        ]
        return torch.stack(parts).sum() / sum(WEIGHTS)

    def score(self) -> float:
        """Mean position error at the end of the held-out windows, m."""
        window = window_at(self.held_begins, self.warm, self.held_ahead)
        with torch.no_grad():
            errors = errors_of(self.held_runner.run(self.held_out, window), self.held_out, window)
        return float(errors.position_m[-1].mean())

    def cost(self, step: int) -> float:
        """Ticks that a step takes."""
        return float(self.warm + self._ahead(step))

    def arrays(self) -> dict[str, Array]:
        """Of plant.npz."""
        return self.net.arrays()

    def _ahead(self, step: int) -> int:
        share = step / max(self.wish.steps, 1)
        return [ahead for begin, ahead in self.ahead if share >= begin][-1]

    def _units(self, base: PhysicsRunner) -> list[Tensor]:
        """[T, 1] for each error: two thirds of the windows' errors by physics are below it."""
        ahead = self.ahead[-1][1]
        window = window_at(spread(self.begins[ahead], SCALE_WINDOWS), self.warm, ahead)
        errors = errors_of(base.run(self.training, window), self.training, window)
        return [
            torch.quantile(error.abs(), 0.67, dim=1, keepdim=True).clamp(min=floor)
            for error, floor in zip(errors, FLOORS, strict=True)
        ]

    def _made(
        self, physics: Physics, base: PhysicsRunner, params: Mapping[str, float]
    ) -> tuple[CellNet, Runner, Runner]:
        """The net with its scaling and bounds, and its runners on both pools."""
        pool, wish = self.training, self.wish
        window = window_at(spread(begins(pool, self.warm, 1), SCALE_WINDOWS), self.warm, 1)
        motion = pool.motion[window.rows[1 : self.warm + 1]]  # after each tick
        if wish.kind == "hybrid":
            features = base.features[window.rows[1 : self.warm + 1]].transpose(1, 2)
            missed = (motion[..., ACCEL] - features[:, 5], motion[..., YAW] - features[:, 6])
            bound = [_bound(missed[0], 2.0, 0.5, 4.0), _bound(missed[1], 2.0, 0.03, 0.5)]
            net = CellNet(*scaling(features), bound, wish.seed)
            return net, HybridRunner(physics, pool, net), HybridRunner(physics, self.held_out, net)
        bound = [_bound(motion[..., ACCEL], 1.5, 3.0, 12.0), _bound(motion[..., YAW], 1.5, 0.3, 3.0)]
        runner = CarriageRunner(params, LayerNet(np.zeros(1), np.ones(1), bound, 0))
        net = CellNet(*scaling(runner.features(pool, window, self.warm + 1)), bound, wish.seed, still=False)
        return net, CarriageRunner(params, net), CarriageRunner(params, net)


def held_out_windows(pool: Pool, warm: int) -> tuple[Array, int]:
    """(rows at which windows begin, ticks of free run): the longest free run that the pool has room for."""
    for seconds in HELD_OUT_S:
        ahead = round(seconds / pool.dt_s)
        some = begins(pool, warm, ahead, every=round(0.5 / pool.dt_s))
        if len(some):
            return spread(some, HELD_OUT_WINDOWS), ahead
    require_some(np.zeros(0), pool, "held-out")
    raise AssertionError  # it has raised


def scaling(features: Tensor) -> tuple[Array, Array]:
    """(mean, scale) of features [T, I, B]."""
    flat = features.transpose(1, 2).reshape(-1, features.shape[1])
    return flat.mean(0).numpy(), flat.std(0).clamp(min=LEAST_SPREAD).numpy()


def _bound(values: Tensor, times: float, least: float, most: float) -> float:
    high = float(np.quantile(values.abs().numpy(), 0.995))
    return min(max(times * high, least), most)


def require_some(some: Array, pool: Pool, which: str) -> None:
    """Raises InputError where `some` rows of a pool are none."""
    if len(some) == 0:
        raise InputError(
            f"the {which} drives hold no stretch to learn from: {pool.seconds:.0f} s of them can be used, in pieces",
            code="too_short",
            key="LOG",
            hint=f"stretches of at least {WARM_S + STAGES[-1][1]:g} s in drive gear, moving, with by-wire control",
        )
