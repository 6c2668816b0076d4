"""Suggestions of Optuna's samplers: TPE, Gaussian process with expected improvement, NSGA-II, and random search."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from optuna.distributions import BaseDistribution
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import BaseSampler, GPSampler, NSGAIISampler, RandomSampler
from optuna.samplers.nsgaii import SBXCrossover
from optuna.study import Study
from optuna.trial import FrozenTrial

from tunefree_hil.tune.sampling.memory_study import StudyKind, StudyMemory
from tunefree_hil.tune.sampling.points import ScoredPoint, derive_slot_seed
from tunefree_hil.tune.sampling.records import GP_EI, NSGA, RANDOM, TPE_RELATIVE
from tunefree_hil.tune.sampling.tpe import make_tpe_sampler
from tunefree_hil.tune.space import Space

MEMORY = StudyMemory()


class NsgaCriteria(NamedTuple):
    """The generations of NSGA-II."""

    # trials of a generation. Hypervolume of two bowls in 8 parameters after 160 and 400 trials: 2.75 and 3.47 with 16;
    # 2.08 and 2.96 with 32; 1.47 and 2.81 with 50, Optuna's default; random search 1.69 and 1.75 (median of 5 seeds).
    # The 100 of Deb et al. (2002, doi:10.1109/4235.996017) are for searches of thousands of trials
    population: int = 16


NSGA_CRITERIA = NsgaCriteria()


def suggest_by_optuna(
    space: Space,
    history: Sequence[ScoredPoint],
    *,
    sampler: str,
    seed: int,
    slots: Sequence[int],
    pending: Sequence[Mapping[str, float]] = (),
) -> list[dict[str, float]]:
    """Suggest the parameters of slots that are tried at the same time; the arguments are those of `suggest_points`."""
    if sampler == RANDOM:
        history, pending = (), ()
    kind = StudyKind(space, max(1, len(history[0].objectives) if history else 1), replayed=sampler == NSGA)
    genetic = _make_nsga_sampler(0) if sampler == NSGA else None  # chance has no part in generations
    with MEMORY.open(kind, history, genetic) as study:
        for parameters in pending:
            study.begin(parameters)
        suggested: list[dict[str, float]] = []
        slot_sampler: BaseSampler = RandomSampler(seed=0)
        for slot in slots:
            if not suggested or sampler != GP_EI:  # this one begins its next fit with the last, in half the time
                slot_seed, is_waiting = derive_slot_seed(seed, slot), bool(pending or suggested)
                slot_sampler = _make_sampler(sampler, slot_seed, study.distributions, in_flight=is_waiting)
            suggested.append(study.ask(slot_sampler))
    return suggested


def _make_sampler(
    name: str, seed: int, distributions: Mapping[str, BaseDistribution], *, in_flight: bool
) -> BaseSampler:
    """A new sampler; that of `gp_ei` for all slots of a call, else for one of them."""
    if name == RANDOM:
        return RandomSampler(seed=seed)
    if name == NSGA:
        return _make_nsga_sampler(seed)
    if name == GP_EI:  # models the trials in flight by itself
        return GPSampler(seed=seed, warn_independent_sampling=False)
    return make_tpe_sampler(seed, distributions, relative=name == TPE_RELATIVE, in_flight=in_flight)


class OrderedNsga(NSGAIISampler):
    """NSGA-II whose parents come in the order of their trials.

    Optuna's sampler has them by rank where it selects them, and by trial where it remembers them, so that a suggestion
    would depend on the ones before it.
    """

    def get_parent_population(self, study: Study, generation: int) -> list[FrozenTrial]:
        """The parents of a generation, by the number of their trial."""
        return sorted(super().get_parent_population(study, generation), key=lambda trial: trial.number)


def _make_nsga_sampler(seed: int) -> NSGAIISampler:
    """NSGA-II with simulated binary crossover, as its authors use it: it makes new values between and near parents'."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        crossover = SBXCrossover()
    return OrderedNsga(population_size=NSGA_CRITERIA.population, crossover=crossover, seed=seed)
