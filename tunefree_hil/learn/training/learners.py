"""What is trained, and on what: free run for kinds hybrid and lstm, one step ahead for mlp and paper.

A learner draws its batches from (seed, step) alone, so a training can be cut off and go on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.learn.drives.drive import Array
from tunefree_hil.learn.evaluation.motion import body_change
from tunefree_hil.learn.training.nets import CellNet, LayerNet
from tunefree_hil.learn.training.physics import Physics
from tunefree_hil.learn.training.rollout import CarriageRunner, HybridRunner, PhysicsRunner, Runner, errors_of
from tunefree_hil.learn.training.teacher_forcing import GuidedRunner
from tunefree_hil.learn.training.windows import ACCEL, YAW, Pool, begins, chances_of, drawn, spread, window_at

WARM_S = 1.0
BATCH = 256
GUIDED_COST = 0.15  # of a tick of free run
BLIND = (1,)  # yaw rate: what the cell says of it would come back as what it is told, and drift
HELD_OUT_S = (10.0, 5.0, 3.0, 1.0)  # the longest that the held-out drives have room for
HELD_OUT_WINDOWS, SCALE_WINDOWS = 256, 512
FLOORS = (0.02, 0.003, 0.002, 0.02)  # m/s, rad/s, rad, m: what sensors can tell
WEIGHTS = (1.0, 0.5, 1.0, 2.0)  # of speed, yaw rate, heading and position in the loss
PEDALS = (2, 3)  # inputs
FINER = 3.0  # their scale: finer than the spread that full throttle makes, for a pedal bites early
LEAST_SPREAD = 1e-3  # of an input: one that never changed is not blown up
LAST_PACE = 0.02  # of a rate, at the end of its cosine
SMALL = 0.1  # unit errors from which on the loss grows with the error and not with its square: a mean is judged


class Stage(NamedTuple):
    """From `share` of the steps on: windows of `ahead_s` of free (or guided) run."""

    share: float
    ahead_s: float
    guided: bool = False


class Span(NamedTuple):
    """A stage on the data at hand. begins: the rows at which its windows can begin, with their chances of being drawn.

    batch: how many of them a step.
    """

    share: float
    ahead: int
    begins: Array
    chances: Array
    batch: int
    guided: bool


STAGES = {
    "hybrid": (Stage(0.0, 10.0, True), Stage(0.96, 5.0)),
    "lstm": (Stage(0.0, 1.0), Stage(0.2, 2.0), Stage(0.5, 3.0)),
}
SHORTEST_S = 3.0  # drives without room for that are refused; shorter stages than wished are not
GUIDED_SHARE = 0.25  # of a batch: their windows are long
AFTER_GUIDED = 0.05  # of the rate at which training began, where free run begins on what guided run has learned


class Wish(NamedTuple):
    """What decides a training. steps: of the optimiser (0: see `fit`); batch: windows (free run) a step."""

    kind: str
    seed: int
    steps: int = 0
    batch: int = BATCH
    sample_spacing_s: float = 0.01
    minutes: float = 0.0


class Learner(Protocol):
    """A network with its data."""

    @property
    def net(self) -> nn.Module: ...

    def plan(self, steps: int) -> None: ...

    def loss(self, step: int) -> Tensor: ...

    def score(self) -> float: ...

    def cost(self, step: int) -> float: ...

    def pace(self, step: int) -> float: ...

    def arrays(self) -> dict[str, Array]: ...


class FreeRunLearner:
    """Kinds hybrid and lstm: free run after a second of warm-up, over longer and longer windows.

    Errors are taken in units of what the fitted physics typically misses after the same time, so that every instant
    and every quantity counts alike.
    """

    def __init__(self, wish: Wish, training: Pool, held_out: Pool, model: ModelSpec) -> None:
        self.wish, self.training, self.held_out, self.steps = wish, training, held_out, max(wish.steps, 1)
        self.warm = round(WARM_S / training.dt_s)
        require_some(begins(training, self.warm, round(SHORTEST_S / training.dt_s)), training, "training")
        self.spans = [self._span(stage) for stage in STAGES[wish.kind]]
        self.held_begins, self.held_ahead = held_out_windows(held_out, self.warm)
        physics = Physics(model.plant.params, training.dt_s, body_change(model))
        base = PhysicsRunner(physics, training)
        self.units = self._units(base)
        self.net, self.runner, self.held_runner = self._made(physics, base, model.plant.params)
        self.guided = GuidedRunner(base, self.net) if any(span.guided for span in self.spans) else None

    def plan(self, steps: int) -> None:
        """How many steps the training is to have (at least one): its stages are shares of them."""
        self.steps = max(steps, 1)

    def loss(self, step: int) -> Tensor:
        """Of the batch of a step."""
        span = self._span_at(step)
        runner = self.guided if span.guided and self.guided is not None else self.runner
        some = drawn(span.begins, span.batch, self.wish.seed, step, span.chances)
        window = window_at(some, self.warm, span.ahead)
        errors = errors_of(runner.run(self.training, window), self.training, window)
        parts = [
            weight * (torch.sqrt(SMALL**2 + (error / unit[: span.ahead]) ** 2) - SMALL).mean()
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
        """Ticks that a step takes, of free run."""
        span = self._span_at(step)
        ticks = (self.warm + span.ahead) * (0.5 + 0.5 * span.batch / BATCH)  # half of a tick costs whatever the batch
        return ticks * (GUIDED_COST if span.guided else 1.0)

    def pace(self, step: int) -> float:
        """Share of the first rate: a cosine over the guided stages, and one over those in free run."""
        guided = self._span_at(step).guided
        first = next(span.share for span in self.spans if span.guided == guided)
        last = next((span.share for span in self.spans if span.share > first and span.guided != guided), 1.0)
        share = (step / self.steps - first) / (last - first)
        return (AFTER_GUIDED if self.guided is not None and not guided else 1.0) * cosine(share)

    def arrays(self) -> dict[str, Array]:
        """Of plant.npz."""
        return self.net.arrays()

    def _span(self, stage: Stage) -> Span:
        """As long as is wished, or as the drives have room for."""
        for seconds in (stage.ahead_s, *(shorter for shorter in HELD_OUT_S if shorter < stage.ahead_s)):
            ahead = round(seconds / self.training.dt_s)
            some = begins(self.training, self.warm, ahead)
            if len(some):
                break
        batch = max(round(self.wish.batch * GUIDED_SHARE), 1) if stage.guided else self.wish.batch
        chances = chances_of(self.training, some, self.warm, ahead)
        return Span(stage.share, ahead, some, chances, batch, stage.guided)

    def _span_at(self, step: int) -> Span:
        share = step / self.steps
        return [span for span in self.spans if share >= span.share][-1]

    def _units(self, base: PhysicsRunner) -> list[Tensor]:
        """[T, 1] for each error: two thirds of the windows' errors by physics are below it."""
        longest = max(self.spans, key=lambda span: span.ahead)
        window = window_at(spread(longest.begins, SCALE_WINDOWS), self.warm, longest.ahead)
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
            mean, scale = scaling(features)
            scale[list(PEDALS)] /= FINER
            net = CellNet(mean, scale, bound, wish.seed, blind=BLIND)
            return net, HybridRunner(base, net), HybridRunner(PhysicsRunner(physics, self.held_out), net)
        bound = [_bound(motion[..., ACCEL], 1.5, 3.0, 12.0), _bound(motion[..., YAW], 1.5, 0.3, 3.0)]
        runner = CarriageRunner(params, LayerNet(np.zeros(1), np.ones(1), bound, 0))
        net = CellNet(*scaling(runner.features(pool, window, self.warm + 1)), bound, wish.seed, still=False)
        return net, CarriageRunner(params, net), CarriageRunner(params, net)


def cosine(share: float) -> float:
    """From 1 at share 0 to LAST_PACE at share 1."""
    return LAST_PACE + (1.0 - LAST_PACE) * 0.5 * (1.0 + math.cos(math.pi * share))


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
            hint=f"stretches of at least {WARM_S + SHORTEST_S:g} s in drive gear, moving, with by-wire control",
        )
