"""Optuna's TPE (Bergstra 2011; Watanabe 2023, arXiv:2304.11127), with less work for the same suggestion.

For each parameter that it draws alone, Optuna's sampler divides all trials anew into good and bad ones. The division is
the same for all parameters of a trial, so here it is made once. This overrides methods that Optuna does not declare
stable: with an Optuna version that was not tested the plain sampler is used, which gives the same suggestions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution
from optuna.samplers import TPESampler
from optuna.study import Study
from optuna.trial import FrozenTrial

from tunefree_hil.tune.sampling.memory_study import list_searched

TESTED_OPTUNA = "5.0."  # tests/tune/sampling/test_tpe.py compares the suggestions with those of Optuna's sampler


def make_tpe_sampler(
    seed: int, distributions: Mapping[str, BaseDistribution], *, relative: bool, in_flight: bool
) -> TPESampler:
    """Make the sampler of one suggestion.

    Args:
        seed: Seed of the suggestion.
        distributions: Of all parameters.
        relative: Draw the parameters together (paper, Table III).
        in_flight: Trials are in flight: count them as bad ones (constant liar).
    """
    if optuna.__version__.startswith(TESTED_OPTUNA):
        return SingleSplitTpe(seed, distributions, relative=relative, in_flight=in_flight)
    return TPESampler(seed=seed, multivariate=relative, constant_liar=in_flight)


class SingleSplitTpe(TPESampler):
    """Optuna's TPE for one suggestion in a study whose trials all have the same parameters."""

    def __init__(
        self, seed: int, distributions: Mapping[str, BaseDistribution], *, relative: bool, in_flight: bool
    ) -> None:
        # Arguments that Optuna 5 neither deprecates nor calls experimental.
        super().__init__(seed=seed, multivariate=relative, constant_liar=in_flight)
        self._searched = list_searched(distributions) if relative else {}
        self._halves: dict[bool, Sequence[FrozenTrial]] = {}  # of the trials: whether they are the good ones

    def infer_relative_search_space(self, study: Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """All parameters, without a look at the trials."""
        return dict(self._searched)

    def _sample(self, study: Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]) -> dict[str, Any]:
        if not self._halves:
            return super()._sample(study, trial, search_space)
        good = self._build_parzen_estimator(study, search_space, list(self._halves[True]), True)
        bad = self._build_parzen_estimator(study, search_space, list(self._halves[False]), False)
        drawn = good.sample(self._rng.rng, self._n_ei_candidates)
        best = self._compare(drawn, self._compute_acquisition_func(drawn, good, bad))
        return {name: distribution.to_external_repr(best[name]) for name, distribution in search_space.items()}

    def _build_parzen_estimator(
        self, study: Study, search_space: dict[str, BaseDistribution], trials: list[FrozenTrial], handle_below: bool
    ) -> Any:
        if handle_below not in self._halves:
            self._halves[handle_below] = trials
        return super()._build_parzen_estimator(study, search_space, trials, handle_below)

    def _get_internal_repr(
        self, trials: list[FrozenTrial], search_space: dict[str, BaseDistribution], study: Study
    ) -> dict[str, np.ndarray]:
        """Every trial has every parameter: those in flight too, which were begun with all of them."""
        parameters = [trial.params for trial in trials]
        return {
            name: np.asarray([distribution.to_internal_repr(values[name]) for values in parameters])
            for name, distribution in search_space.items()
        }
