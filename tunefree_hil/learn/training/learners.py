"""The loss of each kind: free run for hybrid and lstm (here), one step ahead for mlp and paper (one_step.py).

A learner draws its batches from (seed, step) alone, so that a training can be interrupted and resumed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.learn.drives.drive import Array
from tunefree_hil.learn.evaluation.motion import body_change
from tunefree_hil.learn.training.nets import CellNet, NetScaling
from tunefree_hil.learn.training.physics import BatchedSingleTrack
from tunefree_hil.learn.training.rollout import (
    FreeRunner,
    HybridRunner,
    KinematicRunner,
    PhysicsRunner,
    compute_errors,
    kinematic_features,
)
from tunefree_hil.learn.training.teacher_forcing import TeacherForcedRunner
from tunefree_hil.learn.training.windows import (
    ACCEL,
    START_SPACING_ROWS,
    YAW,
    TrackPool,
    WindowBatch,
    compute_draw_probabilities,
    draw_rows,
    find_window_starts,
    make_windows,
    spread_evenly,
)

WARM_UP_S = 1.0
BATCH_WINDOWS = 256
MASKED_INPUTS = (1,)  # yaw rate: the output of the cell would feed back through it and drift
HOLDOUT_LENGTHS_S = (10.0, 5.0, 3.0, 1.0)  # the longest that the held-out drives contain
HOLDOUT_SPACING_S = 0.5
MAX_HOLDOUT_WINDOWS, MAX_SCALING_WINDOWS = 256, 512
MIN_ERROR_UNITS = (0.02, 0.003, 0.002, 0.02)  # m/s, rad/s, rad, m: resolution of the sensors
ERROR_QUANTILE = 0.67  # of the physics' errors over the windows: the unit of an error
LOSS_WEIGHTS = (1.0, 0.5, 1.0, 2.0)  # of speed, yaw rate, heading and position
PEDAL_INPUTS = (2, 3)
PEDAL_SCALE_DIVISOR = 3.0  # finer than the spread, as a pedal acts early in its travel
MIN_INPUT_SPREAD = 1e-3  # a constant input is not amplified
FINAL_RATE_SHARE = 0.02  # of the learning rate, at the end of its cosine
QUADRATIC_LOSS_LIMIT = 0.1  # in error units; above, the loss grows linearly
MIN_FREE_RUN_S = 3.0  # shorter drives are refused; stages may be shorter than planned
TEACHER_FORCING_COST = 0.15  # of a tick of free run
TEACHER_FORCING_BATCH_SHARE = 0.25  # of a batch, since these windows are long
FREE_RUN_RATE_SHARE = 0.05  # of the initial rate, where free run follows teacher forcing
OUTPUT_QUANTILE = 0.995


class CurriculumStage(NamedTuple):
    """Windows of `ahead_s`, from `share` of the steps on."""

    share: float
    ahead_s: float
    is_teacher_forced: bool = False


class CurriculumSpan(NamedTuple):
    """A stage on the data at hand.

    Attributes:
        share: Of the steps, at which it begins.
        ahead: Ticks of free run.
        starts: Rows at which windows can begin.
        probabilities: Of each start to be drawn.
        batch: Windows a step.
        is_teacher_forced: Physics and cell receive the measured motion.
    """

    share: float
    ahead: int
    starts: Array
    probabilities: Array
    batch: int
    is_teacher_forced: bool


CURRICULA = {
    "hybrid": (CurriculumStage(0.0, 10.0, True), CurriculumStage(0.96, 5.0)),
    "lstm": (CurriculumStage(0.0, 1.0), CurriculumStage(0.2, 2.0), CurriculumStage(0.5, 3.0)),
}


class TrainingPlan(NamedTuple):
    """Settings of a training. The field names are keys of card.json.

    Attributes:
        kind: [plant] kind.
        seed: Of weights and batches.
        steps: Of the optimiser; 0: by `minutes` or the default.
        batch: Free-run windows a step.
        sample_spacing_s: Of kind paper.
        minutes: Processor time; 0: the default number of steps.
    """

    kind: str
    seed: int
    steps: int = 0
    batch: int = BATCH_WINDOWS
    sample_spacing_s: float = 0.01
    minutes: float = 0.0


class Learner(Protocol):
    """A net with its data."""

    steps: int  # of the training, at least one

    @property
    def net(self) -> nn.Module: ...

    def loss(self, step: int) -> Tensor: ...

    def score(self) -> float: ...

    def cost(self, step: int) -> float: ...

    def rate_share(self, step: int) -> float: ...

    def arrays(self) -> dict[str, Array]: ...


class FreeRunLearner:
    """Kinds hybrid and lstm: free run after a warm-up, over windows of growing length.

    The unit of an error is the typical error of the fitted physics after the same time, so that all times and
    quantities have equal weight.
    """

    def __init__(self, plan: TrainingPlan, training: TrackPool, held_out: TrackPool, model: ModelSpec) -> None:
        self.plan, self.training, self.held_out, self.steps = plan, training, held_out, max(plan.steps, 1)
        self.warm_up = round(WARM_UP_S / training.dt_s)
        starts = find_window_starts(training, self.warm_up, round(MIN_FREE_RUN_S / training.dt_s))
        require_rows(starts, training, "training")
        self.spans = [self._span(stage) for stage in CURRICULA[plan.kind]]
        self.held_out_starts, self.held_out_ahead = select_holdout_windows(held_out, self.warm_up)
        physics = BatchedSingleTrack(model.plant.params, training.dt_s, body_change(model))
        base = PhysicsRunner(physics, training)
        self.units = self._error_units(base)
        self.net: CellNet
        self.runner: FreeRunner
        self.held_out_runner: FreeRunner
        if plan.kind == "hybrid":
            self.net = self._make_hybrid_net(base)
            self.runner = HybridRunner(base, self.net)
            self.held_out_runner = HybridRunner(PhysicsRunner(physics, held_out), self.net)
        else:
            self.net = self._make_kinematic_net()
            self.runner = KinematicRunner(model.plant.params, self.net)
            self.held_out_runner = KinematicRunner(model.plant.params, self.net)
        is_forced = any(span.is_teacher_forced for span in self.spans)
        self.teacher_forced = TeacherForcedRunner(base, self.net) if is_forced else None

    def loss(self, step: int) -> Tensor:
        """Weighted errors of the batch of a step."""
        span = self._span_at(step)
        forced = self.teacher_forced
        runner = forced if span.is_teacher_forced and forced is not None else self.runner
        starts = draw_rows(span.starts, span.batch, self.plan.seed, step, span.probabilities)
        window = make_windows(starts, self.warm_up, span.ahead)
        errors = compute_errors(runner.run(self.training, window), self.training, window)
        limit = QUADRATIC_LOSS_LIMIT
        parts = [
            weight * (torch.sqrt(limit**2 + (error / unit[: span.ahead]) ** 2) - limit).mean()
            for weight, error, unit in zip(LOSS_WEIGHTS, errors, self.units, strict=True)
        ]
        return torch.stack(parts).sum() / sum(LOSS_WEIGHTS)

    def score(self) -> float:
        """Mean position error at the end of the held-out windows, m."""
        window = make_windows(self.held_out_starts, self.warm_up, self.held_out_ahead)
        with torch.no_grad():
            errors = compute_errors(self.held_out_runner.run(self.held_out, window), self.held_out, window)
        return float(errors.position_m[-1].mean())

    def cost(self, step: int) -> float:
        """Cost of a step, in ticks of free run."""
        span = self._span_at(step)
        batch_factor = 0.5 + 0.5 * span.batch / BATCH_WINDOWS  # half of a tick costs the same for every batch
        ticks = (self.warm_up + span.ahead) * batch_factor
        return ticks * (TEACHER_FORCING_COST if span.is_teacher_forced else 1.0)

    def rate_share(self, step: int) -> float:
        """Share of the initial rate: a cosine over teacher forcing, and one over free run."""
        forced = self._span_at(step).is_teacher_forced
        first = next(span.share for span in self.spans if span.is_teacher_forced == forced)
        last = next((span.share for span in self.spans if span.share > first and span.is_teacher_forced != forced), 1.0)
        share = (step / self.steps - first) / (last - first)
        initial = FREE_RUN_RATE_SHARE if self.teacher_forced is not None and not forced else 1.0
        return initial * cosine_rate(share)

    def arrays(self) -> dict[str, Array]:
        """The arrays of plant.npz."""
        return self.net.arrays()

    def _span(self, stage: CurriculumStage) -> CurriculumSpan:
        """The stage with its planned window length, or a shorter one where the drives are too short."""
        lengths_s = (stage.ahead_s, *(shorter for shorter in HOLDOUT_LENGTHS_S if shorter < stage.ahead_s))
        starts, ahead = _find_longest_windows(self.training, self.warm_up, lengths_s)
        batch = self.plan.batch
        if stage.is_teacher_forced:
            batch = max(round(batch * TEACHER_FORCING_BATCH_SHARE), 1)
        probabilities = compute_draw_probabilities(self.training, starts, self.warm_up, ahead)
        return CurriculumSpan(stage.share, ahead, starts, probabilities, batch, stage.is_teacher_forced)

    def _span_at(self, step: int) -> CurriculumSpan:
        share = step / self.steps
        return [span for span in self.spans if share >= span.share][-1]

    def _error_units(self, base: PhysicsRunner) -> list[Tensor]:
        """Unit of each error by time: a quantile of the physics' errors over the windows, shape (n_ticks, 1)."""
        longest = max(self.spans, key=lambda span: span.ahead)
        starts = spread_evenly(longest.starts, MAX_SCALING_WINDOWS)
        window = make_windows(starts, self.warm_up, longest.ahead)
        errors = compute_errors(base.run(self.training, window), self.training, window)
        return [
            torch.quantile(error.abs(), ERROR_QUANTILE, dim=1, keepdim=True).clamp(min=floor)
            for error, floor in zip(errors, MIN_ERROR_UNITS, strict=True)
        ]

    def _make_hybrid_net(self, base: PhysicsRunner) -> CellNet:
        """The cell of the residual, with its scaling and bounds."""
        window = self._scaling_windows()
        motion = self.training.motion[window.rows[1 : self.warm_up + 1]]  # after each tick
        features = base.features[window.rows[1 : self.warm_up + 1]].transpose(1, 2)
        residuals = (motion[..., ACCEL] - features[:, 5], motion[..., YAW] - features[:, 6])
        bound = [_output_bound(residuals[0], 2.0, 0.5, 4.0), _output_bound(residuals[1], 2.0, 0.03, 0.5)]
        scaling = compute_scaling(features, bound)
        scaling.scale[list(PEDAL_INPUTS)] /= PEDAL_SCALE_DIVISOR
        return CellNet(scaling, self.plan.seed, masked=MASKED_INPUTS)

    def _make_kinematic_net(self) -> CellNet:
        """The cell of kind lstm, with its scaling and bounds."""
        window = self._scaling_windows()
        motion = self.training.motion[window.rows[1 : self.warm_up + 1]]
        bound = [_output_bound(motion[..., ACCEL], 1.5, 3.0, 12.0), _output_bound(motion[..., YAW], 1.5, 0.3, 3.0)]
        scaling = compute_scaling(kinematic_features(self.training, window, self.warm_up + 1), bound)
        return CellNet(scaling, self.plan.seed, zero_outputs=False)

    def _scaling_windows(self) -> WindowBatch:
        starts = find_window_starts(self.training, self.warm_up, 1)
        return make_windows(spread_evenly(starts, MAX_SCALING_WINDOWS), self.warm_up, 1)


def cosine_rate(share: float) -> float:
    """From 1 at share 0 to FINAL_RATE_SHARE at share 1."""
    return FINAL_RATE_SHARE + (1.0 - FINAL_RATE_SHARE) * 0.5 * (1.0 + math.cos(math.pi * share))


def select_holdout_windows(pool: TrackPool, warm_up: int) -> tuple[Array, int]:
    """Starts and free ticks of the longest windows that the pool contains."""
    spacing_rows = round(HOLDOUT_SPACING_S / pool.dt_s)
    starts, ahead = _find_longest_windows(pool, warm_up, HOLDOUT_LENGTHS_S, spacing_rows)
    require_rows(starts, pool, "held-out")
    return spread_evenly(starts, MAX_HOLDOUT_WINDOWS), ahead


def _find_longest_windows(
    pool: TrackPool, warm_up: int, lengths_s: Sequence[float], spacing_rows: int = START_SPACING_ROWS
) -> tuple[Array, int]:
    """Starts and free ticks of the first of these lengths that the pool contains; no starts where it contains none."""
    starts, ahead = np.zeros(0, dtype=int), 0
    for seconds in lengths_s:
        ahead = round(seconds / pool.dt_s)
        starts = find_window_starts(pool, warm_up, ahead, spacing_rows)
        if len(starts):
            break
    return starts, ahead


def compute_scaling(features: Tensor, bound: Sequence[float]) -> NetScaling:
    """The scaling of a net with these features, shape (n_ticks, n_inputs, n_windows), and output bounds."""
    flat = features.transpose(1, 2).reshape(-1, features.shape[1])
    return NetScaling(flat.mean(0).numpy(), flat.std(0).clamp(min=MIN_INPUT_SPREAD).numpy(), bound)


def _output_bound(values: Tensor, factor: float, low: float, high: float) -> float:
    """A quantile of the absolute values times `factor`, within [low, high]."""
    greatest = float(np.quantile(values.abs().numpy(), OUTPUT_QUANTILE))
    return min(max(factor * greatest, low), high)


def require_rows(rows: Array, pool: TrackPool, which: str) -> None:
    """Raise InputError where there are no rows."""
    if len(rows) == 0:
        raise InputError(
            f"the {which} drives hold no stretch to learn from: {pool.seconds:.0f} s of them can be used, in pieces",
            code="too_short",
            key="LOG",
            hint=f"stretches of at least {WARM_UP_S + MIN_FREE_RUN_S:g} s in drive gear, moving, with by-wire control",
        )
