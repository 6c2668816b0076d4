"""The next point of a search, as a pure function of (what was learned so far, study seed, slot) (design D13).

The sampler never sees the study file. It gets a study in memory, rebuilt from the finished slots in slot order, because
what Optuna keeps is shaped by accidents: a kill leaves a RUNNING and then a FAIL trial behind, every trial after it
gets a higher number, TPE orders its kernels (and so their weights, and ties between equal scores) by that number, and
RUNNING trials repel it. In the rebuilt study the trial of slot n has number n, and none has any other
state but those that are to be tried at the same time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import optuna
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.trial import create_trial

from tunefree_hil.base.errors import InputError
from tunefree_hil.tune.space import Space

# Optuna would say "A new study created" once for every suggestion.
optuna.logging.set_verbosity(optuna.logging.WARNING)

SAMPLERS = ("tpe_independent", "tpe_relative", "random")
SMALLEST_SCORE = 1e-6  # a score of 0 (no error at all) has no logarithm


class Told(NamedTuple):
    """A finished trial, as far as a sampler may know it."""

    parameters: dict[str, float]
    score: float


def learned_value(score: float) -> float:
    """What the sampler is told instead of a score: its logarithm (D11). TPE, which looks at ranks, does not mind."""
    return math.log(max(score, SMALLEST_SCORE))


def slot_seed(seed: int, slot: int) -> int:
    """A 32-bit seed for the sampler of one slot; slots and neighbouring study seeds are unrelated."""
    return int(np.random.SeedSequence([seed, slot]).generate_state(1)[0])


def suggest(space: Space, history: Sequence[Told], *, sampler: str, seed: int, slot: int) -> dict[str, float]:
    """The parameters to try in `slot`: binary32 values inside the box, by name, in the space's order.

    `history`: the finished slots in slot order. Raises InputError for an unknown sampler.
    """
    return suggest_some(space, history, sampler=sampler, seed=seed, slots=[slot])[0]


def suggest_some(
    space: Space,
    history: Sequence[Told],
    *,
    sampler: str,
    seed: int,
    slots: Sequence[int],
    pending: Sequence[Mapping[str, float]] = (),
) -> list[dict[str, float]]:
    """One set of parameters for each of `slots`, which are to be tried at the same time.

    `pending`: sets that are in flight already. A sampler that learns keeps away from them, and from the earlier ones of
    these slots (Optuna's constant liar), so the answer depends on the arguments alone.
    """
    memory = optuna.create_study(direction="minimize", sampler=_make_sampler(sampler, slot_seed(seed, slots[0])))
    distributions = {axis.name: axis.sampled() for axis in space.axes}
    if sampler != "random":
        memory.add_trials(
            create_trial(
                params={axis.name: axis.to_sampler(told.parameters[axis.name]) for axis in space.axes},
                distributions=distributions,
                value=learned_value(told.score),
            )
            for told in history
        )
        for point in pending:
            memory.enqueue_trial({axis.name: axis.to_sampler(point[axis.name]) for axis in space.axes})
            memory.ask(distributions)
    found: list[dict[str, float]] = []
    for slot in slots:
        memory.sampler = _make_sampler(sampler, slot_seed(seed, slot), in_flight=bool(pending or found))
        drawn = memory.ask(distributions).params
        found.append({axis.name: axis.from_sampler(drawn[axis.name]) for axis in space.axes})
    return found


def _make_sampler(name: str, seed: int, *, in_flight: bool = False) -> BaseSampler:
    """A fresh sampler. Only arguments that Optuna 5 neither deprecates nor calls experimental (opt_anchors A)."""
    if name == "random":
        return RandomSampler(seed=seed)
    if name in SAMPLERS:
        # Paper, Table III and III-B.2: independent or relative sampling; the liar where others are in flight.
        return TPESampler(seed=seed, multivariate=name == "tpe_relative", constant_liar=in_flight)
    raise InputError(
        f"no sampler {name!r}", code="unknown_sampler", key="tune.sampler", hint=f"use one of {', '.join(SAMPLERS)}"
    )
