"""`sampler = "auto"`: which sampler a search gets, from how many trials it has and what a trial costs."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from tunefree_hil.tune.sampling.records import BY_NAME, GP_EI, NSGA, TPE_CMA, TPE_INDEPENDENT, is_installed


class AutomaticCriteria(NamedTuple):
    """When which sampler. Numbers of trials are of the whole search."""

    # gp_ei was ahead of TPE at 50 trials and behind it at 200, with 11 parameters and 7 scenarios (median best score
    # .355 against .365, and .298 against .290, of 3 and 5 seeds; score eq. 7 of the paper)
    most_gp_trials: int = 60
    least_gp_trials: int = 20  # the first 10 are random in both
    most_gp_parameters: int = 20  # one length scale each must be learned from the few trials
    # tpe_cma begins with 64 trials of TPE; then there are ten populations of 12 and more. With requirements it is used
    # from there, as it goes along the limits, where the best sets are
    least_cma_trials_required: int = 200
    # without requirements: independent TPE was ahead of CMA-ES at 200 trials and level at 400 (.290 against .304, and
    # .283 both, median of 5 seeds, same search as above)
    least_cma_trials: int = 400
    least_cma_parameters: int = 3  # with 2 all samplers come to the same score (same search as above)
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
    is_batch: A trial takes milliseconds, less than a suggestion of a Gaussian process.
    has_requirements: The search keeps limits.
    has_torch: torch is installed on all machines of the search.
    """

    trials: int
    parameters: int
    objectives: int = 1
    is_batch: bool = False
    has_requirements: bool = False
    has_torch: bool = False


class ChoiceReason(StrEnum):
    """Why a sampler was chosen."""

    FEW_TRIALS = "few_trials"
    MEDIUM_TRIALS = "medium_trials"
    MANY_TRIALS = "many_trials"
    FAST_TRIALS = "fast_trials"
    NO_TORCH = "no_torch"
    MANY_PARAMETERS = "many_parameters"
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
    required = task.has_requirements
    if task.trials >= (CRITERIA.least_cma_trials_required if required else CRITERIA.least_cma_trials):
        if task.parameters < CRITERIA.least_cma_parameters:
            return SamplerChoice(TPE_INDEPENDENT, ChoiceReason.FEW_PARAMETERS)
        return SamplerChoice(TPE_CMA, ChoiceReason.MANY_TRIALS)
    if not CRITERIA.least_gp_trials <= task.trials <= CRITERIA.most_gp_trials:
        return SamplerChoice(TPE_INDEPENDENT, ChoiceReason.MEDIUM_TRIALS)
    return _choose_for_few_trials(task)


def _choose_for_few_trials(task: SearchTask) -> SamplerChoice:
    """A Gaussian process, unless there is a reason against it."""
    reasons = {
        ChoiceReason.FAST_TRIALS: task.is_batch,
        ChoiceReason.MANY_PARAMETERS: task.parameters > CRITERIA.most_gp_parameters,
        ChoiceReason.NO_TORCH: not task.has_torch,
    }
    against = [reason for reason, is_met in reasons.items() if is_met]
    return SamplerChoice(TPE_INDEPENDENT, against[0]) if against else SamplerChoice(GP_EI, ChoiceReason.FEW_TRIALS)


def has_learn_modules() -> bool:
    """Whether what `gp_ei` needs is installed here."""
    return is_installed(BY_NAME[GP_EI])


def describe_choice(choice: SamplerChoice, task: SearchTask) -> str:
    """The choice in words."""
    reasons = {
        ChoiceReason.FEW_TRIALS: f"{task.trials} trials: a Gaussian process learns most from few",
        ChoiceReason.MEDIUM_TRIALS: f"{task.trials} trials",
        ChoiceReason.MANY_TRIALS: f"{task.trials} trials: CMA-ES follows the first {TPE_INDEPENDENT} trials",
        ChoiceReason.FAST_TRIALS: "a trial of the batch is faster than a suggestion of a Gaussian process",
        ChoiceReason.NO_TORCH: "the extra `learn` is not installed on every machine of the search",
        ChoiceReason.MANY_PARAMETERS: f"{task.parameters} parameters are many for a Gaussian process",
        ChoiceReason.FEW_PARAMETERS: f"{task.parameters} parameters need no finer search",
        ChoiceReason.SEVERAL_OBJECTIVES: f"{task.objectives} objectives and {task.trials} trials",
    }
    return f"sampler: {choice.sampler}, chosen by auto ({reasons[choice.reason]})"
