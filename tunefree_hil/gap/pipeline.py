"""From measured drives to a diagnosis: which effects the model lacks, with their values and the doubt about them.

`diagnose` opens the problem (which recalibrates the model), looks at what recalibration leaves, scans all candidates
one by one, selects effects stepwise, and decides the verdict. gap/__init__.py lists where a name can be rejected.
`locate` stops before the candidates.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.contracts import Link, Port, links_of
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.gap.diagnostics.lack_of_fit import LackOfFit
from tunefree_hil.gap.diagnostics.residual_tests import LinkResidual, MisfitDescription, describe_misfit
from tunefree_hil.gap.estimation.evidence import non_holdout_blocks
from tunefree_hil.gap.estimation.intervals import (
    ParameterEstimate,
    estimate_parameters,
    inconsistent_daily_effects,
    inconsistent_gains,
)
from tunefree_hil.gap.estimation.residuals import ProblemSpec
from tunefree_hil.gap.measured.chain import MeasuredDrive
from tunefree_hil.gap.measured.command_echo import check_echoes
from tunefree_hil.gap.measured.excitation import (
    Excitation,
    assess_excitation,
    measure_quantities,
    require_enough_driving,
)
from tunefree_hil.gap.measured.observability import find_unobservable_links, find_unobservable_ports
from tunefree_hil.gap.model.graph import load_catalogue
from tunefree_hil.gap.progress import SearchProgress, SearchStage
from tunefree_hil.gap.selection.baseline_misfit import NO_BASELINE, BaselineMisfit, baseline_of_model
from tunefree_hil.gap.selection.candidate_reasons import in_order, remaining_reasons, score_reasons, step_reasons
from tunefree_hil.gap.selection.criteria import CRITERIA, CandidateScore
from tunefree_hil.gap.selection.equivalence import add_easily_confused, find_inseparable, has_lateral_acceleration
from tunefree_hil.gap.selection.model_misfit import ModelMisfit, SearchContext, assess_model, mark_broken_targets
from tunefree_hil.gap.selection.reasons import NAMED, Criterion, Reason, RejectionStage, Verdict, VerdictKind
from tunefree_hil.gap.selection.rejection import SelectionOutcome
from tunefree_hil.gap.selection.scoring import explained_targets
from tunefree_hil.gap.selection.search import fit_and_score, select_effects
from tunefree_hil.gap.selection.verdict import (
    Findings,
    decide_location,
    decide_verdict,
    find_changed_frames,
    find_day_sized,
    find_unexplained_beside,
)
from tunefree_hil.gap.validation.holdout_effect import (
    NOT_MEASURED,
    ComparedModels,
    HoldoutEffect,
    measure_holdout_effect,
)
from tunefree_hil.gap.workers import worker
from tunefree_hil.gap.workers.pool import WorkerPool
from tunefree_hil.gap.workers.worker import FitSummary, OpenProblem

Array = np.ndarray


class FoundEffect(NamedTuple):
    """An effect that the model lacks.

    Args:
        evidence: log evidence over the model without it, nats.
        is_weak: only the holdout blocks can confirm it.
        holdout: what it does to the signal that shows it best; not to be shown before the verification.
    """

    name: str
    params: dict[str, ParameterEstimate]
    evidence: float
    is_weak: bool = False
    holdout: HoldoutEffect = NOT_MEASURED


class Diagnosis(NamedTuple):
    """A search's whole result.

    Args:
        verdict: its kind, the names of a set, and the reasons.
        effects: the effects of ONE and SEVERAL.
        separate_by: the manoeuvre that separates the names of a set.
        link, location: the link at fault, and the target that shows it best; None where nothing is broken or found.
        links_before, links_after: every target after recalibration, and with the search's effects in the model.
        excitation: by effect, whether the logs could have shown it.
        candidates: every candidate scored alone, the best first.
        problem: the opened problem.
        repaired: the model with the effects; the recalibrated one where there are none.
        lack_of_fit_after: by target, what `repaired` leaves.
        unobservable_links, unobservable_ports: what these logs cannot show, with the reason.
        unmoving: why effects cannot show, of which no value moves anything that is compared.
        baseline: what the model misses on its calibration logs.
        rejected: why effects of the search were dropped, or are not new.
        rejected_candidates: why the other candidates are not named, each with the stage of the search.
        unexplained_beside: broken targets that the named effects do not work on.
        day_sized: named effects no larger than a day's change.
        inseparable: by named effect, those that no log of this car separates from it.
        drive_differences: numbers of the day that differ between the drives, in standard deviations.
    """

    verdict: Verdict
    link: Link | None
    location: MisfitDescription | None
    links_before: tuple[LinkResidual, ...]
    excitation: dict[str, Excitation]
    problem: OpenProblem
    repaired: FitSummary
    lack_of_fit_after: dict[str, LackOfFit]
    unobservable_links: dict[Link, str]
    unobservable_ports: Mapping[Port, str] = {}
    effects: tuple[FoundEffect, ...] = ()
    separate_by: str = ""
    links_after: tuple[LinkResidual, ...] = ()
    candidates: tuple[CandidateScore, ...] = ()
    unmoving: tuple[Reason, ...] = ()
    baseline: BaselineMisfit = NO_BASELINE
    rejected: tuple[Reason, ...] = ()
    rejected_candidates: tuple[Reason, ...] = ()
    unexplained_beside: tuple[LinkResidual, ...] = ()
    day_sized: tuple[str, ...] = ()
    inseparable: Mapping[str, tuple[str, ...]] = {}
    drive_differences: Mapping[str, float] = {}

    @property
    def set_names(self) -> tuple[str, ...]:
        """The names of a SET; empty for any other verdict."""
        return self.verdict.names if self.verdict.kind is VerdictKind.SET else ()


class Search(NamedTuple):
    """A search under way: the processes, the problem they have open, and what recalibration leaves."""

    pool: WorkerPool
    problem: OpenProblem
    recalibrated: ModelMisfit
    baseline: BaselineMisfit

    @property
    def blocks(self) -> Array:
        """The blocks that are fitted on and chosen by."""
        return non_holdout_blocks(self.problem.blocks)

    @property
    def context(self) -> SearchContext:
        """What the functions of selection/search.py work with."""
        return SearchContext(self.pool, self.problem, self.blocks)

    @property
    def drives(self) -> Sequence[MeasuredDrive]:
        """The measured drives."""
        return self.pool.spec.drives


class DecidedVerdict(NamedTuple):
    """The verdict, the effects it is about with all their equivalents, and what the logs could have shown."""

    verdict: Verdict
    steps: list[CandidateScore]
    excitation: dict[str, Excitation]
    has_changed_frames: bool


def diagnose(
    model: ModelSpec, vehicle: VehicleSpec, drives: Sequence[MeasuredDrive], workers: int = 2
) -> Generator[SearchProgress, None, Diagnosis]:
    """Find what the model lacks; yields its progress.

    Raises:
        InputError: the logs hold too little driving, or nothing that can be compared; the model's card cannot be read.
    """
    require_enough_driving(drives)
    baseline = baseline_of_model(model)  # an unreadable card is reported before the search
    with closing(WorkerPool(ProblemSpec(model, vehicle, tuple(drives)), workers)) as pool:
        yield SearchProgress(SearchStage.RECALIBRATION, "recalibration alone")
        problem = pool.open()
        search = assess_recalibrated(pool, problem, baseline)
        scores = yield from scan_candidates(search)
        alone, outcome = yield from select_effects(search.context, scores, search.recalibrated, baseline)
        decision = decide(search, alone, outcome)
        return make_diagnosis(search, scores, outcome, decision)


def locate(
    model: ModelSpec, vehicle: VehicleSpec, drives: Sequence[MeasuredDrive]
) -> Generator[SearchProgress, None, Diagnosis]:
    """Only where model and measurement differ: every link by itself, no candidate. Raises as `diagnose` does."""
    require_enough_driving(drives)
    with closing(WorkerPool(ProblemSpec(model, vehicle, tuple(drives)), workers=1)) as pool:
        yield SearchProgress(SearchStage.RECALIBRATION, "recalibration alone")
        problem = pool.open()
        yield SearchProgress(SearchStage.RECALIBRATION, "every link by itself")
        misfit = assess_model(pool, problem, problem.recalibrated, non_holdout_blocks(problem.blocks))
        location = _describe_location(pool, problem, misfit.links)
    changed = _find_changed_frames(drives)
    link = location.residual.link if location else None
    return Diagnosis(
        verdict=decide_location(misfit.links, changed),
        link=Link.COMMAND_ECHO if changed else link,
        location=location,
        links_before=tuple(misfit.links),
        excitation=assess_excitation(load_catalogue(), measure_quantities(drives, vehicle)),
        problem=problem,
        repaired=problem.recalibrated,
        lack_of_fit_after=misfit.lack_of_fit,
        unobservable_links=find_unobservable_links(drives),
        unobservable_ports=find_unobservable_ports(drives),
    )


def assess_recalibrated(pool: WorkerPool, problem: OpenProblem, baseline: BaselineMisfit) -> Search:
    """Look at what recalibration leaves, and mark the targets that it leaves broken."""
    misfit = assess_model(pool, problem, problem.recalibrated, non_holdout_blocks(problem.blocks))
    return Search(pool, mark_broken_targets(problem, misfit.links, baseline), misfit, baseline)


def scan_candidates(search: Search) -> Generator[SearchProgress, None, list[CandidateScore]]:
    """Fit every candidate alone and score it, the best first."""
    names = [candidate.name for candidate in search.problem.candidates]
    yield SearchProgress(SearchStage.CANDIDATES, f"{len(names)} candidates")
    return fit_and_score(search.context, names)


def decide(search: Search, alone: list[CandidateScore], outcome: SelectionOutcome) -> DecidedVerdict:
    """Complete the equivalents of the selected effects, and decide the verdict.

    Args:
        alone: the candidates scored alone, of the selection's last round.
    """
    drives, baseline = search.drives, search.baseline
    excitation = assess_excitation(load_catalogue(), measure_quantities(drives, search.pool.spec.vehicle))
    steps = [add_easily_confused(step, outcome.new_effects, excitation, drives) for step in outcome.new_effects]
    findings = Findings(
        links=search.recalibrated.links,
        alone=alone,
        steps=steps,
        rejection=outcome.rejection,
        changed_frames=_find_changed_frames(drives),
        inconsistent_gains=baseline.excess_inconsistency(find_inconsistent_gains(search.problem)),
        baseline=baseline,
    )
    return DecidedVerdict(decide_verdict(findings), steps, excitation, bool(findings.changed_frames))


def make_diagnosis(
    search: Search, scores: list[CandidateScore], outcome: SelectionOutcome, decision: DecidedVerdict
) -> Diagnosis:
    """Gather what belongs to a verdict. scores: every candidate scored alone."""
    pool, drives, links = search.pool, search.drives, search.recalibrated.links
    verdict, steps = decision.verdict, decision.steps
    untestable = {**search.problem.untestable_effects, **pool.impossible_candidates}
    location = _describe_location(pool, search.problem, links, steps)
    link = links_of(load_catalogue()[steps[0].name])[0] if steps else location.residual.link if location else None
    effects = _found_effects(search, steps, outcome.repaired) if verdict.kind in NAMED else ()
    diagnosis = Diagnosis(
        verdict=verdict,
        effects=effects,
        link=Link.COMMAND_ECHO if decision.has_changed_frames else link,
        location=location,
        links_before=tuple(links),
        links_after=tuple(outcome.links_with_all_steps),
        excitation=decision.excitation,
        candidates=tuple(scores),
        problem=search.problem._replace(untestable_effects=untestable),
        repaired=outcome.repaired,
        lack_of_fit_after=outcome.misfit.lack_of_fit,
        unobservable_links=find_unobservable_links(drives),
        unobservable_ports=find_unobservable_ports(drives),
        unmoving=_find_unmoving(pool, verdict.names),
        baseline=search.baseline,
        rejected=(*outcome.dropped, *outcome.known),
        rejected_candidates=_reject_candidates(search, scores, outcome, decision),
        inseparable=find_inseparable(verdict.names, drives),
        drive_differences=_drive_differences(search, outcome.repaired),
    )
    diagnosis = diagnosis._replace(separate_by=_separating_manoeuvre(diagnosis.set_names))
    return _with_remarks(search, diagnosis, outcome) if effects else diagnosis


def _reject_candidates(
    search: Search, scores: list[CandidateScore], outcome: SelectionOutcome, decision: DecidedVerdict
) -> tuple[Reason, ...]:
    """Why each candidate is not named, with those that the verdict and the dropped effects have no reason for."""
    verdict, impossible = decision.verdict, search.pool.impossible_candidates
    steps = () if verdict.names else decision.steps
    reasons = (
        *(reason for reason in search.pool.unfitted_beside(None) if reason.name not in impossible),
        *score_reasons(scores, RejectionStage.SCAN),
        *outcome.rejected_candidates,
        *step_reasons(steps, verdict.reasons),
    )
    written = (*verdict.reasons, *outcome.dropped, *outcome.known, *reasons)
    covered = {*verdict.names, *(reason.name for reason in written)}
    has_lateral = has_lateral_acceleration(search.drives)
    return in_order((*reasons, *remaining_reasons(scores, outcome.new_effects, covered, has_lateral)))


def _with_remarks(search: Search, diagnosis: Diagnosis, outcome: SelectionOutcome) -> Diagnosis:
    """A diagnosis that names effects, with how small they are and what is missed beside them."""
    problem = search.problem
    values = {effect.name: {key: p.value for key, p in effect.params.items()} for effect in diagnosis.effects}
    explained = explained_targets(problem.recalibrated, outcome.repaired, problem.signal_scales, search.blocks)
    return diagnosis._replace(
        day_sized=find_day_sized(values),
        unexplained_beside=find_unexplained_beside(outcome.misfit.links, explained, search.baseline),
    )


def find_inconsistent_gains(problem: OpenProblem) -> dict[str, float]:
    """The gains that recalibration alone would move to another value in each block, in standard deviations."""
    blocks = non_holdout_blocks(problem.blocks)
    sigmas = {
        free.key: free.calibration_sigma
        for candidate in problem.candidates
        for free in candidate.free
        if free.calibration_sigma
    }
    return inconsistent_gains(problem.recalibrated.fit, blocks, problem.blocks.drives[blocks], sigmas)


def _drive_differences(search: Search, model: FitSummary) -> Mapping[str, float]:
    """Numbers of the day that differ between the drives, in standard deviations."""
    return inconsistent_daily_effects(model.fit, search.blocks, search.problem.blocks.drives[search.blocks])


def _find_unmoving(pool: WorkerPool, names: Sequence[str]) -> tuple[Reason, ...]:
    """The candidates, but for the named ones, of which no value moves `min_explained_share` of any target."""
    least, stage = CRITERIA.min_explained_share, RejectionStage.UNTESTABLE
    return tuple(
        Reason(Criterion.UNMOVING, name, share, least, stage=stage)
        for name, share in pool.max_effect_shares.items()
        if share < least and name not in names
    )


def _found_effects(search: Search, steps: Sequence[CandidateScore], repaired: FitSummary) -> tuple[FoundEffect, ...]:
    """The named effects, each compared with the model without it."""
    problem, blocks, recalibrated = search.problem, search.blocks, search.problem.recalibrated
    holdout = np.setdiff1d(np.arange(problem.blocks.count), blocks)
    # The model may hold further effects, which are not named
    is_single = len({free.key.partition(".")[0] for free in repaired.fit.free}) == 1
    if is_single:
        without = {steps[0].name: recalibrated}
    else:
        without = search.pool.fit_without_effects(repaired, [step.name for step in steps])
    return tuple(
        FoundEffect(
            name=step.name,
            params=estimate_parameters(step.name, repaired.fit, blocks),
            evidence=step.evidence,
            is_weak=step.is_weak,
            holdout=measure_holdout_effect(
                ComparedModels(without[step.name], repaired, recalibrated), step.target, blocks, holdout
            ),
        )
        for step in steps
    )


def _find_changed_frames(drives: Sequence[MeasuredDrive]) -> tuple[Reason, ...]:
    return find_changed_frames([echo for drive in drives for echo in check_echoes(drive)])


def _describe_location(
    pool: WorkerPool, problem: OpenProblem, links: Sequence[LinkResidual], steps: Sequence[CandidateScore] = ()
) -> MisfitDescription | None:
    """The target that shows best what the recalibrated model misses; None where nothing is broken or found."""
    if not steps and not links[0].is_broken:
        return None
    target = steps[0].target if steps else links[0].signal
    regions, shape = pool.call(worker.describe_residual, problem.recalibrated.fit, target)
    link = next(link for link in links if link.signal == target)
    return describe_misfit(link, shape, regions, problem.signal_scales[target])


def _separating_manoeuvre(names: Sequence[str]) -> str:
    """What separates the names of a set: the manoeuvre of the first one that has one."""
    catalogue = load_catalogue()
    manoeuvres = (catalogue[name].manoeuvre for name in names if name in catalogue)
    return next((manoeuvre for manoeuvre in manoeuvres if manoeuvre), "")
