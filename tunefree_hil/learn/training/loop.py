"""The loop of a training: seeded, cut off and taken up again anywhere, stopped where the held-out error says so."""

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
from tunefree_hil.learn.training.learners import Learner, Wish

RATES = {"hybrid": 1e-2, "lstm": 1e-2, "mlp": 1e-2, "paper": 5e-3}  # of Adam at the beginning
LARGEST_GRADIENT = 1.0
LOOKS, LEAST_STEPS = 40, 5  # at the held-out error over the whole training, and steps between two of them
PATIENCE, CALM = 15, 0.5  # looks without a better one, at a pace below: above it a net only jumps about
AVERAGED = 0.02  # of the steps: the weights looked at and kept are the mean over about so many
LOST_TIMES, LOST_LOOKS = 5.0, 3  # so much worse than untrained, so often running: diverged
SHOWN_S, KEPT_S = 1.0, 15.0  # between two words, two checkpoints
THREADS = 1  # windows are narrow: more threads only wait for each other


class Step(NamedTuple):
    """How far a training is; score: the best held-out error so far."""

    done: int
    total: int
    loss: float
    score: float
    first: float
    eta_s: float


class Trained(NamedTuple):
    """The best net that was seen. score, first: its held-out error, and the untrained one's.

    steps: done, of `total`. stopped: '' or why.
    """

    arrays: dict[str, Array]
    score: float
    first: float
    steps: int
    total: int
    seconds: float
    looks: tuple[tuple[int, float], ...]
    stopped: str
    resumed: bool


class _State:
    """All that a checkpoint holds."""

    def __init__(self, total: int) -> None:
        self.step, self.total = 0, total
        self.best: dict[str, Tensor] = {}
        self.mean: dict[str, Tensor] = {}
        self.score = self.first = math.inf
        self.since = self.lost = 0
        self.seconds = 0.0
        self.looks: list[tuple[int, float]] = []


def train(
    learner: Learner, wish: Wish, total: int, part: Path | None = None, identity: str = ""
) -> Generator[Step, None, Trained]:
    """Train to the end, `total` steps, as which the learner is planned; a Step now and then.

    part: a checkpoint file; one of the same `identity` (data, settings) is taken up, another is written over before
    the first step, so that a training cut off at any time goes on with the same `total`. A loss that is not finite, or
    a held-out error far above the untrained net's, ends the training with the best net so far.
    """
    torch.set_num_threads(THREADS)
    optimiser = torch.optim.Adam(learner.net.parameters(), lr=RATES[wish.kind])
    state, stopped = _State(total), ""
    resumed = part is not None and _taken_up(part, identity, wish, learner, optimiser, state)
    if part is not None and not resumed:
        _keep(part, identity, wish, learner, optimiser, state)  # `total` may have come from a clock: once and for all
    if not state.looks:
        _look(learner, state)
    began, kept, shown = time.monotonic(), time.monotonic(), 0.0
    spent_before = state.seconds
    costs = [learner.cost(step) for step in range(total)]
    cost_before = sum(costs[: state.step])
    looks = looks_at(costs)
    while state.step < total and not stopped:
        loss, stopped = _one(learner, wish, optimiser, state.step)
        if stopped:
            break
        state.step += 1
        _average(learner, state)
        if state.step in looks:
            stopped = _look(learner, state, calm=learner.pace(state.step - 1) < CALM)
        now = time.monotonic()
        state.seconds = spent_before + now - began
        if part is not None and now - kept >= KEPT_S:
            _keep(part, identity, wish, learner, optimiser, state)
            kept = now
        if now - shown >= SHOWN_S:
            shown = now
            done = sum(costs[: state.step])
            eta_s = (now - began) * (sum(costs) - done) / max(done - cost_before, 1.0)
            yield Step(state.step, total, loss, state.score, state.first, eta_s)
    learner.net.load_state_dict(state.best)
    return Trained(
        learner.arrays(),
        state.score,
        state.first,
        state.step,
        total,
        state.seconds,
        tuple(state.looks),
        stopped,
        resumed,
    )


def planned_steps(part: Path | None, identity: str, wish: Wish) -> int:
    """How many steps the training of a checkpoint was to have; 0 where there is none of this data and wish."""
    if part is None or not part.is_file():
        return 0
    data = torch.load(part, weights_only=True)
    return int(data["total"]) if data["identity"] == identity and data["wish"] == list(wish) else 0


def looks_at(costs: Sequence[float]) -> set[int]:
    """Steps after which to look at the held-out error: evenly spread over the work, the last among them."""
    each, since, found = sum(costs) / LOOKS, 0.0, {len(costs)}
    for step, cost in enumerate(costs):
        since += cost
        if since >= each and step + 1 - max(found - {len(costs)}, default=0) >= LEAST_STEPS:
            found.add(step + 1)
            since = 0.0
    return found


def _one(learner: Learner, wish: Wish, optimiser: torch.optim.Adam, step: int) -> tuple[float, str]:
    """(loss, '' or why to stop) of one step."""
    for group in optimiser.param_groups:
        group["lr"] = RATES[wish.kind] * learner.pace(step)
    optimiser.zero_grad()
    loss = learner.loss(step)
    if not math.isfinite(loss.item()):
        return math.nan, "the loss is not a finite number any more"
    loss.backward()  # type: ignore[no-untyped-call]
    norm = torch.nn.utils.clip_grad_norm_(learner.net.parameters(), LARGEST_GRADIENT)
    if not math.isfinite(float(norm)):
        return math.nan, "the slope of the loss is not a finite number any more"
    optimiser.step()
    return loss.item(), ""


def _average(learner: Learner, state: _State) -> None:
    """Take a step's weights into their running mean: one step's by themselves jump about, and so would their choice."""
    for name, value in learner.net.named_parameters():
        if name in state.mean:
            state.mean[name].lerp_(value.detach(), 1.0 / max(min(state.step, AVERAGED * state.total), 1.0))
        else:
            state.mean[name] = value.detach().clone()


def _look(learner: Learner, state: _State, calm: bool = False) -> str:
    """Look at the held-out error; '' or why to stop."""
    own = {name: value.clone() for name, value in learner.net.state_dict().items()}
    learner.net.load_state_dict(own | state.mean)
    score = learner.score()
    state.looks.append((state.step, score))
    if not state.best:
        state.first = score
    if not state.best or score < state.score:
        state.score, state.since = score, 0
        state.best = {name: value.clone() for name, value in learner.net.state_dict().items()}
    else:
        state.since += calm
    learner.net.load_state_dict(own)
    state.lost = state.lost + 1 if not score < LOST_TIMES * state.first else 0
    if state.lost >= LOST_LOOKS:
        return f"it diverged: the held-out error is {score:.3g}, untrained it was {state.first:.3g}"
    return "the held-out error gets no better" if state.since >= PATIENCE else ""


def _keep(part: Path, identity: str, wish: Wish, learner: Learner, optimiser: torch.optim.Adam, state: _State) -> None:
    """Write the checkpoint, whole or not at all."""
    data: dict[str, Any] = {
        "identity": identity, "wish": list(wish), "net": learner.net.state_dict(), "optimiser": optimiser.state_dict(),
        **{name: value for name, value in vars(state).items() if name != "looks"},
        "looks": [list(look) for look in state.looks],
    }  # fmt: skip
    out = io.BytesIO()
    torch.save(data, out)
    beside = part.with_name(part.name + ".new")
    beside.write_bytes(out.getvalue())
    os.replace(beside, part)


def _taken_up(
    part: Path, identity: str, wish: Wish, learner: Learner, optimiser: torch.optim.Adam, state: _State
) -> bool:
    """Fill all from a checkpoint; False where there is none of this training."""
    if not part.is_file():
        return False
    data = torch.load(part, weights_only=True)
    if data.pop("identity") != identity or data.pop("wish") != list(wish) or data["total"] != state.total:
        return False
    learner.net.load_state_dict(data.pop("net"))
    optimiser.load_state_dict(data.pop("optimiser"))
    data["looks"] = [(int(step), float(score)) for step, score in data["looks"]]
    vars(state).update(data)
    return True
