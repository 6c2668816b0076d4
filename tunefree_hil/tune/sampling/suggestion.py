"""The next points of a search, as a pure function of the finished trials, the study seed and the slots."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

from tunefree_hil.tune.sampling import cma, records
from tunefree_hil.tune.sampling.optuna_samplers import suggest_by_optuna
from tunefree_hil.tune.sampling.points import ScoredPoint
from tunefree_hil.tune.sampling.quasi_random import suggest_sobol_points
from tunefree_hil.tune.sampling.trust_region import suggest_local_points
from tunefree_hil.tune.space import Space


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
    kappa_w: float = records.KAPPA_W,
    given: int = 1,
) -> list[dict[str, float]]:
    """Suggest the parameters of slots that are tried at the same time.

    Args:
        space: Search space.
        history: Finished trials in slot order.
        sampler: One of SAMPLERS.
        seed: Seed of the study.
        slots: Numbers of the slots.
        pending: Sets of parameters in flight. A sampler that learns keeps away from them, and from the earlier ones of
            these slots.
        kappa_w: Weight of the uncertainty for `gp_ucb` (paper, eq. 8).
        given: Number of first trials that no sampler chose, such as manual sets; `trust_region` starts at the best.

    Returns:
        One set for each slot; it depends on the arguments alone.

    Raises:
        InputError: The sampler is unknown, is not installed, or cannot search the objectives of `history`.
    """
    records.check_sampler(sampler, max(1, len(history[0].objectives) if history else 1))
    if sampler == records.QMC:
        return suggest_sobol_points(space, seed=seed, slots=slots)
    if sampler == records.TRUST_REGION:
        local = suggest_local_points(space, history, given=given, count=len(slots), pending=pending)
        pending, slots, sampler = [*pending, *local], slots[len(local) :], records.TPE_INDEPENDENT
        if not slots:
            return local
        return local + suggest_by_optuna(space, history, sampler=sampler, seed=seed, slots=slots, pending=pending)
    if sampler == records.CMA:
        return cma.suggest_cma_points_from_start(space, history, seed=seed, count=len(slots), pending=pending)
    if sampler == records.TPE_CMA and len(history) >= cma.CRITERIA.start_trials:
        return cma.suggest_cma_points(space, history, seed=seed, count=len(slots), skip=len(pending))
    if records.BY_NAME[sampler].module != "botorch":
        return suggest_by_optuna(space, history, sampler=sampler, seed=seed, slots=slots, pending=pending)
    if len(history) < records.MODEL_CRITERIA.random_trials:
        return suggest_by_optuna(space, (), sampler=records.RANDOM, seed=seed, slots=slots)
    with warnings.catch_warnings():  # of a call in its imports that torch will remove
        warnings.simplefilter("ignore", DeprecationWarning)
        from tunefree_hil.tune.sampling.botorch_gp import suggest_by_botorch  # here, since it takes seconds

    weight = kappa_w if sampler == records.GP_UCB else None
    return suggest_by_botorch(space, history, kappa_w=weight, seed=seed, slots=slots, pending=pending)
