"""The samplers that a search can use: the options of the paper's Table III, and the ones beside it.

One record for each sampler says what it is and what it can do. Checks, errors and the table in
docs/reference/samplers.md follow from the records.
"""

from __future__ import annotations

from enum import StrEnum
from importlib.util import find_spec
from typing import NamedTuple

from tunefree_hil.base.errors import InputError

# Names that code refers to.
GP_EI, GP_UCB, GP_ME = "gp_ei", "gp_ucb", "gp_me"
TPE_INDEPENDENT, TPE_RELATIVE = "tpe_independent", "tpe_relative"
CMA, TPE_CMA, NSGA = "cma", "tpe_cma", "nsga"
QMC, RANDOM = "qmc", "random"
TRUST_REGION = "trust_region"
AUTO = "auto"  # no sampler: chosen before the study is made (automatic_choice.py)

LEARN_MODULES = ("torch", "botorch")  # of the extra `learn`


class Surrogate(StrEnum):
    """What models the score."""

    GPR = "GPR"
    TPE = "TPE"
    NONE = "none"


class Acquisition(StrEnum):
    """What decides between searching where the score is good and where it is unknown (paper, III-B.2)."""

    UCB = "UCB"
    EI = "EI"
    ME = "ME"
    NONE = "none"


class Drawing(StrEnum):
    """How the parameters of one suggestion are drawn: each alone, or all together."""

    INDEPENDENT = "independent"
    RELATIVE = "relative"


class ConstraintUse(StrEnum):
    """How a sampler knows the requirements."""

    MODELLED = "constraint"  # as a constraint of its own
    RANKED = "ranked"  # the score grows with the violation (`rank_value`)
    NONE = "none"


class DiscreteUse(StrEnum):
    """How a sampler treats steps and choices."""

    EXACT = "exact"
    ROUNDED = "rounded"


class ModelCriteria(NamedTuple):
    """Of the samplers with a Gaussian process."""

    # weight of the uncertainty in eq. 8 of the paper, in standard deviations; the paper names no value. With 2 the
    # confidence bound is the end of the 95 % interval
    kappa_w: float = 2.0
    random_trials: int = 10  # before the first model; the default of Optuna's TPE and Gaussian process


MODEL_CRITERIA = ModelCriteria()
KAPPA_W = MODEL_CRITERIA.kappa_w


class SamplerRecord(NamedTuple):
    """What a sampler is and can do.

    objectives: It searches several objectives at the same time.
    module: The module of the extra `learn` that it needs; '' for none.
    source: Where it is described.
    """

    name: str
    surrogate: Surrogate
    acquisition: Acquisition
    drawing: Drawing
    constraints: ConstraintUse
    objectives: bool
    discrete: DiscreteUse
    module: str
    source: str


_GPR, _TPE, _NO_MODEL = Surrogate.GPR, Surrogate.TPE, Surrogate.NONE
_UCB, _EI, _ME, _NO_ACQUISITION = Acquisition.UCB, Acquisition.EI, Acquisition.ME, Acquisition.NONE
_ALONE, _TOGETHER = Drawing.INDEPENDENT, Drawing.RELATIVE
_MODELLED, _RANKED, _UNUSED = ConstraintUse.MODELLED, ConstraintUse.RANKED, ConstraintUse.NONE
_EXACT, _ROUNDED = DiscreteUse.EXACT, DiscreteUse.ROUNDED

# fmt: off
RECORDS: tuple[SamplerRecord, ...] = (
    SamplerRecord(GP_EI, _GPR, _EI, _TOGETHER, _MODELLED, True, _EXACT, "torch", "arXiv:2310.20708"),
    SamplerRecord(GP_UCB, _GPR, _UCB, _TOGETHER, _RANKED, False, _ROUNDED, "botorch", "arXiv:0912.3995"),
    SamplerRecord(GP_ME, _GPR, _ME, _TOGETHER, _RANKED, False, _ROUNDED, "botorch", "arXiv:2102.03324"),
    SamplerRecord(TPE_INDEPENDENT, _TPE, _EI, _ALONE, _MODELLED, True, _EXACT, "", "arXiv:2304.11127"),
    SamplerRecord(TPE_RELATIVE, _TPE, _EI, _TOGETHER, _MODELLED, True, _EXACT, "", "arXiv:1807.01774"),
    SamplerRecord(CMA, _NO_MODEL, _NO_ACQUISITION, _TOGETHER, _RANKED, False, _ROUNDED, "", "arXiv:1604.00772"),
    SamplerRecord(TPE_CMA, _TPE, _EI, _TOGETHER, _RANKED, False, _ROUNDED, "", "arXiv:1604.00772"),
    SamplerRecord(TRUST_REGION, _NO_MODEL, _NO_ACQUISITION, _TOGETHER, _RANKED, False, _ROUNDED, "",
                  "doi:10.5281/zenodo.10655367"),
    SamplerRecord(NSGA, _NO_MODEL, _NO_ACQUISITION, _TOGETHER, _MODELLED, True, _EXACT, "",
                  "doi:10.1109/4235.996017"),
    SamplerRecord(QMC, _NO_MODEL, _NO_ACQUISITION, _TOGETHER, _UNUSED, True, _EXACT, "",
                  "doi:10.1016/0041-5553(67)90144-9"),
    SamplerRecord(RANDOM, _NO_MODEL, _NO_ACQUISITION, _ALONE, _UNUSED, True, _EXACT, "",
                  "jmlr.org/papers/v13/bergstra12a"),
)
# fmt: on

BY_NAME = {record.name: record for record in RECORDS}
SAMPLERS: tuple[str, ...] = tuple(BY_NAME)


def find_record(name: str) -> SamplerRecord:
    """The record of a sampler. Raises InputError, which names all, where there is none."""
    if name not in BY_NAME:
        known = ", ".join((AUTO, *SAMPLERS))
        raise InputError(f"no sampler {name!r}", code="unknown_sampler", key="tune.sampler", hint=f"use one of {known}")
    return BY_NAME[name]


def is_installed(record: SamplerRecord) -> bool:
    """Whether the extra of a sampler is installed. Nothing is imported: torch alone takes seconds."""
    needed = LEARN_MODULES[: LEARN_MODULES.index(record.module) + 1] if record.module else ()
    return all(find_spec(module) is not None for module in needed)


def check_sampler(name: str, objectives: int = 1) -> None:
    """Check that a sampler can do a search on this machine.

    Args:
        name: Name of the sampler.
        objectives: Number of objectives of the search.

    Raises:
        InputError: It is unknown, its extra is not installed, or it cannot search so many objectives.
    """
    record = find_record(name)
    if not is_installed(record):
        raise InputError(
            f"the sampler {name} needs {record.module}, which is not installed",
            code="no_torch",
            key="tune.sampler",
            hint="pip install '.[learn]' in the project's folder, or use a sampler without it: "
            + ", ".join(other.name for other in RECORDS if not other.module),
        )
    if objectives > 1 and not record.objectives:
        raise InputError(
            f"the sampler {name} searches one objective, not {objectives}",
            code="sampler_objectives",
            key="tune.sampler",
            hint="use one of " + ", ".join((AUTO, *(other.name for other in RECORDS if other.objectives))),
        )
