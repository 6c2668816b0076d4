"""Trains a plant kind on tracks: chooses the learner and the number of steps."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import NamedTuple

import torch

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.learn.evaluation.motion import MotionTrack
from tunefree_hil.learn.training.learners import FreeRunLearner, Learner, TrainingPlan
from tunefree_hil.learn.training.loop import (
    N_THREADS,
    TrainingProgress,
    TrainingResult,
    read_planned_steps,
    run_training,
)
from tunefree_hil.learn.training.one_step import OneStepLearner
from tunefree_hil.learn.training.windows import TrackPool, add_mirrored, make_pool

DEFAULT_STEPS = {"hybrid": 3500, "lstm": 1400, "mlp": 3000, "paper": 1400}
MIRRORED_KINDS = ("hybrid", "lstm")
PROBED_SHARES = (0.0, 0.999)  # of a training, at which a step is timed: the cheapest and the most expensive
PROBE_STEPS = 1000


class TrackSplit(NamedTuple):
    """Tracks to train on, and held-out tracks, which stop the training."""

    training: Sequence[MotionTrack]
    held_out: Sequence[MotionTrack]


def estimate_affordable_steps(learner: Learner, minutes: float) -> int:
    """Steps that take so many minutes of processor time; no weight is changed.

    Processor time is measured, so that a busy machine trains longer and not less.
    """
    learner.steps = PROBE_STEPS
    seconds = work = 0.0
    for share in PROBED_SHARES:
        step = round(share * PROBE_STEPS)
        learner.loss(step)  # initialises what is computed once
        began = time.process_time()
        learner.loss(step).backward()  # type: ignore[no-untyped-call]
        seconds += time.process_time() - began
        work += learner.cost(step)
    learner.net.zero_grad()
    mean = sum(learner.cost(step) for step in range(PROBE_STEPS)) / PROBE_STEPS
    return max(round(60.0 * minutes * work / max(seconds, 1e-6) / mean), 1)


def make_learner(plan: TrainingPlan, training: TrackPool, held_out: TrackPool, model: ModelSpec) -> Learner:
    """The learner of a kind."""
    if plan.kind in MIRRORED_KINDS:
        return FreeRunLearner(plan, add_mirrored(training), held_out, model)
    return OneStepLearner(plan, training, held_out)


def train_plant(
    plan: TrainingPlan, tracks: TrackSplit, model: ModelSpec, rest: float, part: Path | None
) -> Generator[TrainingProgress, None, TrainingResult]:
    """Train a kind on tracks.

    The number of steps is that of the plan; else that of its minutes on this machine, which a checkpoint stores; else
    DEFAULT_STEPS.

    Args:
        plan: Settings.
        tracks: Training and held-out tracks.
        model: The calibrated physics.
        rest: Duty of a released pedal.
        part: Checkpoint file, None for none.

    Raises:
        InputError: There is no track, or no usable stretch.
    """
    for subset, purpose in zip(tracks, ("learn from", "evaluate on"), strict=True):
        if not subset:
            raise InputError(
                f"there is no stretch to {purpose}", code="too_short", key="LOG", hint="record longer drives"
            )
    torch.set_num_threads(N_THREADS)
    torch.manual_seed(plan.seed)
    training, held_out = (make_pool(subset, model, rest) for subset in tracks)
    learner = make_learner(plan, training, held_out, model)
    identity = hash_training_data(tracks, model)
    steps = plan.steps or read_planned_steps(part, identity, plan)
    if not steps:
        steps = estimate_affordable_steps(learner, plan.minutes) if plan.minutes else DEFAULT_STEPS[plan.kind]
    learner.steps = steps
    return (yield from run_training(learner, plan, steps, part, identity))


def hash_training_data(tracks: TrackSplit, model: ModelSpec) -> str:
    """Identity of a checkpoint: the rows of both sets, the physics and the version of torch."""
    rows = [[[track.log_hash, track.name, track.begin, track.n_rows] for track in subset] for subset in tracks]
    return hashlib.sha256(json.dumps([rows, model.hash, torch.__version__]).encode()).hexdigest()
