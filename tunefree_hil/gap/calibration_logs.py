"""What a model's calibration logs show: the effects in them, and what the model misses of them.

Where catalogue effects explain all that a model misses of these logs, a later search finds them by itself. Where they
do not, the logs still determine the effects of the sensors (scale, offset, latency), because sensors are compared with
each other whatever the car does. These become part of the model; what is still missed is its baseline misfit
(gap/selection/baseline_misfit.py), which later logs are compared with.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Link, links_of
from tunefree_hil.config.schema import EffectSpec, ModelSpec, VehicleSpec
from tunefree_hil.gap.estimation.calibration_priors import CalibrationPrior, prior_from_fit
from tunefree_hil.gap.estimation.evidence import non_holdout_blocks
from tunefree_hil.gap.estimation.intervals import estimates_across_blocks, standard_deviations
from tunefree_hil.gap.estimation.residuals import ProblemSpec
from tunefree_hil.gap.measured.chain import MeasuredDrive
from tunefree_hil.gap.measured.observability import find_unobservable_links
from tunefree_hil.gap.model.graph import load_catalogue
from tunefree_hil.gap.pipeline import Diagnosis
from tunefree_hil.gap.progress import SearchProgress, SearchStage
from tunefree_hil.gap.selection.baseline_misfit import (
    NO_BASELINE,
    BaselineMisfit,
    baseline_from_links,
    group_by_effect,
)
from tunefree_hil.gap.selection.criteria import CRITERIA, CandidateScore
from tunefree_hil.gap.selection.model_misfit import SearchContext, assess_model
from tunefree_hil.gap.selection.search import fit_and_score
from tunefree_hil.gap.workers.pool import WorkerPool
from tunefree_hil.gap.workers.worker import FitSummary, OpenProblem
from tunefree_hil.learn.estimate import HALF_WIDTH_95
from tunefree_hil.learn.model_folder import CALIBRATION_LOGS

Array = np.ndarray

SENSOR_LINKS = (Link.WHEEL_VS_INS, Link.YAW_VS_INS, Link.ACCEL_VS_DVDT, Link.CLOCK)
VEHICLE_LIMITS = ("power_limit",)  # limits of a car that no constant of the plant stands for
TYRE_EFFECTS = ("tyre_relaxation",)  # of any tyre, but not part of the plants
MAX_SENSOR_EFFECTS = 6
# Standard deviation in u at which the logs know as much of a parameter as its uniform prior: information 2 pi each
UNINFORMATIVE_STD_U = (4.0 * np.pi) ** -0.5


class CalibrationLogs(NamedTuple):
    """A model with its calibration logs."""

    model: ModelSpec
    vehicle: VehicleSpec
    drives: Sequence[MeasuredDrive]
    workers: int = 2

    @property
    def spec(self) -> ProblemSpec:
        """As a worker process takes it."""
        return ProblemSpec(self.model, self.vehicle, tuple(self.drives))


def baseline_from_search(diagnosis: Diagnosis) -> BaselineMisfit:
    """Baseline from a search that leaves no link broken: the effects that explain the logs, and the misfit without."""
    return NO_BASELINE._replace(
        explaining=_estimates_by_effect(diagnosis.repaired, non_holdout_blocks(diagnosis.problem.blocks)),
        misfit_unexplained={link.signal: link.misfit_share for link in diagnosis.links_before if link.is_broken},
    )


def named_vehicle_limits(diagnosis: Diagnosis, model: ModelSpec) -> list[EffectSpec]:
    """VEHICLE_LIMITS that a search of the logs names with plain evidence, and the model does not have.

    Once they are in the model, later logs do not show them as missing. A lower limit is still found, as it acts first.
    """
    plain = {
        effect.name
        for effect in diagnosis.effects
        if effect.evidence > CRITERIA.plain_evidence_nats and not effect.is_weak
    }
    estimates = _estimates_by_effect(diagnosis.repaired, non_holdout_blocks(diagnosis.problem.blocks))
    return [_effect_spec(name, estimates[name]) for name in _missing_effects(model, VEHICLE_LIMITS) if name in plain]


def find_vehicle_limits(logs: CalibrationLogs) -> Generator[SearchProgress, None, list[EffectSpec]]:
    """Find VEHICLE_LIMITS in logs in which no link is broken, each limit by itself.

    A later log may be at a limit all the time, and could not show it.
    """
    yield SearchProgress(SearchStage.RECALIBRATION, "limits of the car")
    return _find_plain_effects(logs, VEHICLE_LIMITS)


def find_tyre_effects(logs: CalibrationLogs) -> Generator[SearchProgress, None, list[EffectSpec]]:
    """Find TYRE_EFFECTS that show where the model comes near its logs, although it misses them elsewhere.

    Otherwise they would explain as much of each later log, and hide what is new there.
    """
    yield SearchProgress(SearchStage.RECALIBRATION, "its tyres")
    return _find_plain_effects(logs, TYRE_EFFECTS, only_unbroken=True)


def _find_plain_effects(
    logs: CalibrationLogs, names: Sequence[str], *, only_unbroken: bool = False
) -> list[EffectSpec]:
    """Effects that the logs contain with plain evidence, each by itself, and the model does not have.

    Args:
        only_unbroken: only those that show best in a target that is not broken
    """
    with closing(WorkerPool(logs.spec, workers=1)) as pool:
        problem = pool.open()
        blocks, missing = non_holdout_blocks(problem.blocks), _missing_effects(logs.model, names)
        if only_unbroken:
            _, links = assess_model(pool, problem, problem.recalibrated, blocks)
            problem = problem._replace(broken_targets=frozenset(link.signal for link in links if link.is_broken))
        tested = [candidate.name for candidate in problem.candidates if candidate.name in missing]
        scores = fit_and_score(SearchContext(pool, problem, blocks), tested) if tested else []
    plain = [
        score
        for score in scores
        if score.is_accepted
        and score.evidence > CRITERIA.plain_evidence_nats
        and (score.is_unbroken or not only_unbroken)
    ]
    return [_effect_spec(score.name, _estimates_by_effect(score.model, blocks)[score.name]) for score in plain]


def _missing_effects(model: ModelSpec, names: Sequence[str]) -> list[str]:
    present = {effect.name for effect in model.effects}
    return [name for name in names if name not in present]


def _estimates_by_effect(model: FitSummary, blocks: Array) -> dict[str, dict[str, tuple[float, float]]]:
    """Value and standard deviation of each parameter, by effect."""
    return group_by_effect(estimates_across_blocks(model.fit, blocks))


def find_sensor_effects(logs: CalibrationLogs) -> Generator[SearchProgress, None, list[EffectSpec]]:
    """Find sensor effects whatever else the model misses: one after the other, each beside the earlier ones.

    They need plain evidence, but not agreement of the blocks, as the model explains none of them. A sensor without
    a second one would be compared with the model, which is wrong here; it is not tested.
    """
    yield SearchProgress(SearchStage.RECALIBRATION, "its sensors")
    with closing(WorkerPool(logs.spec, logs.workers)) as pool:
        problem = pool.open()
        observable = set(SENSOR_LINKS) - set(find_unobservable_links(logs.drives))
        catalogue = load_catalogue()
        names = [
            candidate.name for candidate in problem.candidates if links_of(catalogue[candidate.name])[0] in observable
        ]
        blocks, model = non_holdout_blocks(problem.blocks), None
        for _ in range(MAX_SENSOR_EFFECTS):
            yield SearchProgress(SearchStage.RECALIBRATION, f"its sensors: {len(names)} candidates")
            scores = [
                score for score in fit_and_score(SearchContext(pool, problem, blocks), names, model) if _is_plain(score)
            ]
            best = max(scores, key=lambda score: score.evidence, default=None)
            if best is None:
                break
            model, names = best.model, [name for name in names if name != best.name]
    estimates = {} if model is None else _estimates_by_effect(model, blocks)
    return [_effect_spec(name, params) for name, params in sorted(estimates.items())]  # in the order of the simulation


def _effect_spec(name: str, params: Mapping[str, tuple[float, float]]) -> EffectSpec:
    """Entry of [[effects]]. params: value and standard deviation of each parameter."""
    half_width = {key: HALF_WIDTH_95 * std for key, (_, std) in params.items()}
    return EffectSpec(
        name=name,
        params={key: value for key, (value, _) in params.items()},
        interval={key: [value - half_width[key], value + half_width[key]] for key, (value, _) in params.items()},
        provenance={"by": CALIBRATION_LOGS},
    )


def _is_plain(score: CandidateScore) -> bool:
    """Whether a sensor effect has plain evidence and degrades no broken target."""
    return (
        score.is_relevant
        and min(score.evidence, score.gain.total) > CRITERIA.plain_evidence_nats
        and score.broken_degradation < CRITERIA.max_degradation
    )


def measure_baseline_misfit(logs: CalibrationLogs) -> Generator[SearchProgress, None, BaselineMisfit]:
    """Measure the misfit, and the value that each effect would have alone, however little it gains.

    Returns: NO_BASELINE where no link is broken any more
    """
    yield SearchProgress(SearchStage.REMAINDER, "what is left unexplained")
    with closing(WorkerPool(logs.spec, logs.workers, fits_all=True)) as pool:
        problem = pool.open()
        blocks = non_holdout_blocks(problem.blocks)
        _, links = assess_model(pool, problem, problem.recalibrated, blocks)
        if not any(link.is_broken for link in links):
            return NO_BASELINE
        yield SearchProgress(SearchStage.CANDIDATES, f"{len(problem.candidates)} candidates, each alone")
        fits = pool.fit_candidates([candidate.name for candidate in problem.candidates], None)
    estimates: dict[str, dict[str, tuple[float, float]]] = {}
    for name, fit in fits.items():
        estimates |= group_by_effect(known_parameters(name, fit, blocks))
    return baseline_from_links(links, estimates)


def prior_from_problem(problem: OpenProblem) -> CalibrationPrior:
    """Prior of the recalibrated parameters, from an open problem of the model's calibration logs."""
    return prior_from_fit(problem.recalibrated.fit, problem.nuisances, non_holdout_blocks(problem.blocks))


def known_parameters(name: str, model: FitSummary, blocks: Array) -> dict[str, tuple[float, float]]:
    """Value and standard deviation of the parameters of an effect that the logs determine, by key.

    A limit that they do not determine lies beyond all that they reach, exactly: a lower one in later logs is new,
    however little these know of it.
    """
    estimates, neutral = estimates_across_blocks(model.fit, blocks), load_catalogue()[name].neutral
    keys, std = list(model.fit.keys), standard_deviations(model.fit, blocks)
    known = {key for key in estimates if std[keys.index(key)] < UNINFORMATIVE_STD_U}
    limits = {key for key in estimates if not np.isfinite(neutral[key.partition(".")[2]])}
    unreached = {key: (value, 0.0) for key, (value, _) in estimates.items() if key in limits - known}
    return {key: estimate for key, estimate in estimates.items() if key in known} | unreached
