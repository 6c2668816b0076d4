"""From tracks to the arrays of a plant.npz: which learner for which kind, and for how many steps."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Generator, Sequence
from pathlib import Path

import torch

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.learn.evaluation.motion import Track
from tunefree_hil.learn.training.learners import FreeRunLearner, Learner, Wish
from tunefree_hil.learn.training.loop import THREADS, Step, Trained, planned_steps, train
from tunefree_hil.learn.training.one_step import OneStepLearner
from tunefree_hil.learn.training.windows import Pool, pool_of, with_mirrored

STEPS = {"hybrid": 3500, "lstm": 1400, "mlp": 3000, "paper": 1400}  # where nobody says for how long
MIRRORED = ("hybrid", "lstm")
PROBED = (0.0, 0.999)  # shares of a training whose steps are timed: its cheapest and its dearest
PROBE_STEPS = 1000


def steps_for(learner: Learner, minutes: float) -> int:
    """How many steps so many minutes of a core's own time buy, by the learner's steps at both ends of its training.

    Processor time is taken, so that a busy machine trains longer and not less. No weight is changed.
    """
    learner.plan(PROBE_STEPS)
    spent = work = 0.0
    for share in PROBED:
        step = round(share * PROBE_STEPS)
        learner.loss(step)  # what is made once is made now
        began = time.process_time()
        learner.loss(step).backward()  # type: ignore[no-untyped-call]
        spent += time.process_time() - began
        work += learner.cost(step)
    learner.net.zero_grad()
    mean = sum(learner.cost(step) for step in range(PROBE_STEPS)) / PROBE_STEPS
    return max(round(60.0 * minutes * work / max(spent, 1e-6) / mean), 1)


def learner_of(wish: Wish, training: Pool, held_out: Pool, model: ModelSpec) -> Learner:
    """The learner of a kind."""
    if wish.kind in MIRRORED:
        return FreeRunLearner(wish, with_mirrored(training), held_out, model)
    return OneStepLearner(wish, training, held_out)


def fit(
    wish: Wish, training: Sequence[Track], held_out: Sequence[Track], model: ModelSpec, rest: float, part: Path | None
) -> Generator[Step, None, Trained]:
    """Train a kind on tracks. model: the calibrated physics folder. part: the checkpoint, None for none.

    How many steps: those of the wish; else as many as its minutes buy on this machine, which a checkpoint remembers;
    else STEPS. Raises InputError where there is nothing to learn from.
    """
    for tracks, what in ((training, "learn from"), (held_out, "judge by")):
        if not tracks:
            raise InputError(f"there is no stretch to {what}", code="too_short", key="LOG", hint="record longer drives")
    torch.set_num_threads(THREADS)
    torch.manual_seed(wish.seed)
    pools = pool_of(training, model, rest), pool_of(held_out, model, rest)
    learner = learner_of(wish, *pools, model)
    identity = identity_of(training, held_out, model)
    steps = wish.steps or planned_steps(part, identity, wish)
    if not steps:
        steps = steps_for(learner, wish.minutes) if wish.minutes else STEPS[wish.kind]
    learner.plan(steps)
    trained = yield from train(learner, wish, steps, part, identity)
    return trained


def identity_of(training: Sequence[Track], held_out: Sequence[Track], model: ModelSpec) -> str:
    """What a checkpoint belongs to: the rows learned from and judged by, and the physics."""
    rows = [[[track.log_hash, track.name, track.begin, track.rows] for track in some] for some in (training, held_out)]
    return hashlib.sha256(json.dumps([rows, model.hash, torch.__version__]).encode()).hexdigest()
