"""The training loop: seeded, resumable at any step, stopped by the held-out error."""

from __future__ import annotations

import io
import math
import os
import time
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from tunefree_hil.learn.drives.drive import Array
from tunefree_hil.learn.training.learners import Learner, TrainingPlan

LEARNING_RATES = {"hybrid": 1e-2, "lstm": 1e-2, "mlp": 1e-2, "paper": 5e-3}  # initial, of Adam
PROGRESS_INTERVAL_S, CHECKPOINT_INTERVAL_S = 1.0, 15.0
N_THREADS = 1  # batches are small: more threads only wait for each other


class LoopCriteria(NamedTuple):
    """How a training is evaluated and stopped (docs/results/criteria.md)."""

    max_gradient_norm: float = 1.0  # gradients are clipped to it
    max_evaluations: int = 40  # of the held-out error over a training
    min_steps_between: int = 5  # steps between two evaluations
    patience: int = 15  # evaluations without a better one, below max_patience_rate, that end the training
    max_patience_rate: float = 0.5  # share of the initial learning rate; above it the error still scatters
    # of all steps, over which the evaluated weights are the mean: those of single steps scatter
    averaging_share: float = 0.02
    divergence_ratio: float = 5.0  # held-out error over the untrained one, that counts as divergence
    max_diverged: int = 3  # consecutive diverged evaluations that end the training


CRITERIA = LoopCriteria()


class TrainingProgress(NamedTuple):
    """Progress of a training. score: best held-out error; untrained_score: before training."""

    done: int
    total: int
    loss: float
    score: float
    untrained_score: float
    eta_s: float


class TrainingResult(NamedTuple):
    """The best net of a training.

    Attributes:
        arrays: Of plant.npz.
        score: Its held-out error.
        untrained_score: Held-out error before training.
        steps: Done.
        total: Planned.
        seconds: Duration.
        evaluations: (step, held-out error) pairs.
        stopped: Why it ended early, or ''.
        is_resumed: It continued from a checkpoint.
    """

    arrays: dict[str, Array]
    score: float
    untrained_score: float
    steps: int
    total: int
    seconds: float
    evaluations: tuple[tuple[int, float], ...]
    stopped: str
    is_resumed: bool


class TrainingState:
    """Content of a checkpoint; the attribute names are its keys.

    Attributes:
        step: Steps done.
        total: Steps planned.
        best: Weights with the best held-out error.
        mean: Running mean of the weights.
        score: Best held-out error.
        first: Held-out error before training.
        since: Evaluations without a better one.
        lost: Consecutive diverged evaluations.
        seconds: Duration.
        looks: (step, held-out error) pairs.
    """

    def __init__(self, total: int) -> None:
        self.step, self.total = 0, total
        self.best: dict[str, Tensor] = {}
        self.mean: dict[str, Tensor] = {}
        self.score = self.first = math.inf
        self.since = self.lost = 0
        self.seconds = 0.0
        self.looks: list[tuple[int, float]] = []


class _Training(NamedTuple):
    """A training and where it is stored. checkpoint: None for none; identity: of data and settings."""

    learner: Learner
    plan: TrainingPlan
    optimiser: torch.optim.Adam
    state: TrainingState
    checkpoint: Path | None
    identity: str


def run_training(
    learner: Learner, plan: TrainingPlan, total: int, part: Path | None = None, identity: str = ""
) -> Generator[TrainingProgress, None, TrainingResult]:
    """Train for `total` steps, as set in the learner; yields progress about once a second.

    A loss that is not finite, or a held-out error far above the untrained one, ends the training with the best net.

    Args:
        learner: Net and data.
        plan: Settings.
        total: Steps.
        part: Checkpoint file. One of the same identity is resumed; another is overwritten before the first step, so
            that a training can be interrupted at any time and go on with the same total.
        identity: Of data and settings.
    """
    torch.set_num_threads(N_THREADS)
    optimiser = torch.optim.Adam(learner.net.parameters(), lr=LEARNING_RATES[plan.kind])
    state = TrainingState(total)
    training = _Training(learner, plan, optimiser, state, part, identity)
    is_resumed = _read_checkpoint(training)
    if not is_resumed:
        _write_checkpoint(training)  # `total` may come from a timing, which would differ next time
    if not state.looks:
        _evaluate(learner, state)
    stopped = yield from _run_steps(training)
    learner.net.load_state_dict(state.best)
    return TrainingResult(
        arrays=learner.arrays(),
        score=state.score,
        untrained_score=state.first,
        steps=state.step,
        total=total,
        seconds=state.seconds,
        evaluations=tuple(state.looks),
        stopped=stopped,
        is_resumed=is_resumed,
    )


def _run_steps(training: _Training) -> Generator[TrainingProgress, None, str]:
    """Run the steps that are left; returns '' or why the training stopped."""
    learner, state = training.learner, training.state
    began = saved = time.monotonic()
    reported, seconds_before = 0.0, state.seconds
    costs = [learner.cost(step) for step in range(state.total)]
    cost_before = sum(costs[: state.step])
    evaluation_steps = schedule_evaluations(costs)
    while state.step < state.total:
        loss, stopped = _run_step(training)
        if stopped:
            return stopped
        state.step += 1
        _average_weights(learner, state)
        if state.step in evaluation_steps:
            is_patient = learner.rate_share(state.step - 1) < CRITERIA.max_patience_rate
            stopped = _evaluate(learner, state, is_patient=is_patient)
        now = time.monotonic()
        state.seconds = seconds_before + now - began
        if now - saved >= CHECKPOINT_INTERVAL_S:
            _write_checkpoint(training)
            saved = now
        if now - reported >= PROGRESS_INTERVAL_S:
            reported = now
            done = sum(costs[: state.step])
            eta_s = (now - began) * (sum(costs) - done) / max(done - cost_before, 1.0)
            yield TrainingProgress(state.step, state.total, loss, state.score, state.first, eta_s)
        if stopped:
            return stopped
    return ""


def read_planned_steps(part: Path | None, identity: str, plan: TrainingPlan) -> int:
    """Planned steps of a checkpoint; 0 where there is none of this data and plan."""
    data = _load_checkpoint(part, identity, plan)
    return int(data["total"]) if data else 0


def schedule_evaluations(costs: Sequence[float]) -> set[int]:
    """Steps after which the held-out error is evaluated: evenly spread over the cost, the last among them."""
    spacing, since, steps = sum(costs) / CRITERIA.max_evaluations, 0.0, {len(costs)}
    for step, cost in enumerate(costs):
        since += cost
        if since >= spacing and step + 1 - max(steps - {len(costs)}, default=0) >= CRITERIA.min_steps_between:
            steps.add(step + 1)
            since = 0.0
    return steps


def _run_step(training: _Training) -> tuple[float, str]:
    """Loss of one step, and '' or why to stop."""
    learner, plan, optimiser, step = training.learner, training.plan, training.optimiser, training.state.step
    for group in optimiser.param_groups:
        group["lr"] = LEARNING_RATES[plan.kind] * learner.rate_share(step)
    optimiser.zero_grad()
    loss = learner.loss(step)
    if not math.isfinite(loss.item()):
        return math.nan, "the loss is not a finite number any more"
    loss.backward()  # type: ignore[no-untyped-call]
    norm = torch.nn.utils.clip_grad_norm_(learner.net.parameters(), CRITERIA.max_gradient_norm)
    if not math.isfinite(float(norm)):
        return math.nan, "the gradient of the loss is not a finite number any more"
    optimiser.step()
    return loss.item(), ""


def _average_weights(learner: Learner, state: TrainingState) -> None:
    """Update the running mean of the weights, which scatters less than the weights of single steps."""
    for name, value in learner.net.named_parameters():
        if name in state.mean:
            rate = 1.0 / max(min(state.step, CRITERIA.averaging_share * state.total), 1.0)
            state.mean[name].lerp_(value.detach(), rate)
        else:
            state.mean[name] = value.detach().clone()


def _evaluate(learner: Learner, state: TrainingState, is_patient: bool = False) -> str:
    """Evaluate the held-out error of the mean weights; returns '' or why to stop."""
    current = {name: value.clone() for name, value in learner.net.state_dict().items()}
    learner.net.load_state_dict(current | state.mean)
    score = learner.score()
    state.looks.append((state.step, score))
    if not state.best:
        state.first = score
    if not state.best or score < state.score:
        state.score, state.since = score, 0
        state.best = {name: value.clone() for name, value in learner.net.state_dict().items()}
    else:
        state.since += is_patient
    learner.net.load_state_dict(current)
    state.lost = state.lost + 1 if not score < CRITERIA.divergence_ratio * state.first else 0
    if state.lost >= CRITERIA.max_diverged:
        return f"it diverged: the held-out error is {score:.3g}, untrained it was {state.first:.3g}"
    return "the held-out error gets no better" if state.since >= CRITERIA.patience else ""


def _write_checkpoint(training: _Training) -> None:
    """Write the checkpoint atomically."""
    path, state = training.checkpoint, training.state
    if path is None:
        return
    data: dict[str, Any] = {
        "identity": training.identity,
        "wish": list(training.plan),
        "net": training.learner.net.state_dict(),
        "optimiser": training.optimiser.state_dict(),
        **{name: value for name, value in vars(state).items() if name != "looks"},
        "looks": [list(look) for look in state.looks],
    }
    buffer = io.BytesIO()
    torch.save(data, buffer)
    new = path.with_name(path.name + ".new")
    new.write_bytes(buffer.getvalue())
    os.replace(new, path)


def _read_checkpoint(training: _Training) -> bool:
    """Restore net, optimiser and state; False where there is no checkpoint of this training."""
    data, state = _load_checkpoint(training.checkpoint, training.identity, training.plan), training.state
    if not data or data["total"] != state.total:
        return False
    training.learner.net.load_state_dict(data.pop("net"))
    training.optimiser.load_state_dict(data.pop("optimiser"))
    data["looks"] = [(int(step), float(score)) for step, score in data["looks"]]
    vars(state).update(data)
    return True


def _load_checkpoint(path: Path | None, identity: str, plan: TrainingPlan) -> dict[str, Any]:
    """The content of a checkpoint without its identity; empty where there is none of this data and plan."""
    if path is None or not path.is_file():
        return {}
    data = torch.load(path, weights_only=True)
    is_same = [data.pop("identity"), data.pop("wish")] == [identity, list(plan)]
    return data if is_same else {}
