"""From tracks to the arrays of a plant.npz: which learner for which kind, and how many steps a minute buys."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Generator, Sequence
from pathlib import Path

import torch

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.learn.motion import Track
from tunefree_hil.learn.training.learners import FreeRunLearner, Learner, Wish
from tunefree_hil.learn.training.loop import Step, Trained, train
from tunefree_hil.learn.training.one_step import OneStepLearner
from tunefree_hil.learn.training.windows import Pool, pool_of

STEPS_PER_MINUTE = {"hybrid": 130, "lstm": 230, "mlp": 6000, "paper": 700}  # on one quiet core of 2025
MINUTES = {"hybrid": 6.0, "lstm": 6.0, "mlp": 0.5, "paper": 2.0}


def steps_of(kind: str, minutes: float | None) -> int:
    """Steps of a training of about so many minutes: a number of its own, so that no clock decides what is learned."""
    return max(round((MINUTES[kind] if minutes is None else minutes) * STEPS_PER_MINUTE[kind]), 1)


def learner_of(wish: Wish, training: Pool, held_out: Pool, model: ModelSpec) -> Learner:
    """The learner of a kind."""
    if wish.kind in ("hybrid", "lstm"):
        return FreeRunLearner(wish, training, held_out, model)
    return OneStepLearner(wish, training, held_out)


def fit(
    wish: Wish, training: Sequence[Track], held_out: Sequence[Track], model: ModelSpec, rest: float, part: Path | None
) -> Generator[Step, None, Trained]:
    """Train a kind on tracks. model: the calibrated physics folder. part: the checkpoint, None for none.

    Raises InputError where there is nothing to learn from.
    """
    for tracks, what in ((training, "learn from"), (held_out, "judge by")):
        if not tracks:
            raise InputError(f"there is no stretch to {what}", code="too_short", key="LOG", hint="record longer drives")
    torch.manual_seed(wish.seed)
    pools = pool_of(training, model, rest), pool_of(held_out, model, rest)
    learner = learner_of(wish, *pools, model)
    trained = yield from train(learner, wish, part, identity_of(training, held_out, model))
    return trained


def identity_of(training: Sequence[Track], held_out: Sequence[Track], model: ModelSpec) -> str:
    """What a checkpoint belongs to: the rows learned from and judged by, and the physics."""
    rows = [[[track.log_hash, track.name, track.begin, track.rows] for track in some] for some in (training, held_out)]
    return hashlib.sha256(json.dumps([rows, model.hash, torch.__version__]).encode()).hexdigest()
