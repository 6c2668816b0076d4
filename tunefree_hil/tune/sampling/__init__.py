"""Samplers: what suggests the next parameters of a search. `suggest_points` is the entrance, `RECORDS` the list."""

from tunefree_hil.tune.sampling.memory_study import CONSTRAINT
from tunefree_hil.tune.sampling.points import ScoredPoint, derive_slot_seed, sampler_value_from_score
from tunefree_hil.tune.sampling.records import AUTO, GP_UCB, KAPPA_W, RECORDS, SAMPLERS, TPE_CMA, check_sampler
from tunefree_hil.tune.sampling.suggestion import suggest_point, suggest_points

__all__ = [
    "AUTO",
    "CONSTRAINT",
    "GP_UCB",
    "KAPPA_W",
    "RECORDS",
    "SAMPLERS",
    "TPE_CMA",
    "ScoredPoint",
    "check_sampler",
    "derive_slot_seed",
    "sampler_value_from_score",
    "suggest_point",
    "suggest_points",
]
