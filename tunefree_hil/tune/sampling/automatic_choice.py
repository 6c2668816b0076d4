"""`sampler = "auto"`: which sampler a search gets, by its trials, parameters, objectives and requirements."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from tunefree_hil.tune.sampling.records import NSGA, TPE_CMA, TPE_INDEPENDENT, TRUST_REGION


class AutomaticCriteria(NamedTuple):
    """When which sampler. Numbers of trials are of the whole search."""

    # from so many trials on tpe_cma, which begins with 64 trials of TPE and then learns over many populations. Up to
    # here trust_region: on two vehicles, 11 parameters, two seeds each, one trial after the other, its median best
    # score was below that of independent TPE by 3 to 5 % at 50 trials, and within 1.5 % of it at 100 to 400. A small
    # sample; `tools/measure samplers` asks with more seeds
    least_cma_trials: int = 401
    # with requirements it is used from here in the batch, as it goes along the limits, where the best sets are
    least_cma_trials_required: int = 200
    least_cma_parameters: int = 3  # with 2 all samplers come to the same score
    # TPE with several objectives needs fewer trials than NSGA-II (Ozaki et al. 2022, doi:10.1613/jair.1.13188): on two
    # bowls in 8 parameters its hypervolume was larger after 80, 160 and 400 trials (2.60, 3.28, 3.60 against 2.01,
    # 3.03, 3.47; median of 3 seeds). But its suggestions take longer the more trials there are
    least_nsga_trials: int = 1000


CRITERIA = AutomaticCriteria()


class SearchTask(NamedTuple):
    """What the choice depends on.

    trials: Of the whole search.
    parameters: Number of searched parameters.
    objectives: Number of objectives.
    is_batch: The trials are driven in the batch, several at the same time; few of them would be of the local search.
    has_requirements: The search keeps limits.
    """

    trials: int
    parameters: int
    objectives: int = 1
    is_batch: bool = False
    has_requirements: bool = False


class ChoiceReason(StrEnum):
    """Why a sampler was chosen."""

    FEW_TRIALS = "few_trials"
    MANY_TRIALS = "many_trials"
    FEW_PARAMETERS = "few_parameters"
    SEVERAL_OBJECTIVES = "several_objectives"


class SamplerChoice(NamedTuple):
    """A chosen sampler. Stored under its field names."""

    sampler: str
    reason: ChoiceReason


def choose_sampler(task: SearchTask) -> SamplerChoice:
    """The sampler for a search; a function of the task alone."""
    if task.objectives > 1:
        is_long = task.trials >= CRITERIA.least_nsga_trials
        return SamplerChoice(NSGA if is_long else TPE_INDEPENDENT, ChoiceReason.SEVERAL_OBJECTIVES)
    along_limits = task.has_requirements and task.is_batch
    if task.trials < (CRITERIA.least_cma_trials_required if along_limits else CRITERIA.least_cma_trials):
        return SamplerChoice(TRUST_REGION, ChoiceReason.FEW_TRIALS)
    if task.parameters < CRITERIA.least_cma_parameters:
        return SamplerChoice(TPE_INDEPENDENT, ChoiceReason.FEW_PARAMETERS)
    return SamplerChoice(TPE_CMA, ChoiceReason.MANY_TRIALS)


def describe_choice(choice: SamplerChoice, task: SearchTask) -> str:
    """The choice in words."""
    reasons = {
        ChoiceReason.FEW_TRIALS: f"{task.trials} trials: a local search from the best manual set needs the fewest",
        ChoiceReason.MANY_TRIALS: f"{task.trials} trials: CMA-ES follows the first {TPE_INDEPENDENT} trials",
        ChoiceReason.FEW_PARAMETERS: f"{task.parameters} parameters need no finer search",
        ChoiceReason.SEVERAL_OBJECTIVES: f"{task.objectives} objectives and {task.trials} trials",
    }
    return f"sampler: {choice.sampler}, chosen by auto ({reasons[choice.reason]})"
