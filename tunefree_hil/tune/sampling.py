"""The next point of a search, as a pure function of the finished trials, the study seed and the slot.

The sampler does not get the study file, because its content depends on kills. A kill leaves a RUNNING, later a FAIL
trial, so all later trials have a higher number. TPE orders its kernels by that number (which affects their weights, and
ties between equal scores) and keeps away from RUNNING trials. So the sampler gets a study in memory, rebuilt from the
finished slots in slot order: the trial of slot n has number n, and only trials in flight are unfinished.
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
from tunefree_hil.tune.cma import CRITERIA, suggest_cma_points
from tunefree_hil.tune.space import Space

# Otherwise Optuna prints "A new study created" for every suggestion.
optuna.logging.set_verbosity(optuna.logging.WARNING)

TPE_CMA = "tpe_cma"  # TPE first, then CMA-ES (cma.py)
SAMPLERS = ("tpe_independent", "tpe_relative", TPE_CMA, "random")
CONSTRAINT = "requirements"  # name of the only constraint
SMALLEST_SCORE = 1e-6  # a score of 0 (no error at all) has no logarithm


class ScoredPoint(NamedTuple):
    """Parameters and score of a finished trial, which a sampler learns from.

    violation: Of the requirements, 0 where they are met; None in a study without requirements.
    """

    parameters: dict[str, float]
    score: float
    violation: float | None = None


def sampler_value_from_score(score: float) -> float:
    """The logarithm of a score, which the sampler gets as value. TPE uses ranks only, so it is not affected."""
    return math.log(max(score, SMALLEST_SCORE))


def derive_slot_seed(seed: int, slot: int) -> int:
    """A 32-bit seed for the sampler of one slot, independent of other slots and of neighbouring study seeds."""
    return int(np.random.SeedSequence([seed, slot]).generate_state(1)[0])


def suggest_point(
    space: Space, history: Sequence[ScoredPoint], *, sampler: str, seed: int, slot: int
) -> dict[str, float]:
    """Suggest the parameters of one slot.

    Args:
        space: Search space.
        history: Finished trials in slot order.
        sampler: One of SAMPLERS; another name raises InputError.
        seed: Seed of the study.
        slot: Number of the slot.

    Returns:
        binary32 values inside the space, by name, in its order.
    """
    return suggest_points(space, history, sampler=sampler, seed=seed, slots=[slot])[0]


def suggest_points(
    space: Space,
    history: Sequence[ScoredPoint],
    *,
    sampler: str,
    seed: int,
    slots: Sequence[int],
    pending: Sequence[Mapping[str, float]] = (),
) -> list[dict[str, float]]:
    """Suggest the parameters of slots that are tried at the same time.

    Args:
        pending: Sets of parameters in flight. A sampler that learns keeps away from them, and from the earlier ones of
            these slots (Optuna's constant liar).

    Returns:
        One set for each slot; it depends on the arguments alone.
    """
    if sampler == TPE_CMA and len(history) >= CRITERIA.start_trials:
        return suggest_cma_points(space, history, seed=seed, count=len(slots))
    memory = optuna.create_study(direction="minimize", sampler=_make_sampler(sampler, derive_slot_seed(seed, slots[0])))
    distributions = {axis.name: axis.sampler_distribution() for axis in space.axes}
    if sampler != "random":
        memory.add_trials(
            create_trial(
                params={axis.name: axis.to_sampler(point.parameters[axis.name]) for axis in space.axes},
                distributions=distributions,
                value=sampler_value_from_score(point.score),
                # TPE ranks trials without a violation first, by score, then the others by their violation.
                constraints=None if point.violation is None else {CONSTRAINT: point.violation},
            )
            for point in history
        )
        for point in pending:
            memory.enqueue_trial({axis.name: axis.to_sampler(point[axis.name]) for axis in space.axes})
            memory.ask(distributions)
    suggested: list[dict[str, float]] = []
    for slot in slots:
        memory.sampler = _make_sampler(sampler, derive_slot_seed(seed, slot), in_flight=bool(pending or suggested))
        sampler_values = memory.ask(distributions).params
        suggested.append({axis.name: axis.from_sampler(sampler_values[axis.name]) for axis in space.axes})
    return suggested


def _make_sampler(name: str, seed: int, *, in_flight: bool = False) -> BaseSampler:
    """A new sampler, with arguments that Optuna 5 neither deprecates nor calls experimental."""
    if name == "random":
        return RandomSampler(seed=seed)
    if name in SAMPLERS:
        # Paper, Table III and III-B.2: independent or relative sampling; constant liar with trials in flight.
        return TPESampler(seed=seed, multivariate=name == "tpe_relative", constant_liar=in_flight)
    raise InputError(
        f"no sampler {name!r}", code="unknown_sampler", key="tune.sampler", hint=f"use one of {', '.join(SAMPLERS)}"
    )
