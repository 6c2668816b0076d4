"""The stepwise search over effects, and the search again without those that are not new.

Forward: the best accepted candidate is added, and all others are scored beside it. Backward: an effect that is no
longer accepted beside the later ones is taken out. Settle: each effect that stays is compared with all candidates in
its place; those that explain as much are its equivalents. Models are refined before they are compared: else what the
fit gains for the other effects would count for the candidate.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.estimation.evidence import (
    MIN_EVIDENCE_NATS,
    correlation_rows_by_target,
    log_evidence,
    with_correlation_rows,
)
from tunefree_hil.gap.progress import SearchProgress, SearchStage
from tunefree_hil.gap.selection.baseline_misfit import BaselineMisfit
from tunefree_hil.gap.selection.candidate_reasons import rejected_reasons, score_reasons
from tunefree_hil.gap.selection.criteria import CRITERIA, SEARCH, CandidateScore
from tunefree_hil.gap.selection.equivalence import find_better_rejected, find_equivalents
from tunefree_hil.gap.selection.model_misfit import ModelMisfit, SearchContext
from tunefree_hil.gap.selection.reasons import Criterion, Reason, RejectionStage
from tunefree_hil.gap.selection.rejection import SelectionOutcome, reject_effects
from tunefree_hil.gap.selection.scoring import Comparison, score_candidates
from tunefree_hil.gap.workers.worker import FitSummary, OpenProblem

Array = np.ndarray


class SelectedSteps(NamedTuple):
    """Effects of a search in its order, and why others, or some of these before, are rejected."""

    steps: list[CandidateScore]
    rejected: tuple[Reason, ...] = ()


class SettledSteps(NamedTuple):
    """Effects with their equivalents.

    Args:
        alone: every candidate scored alone, a single effect with its last model.
        rejected: why other candidates do not stand in the place of an effect.
    """

    steps: list[CandidateScore]
    alone: list[CandidateScore]
    rejected: tuple[Reason, ...] = ()


def select_effects(
    context: SearchContext, scores: list[CandidateScore], recalibrated: ModelMisfit, baseline: BaselineMisfit
) -> Generator[SearchProgress, None, tuple[list[CandidateScore], SelectionOutcome]]:
    """Repeat the search, each time without effects that the calibration logs had as well, until none of these is found:
    an effect that is not new must not hide a new one.

    Args:
        scores: every candidate scored alone.
        recalibrated: what the model without effects leaves.

    Returns:
        the candidates scored alone in the last round, and its outcome. What earlier rounds rejected is searched again.
    """
    known_names, known = set[str](), tuple[Reason, ...]()
    while True:
        remaining = context._replace(problem=_without_candidates(context.problem, known_names))
        alone = [score for score in scores if score.name not in known_names]
        added = yield from search_forward(remaining, alone)
        stay = yield from search_backward(remaining, added.steps)
        is_shorter = len(stay.steps) < len(added.steps)
        steps, alone, unsettled = yield from settle_steps(remaining, alone, stay.steps, shortened=is_shorter)
        yield SearchProgress(SearchStage.REMAINDER, "what is left unexplained")
        outcome = reject_effects(remaining, steps, alone, recalibrated, baseline)
        known += outcome.known
        if not outcome.known_names:
            rejected = (*added.rejected, *stay.rejected, *unsettled)
            return alone, outcome._replace(known=known, rejected_candidates=rejected)
        known_names |= set(outcome.known_names)


def _without_candidates(problem: OpenProblem, names: Collection[str]) -> OpenProblem:
    return problem._replace(candidates=tuple(c for c in problem.candidates if c.name not in names))


def search_forward(
    context: SearchContext, alone: list[CandidateScore]
) -> Generator[SearchProgress, None, SelectedSteps]:
    """Add one effect after another, each scored beside those before it and fitted with them."""
    first = _first_step(alone)
    if first is None:
        return SelectedSteps([])
    steps, rejected = [first], list[Reason]()
    while len(steps) < SEARCH.max_effects:
        selected = {step.name for step in steps}
        names = [candidate.name for candidate in context.problem.candidates if candidate.name not in selected]
        yield SearchProgress(
            SearchStage.FURTHER_EFFECTS, f"further effects beside {', '.join(step.name for step in steps)}"
        )
        beside = tuple(step.name for step in steps)
        scores = fit_and_score(context, names, steps[-1].model)
        rejected += context.pool.unfitted_beside(steps[-1].model)
        rejected += score_reasons(scores, RejectionStage.FORWARD, beside)
        if not scores or not scores[0].is_accepted:
            break
        if better := find_better_rejected(scores):
            rejected.append(_outdone_reason(scores[0], better, RejectionStage.FORWARD, beside))
            break
        score = _score_beside_others(context, scores[0])
        if not score.is_accepted:
            rejected += score_reasons([score], RejectionStage.FORWARD, beside)
            break
        steps.append(_with_equivalents(score, find_equivalents(scores, context.blocks), scores))
    return SelectedSteps(steps if first.is_accepted or len(steps) > 1 else [], tuple(rejected))


def _outdone_reason(
    best: CandidateScore, better: CandidateScore, stage: RejectionStage, beside: tuple[str, ...]
) -> Reason:
    """That a candidate which fails its own score explains more than the best one."""
    evidence, others = (best.evidence, better.evidence), (better.name,)
    return Reason(Criterion.BETTER_REJECTED, best.name, *evidence, others=others, stage=stage, beside=beside)


def _first_step(alone: Sequence[CandidateScore]) -> CandidateScore | None:
    """The candidate that others are tried beside; None where none qualifies.

    It is the best accepted one. Where a rejected one has more evidence, or none is accepted, it is the one with the
    most evidence, if it fails only by the signals that it degrades: two effects that hide each other (a late INS, a
    filtered gyro) are found together or not at all.
    """
    if not alone:
        return None
    if alone[0].is_accepted and not find_better_rejected(alone):
        return alone[0]
    strongest = max(alone, key=lambda score: score.evidence)
    return strongest if strongest.degrades_others else None


def search_backward(
    context: SearchContext, steps: list[CandidateScore]
) -> Generator[SearchProgress, None, SelectedSteps]:
    """Take out effects that are no longer accepted beside those found later."""
    if len(steps) < 2:
        return SelectedSteps(steps)
    yield SearchProgress(SearchStage.ELIMINATION, "each effect without the others")
    last, stay, rejected = steps[-1].model, steps, list[Reason]()
    for name in [step.name for step in steps]:
        # The newest was accepted beside all the others
        if len(stay) == 1 or (name == steps[-1].name and len(stay) == len(steps)):
            break
        rest = context.pool.fit_without_effects(last, [name])[name]
        score = _score(context, {name: last}, rest)[0]
        if not score.is_accepted:
            last, stay = rest, [step for step in stay if step.name != name]
            beside = tuple(step.name for step in stay)
            rejected += score_reasons([score], RejectionStage.BACKWARD, beside)
    return SelectedSteps([*stay[:-1], stay[-1]._replace(model=last)], tuple(rejected))


def settle_steps(
    context: SearchContext, alone: list[CandidateScore], steps: list[CandidateScore], shortened: bool = False
) -> Generator[SearchProgress, None, SettledSteps]:
    """Find the equivalents of each effect; a single one is scored again, and the best candidate takes its place.

    Args:
        alone: every candidate scored alone.
        shortened: an effect was taken out, so that the equivalents of the newest have to be found again.
    """
    if not steps:
        return SettledSteps([], alone)
    if len(steps) == 1:
        return _settle_single(context, alone, steps[0])
    settled, last, rejected = list[CandidateScore](), steps[-1].model, list[Reason]()
    for step in steps if shortened else steps[:-1]:
        yield SearchProgress(SearchStage.ELIMINATION, f"each candidate in the place of {step.name}")
        in_place = _score_in_place(context, steps, step)
        settled += in_place.steps
        rejected += in_place.rejected
    settled += steps[len(settled) :]
    return SettledSteps([*settled[:-1], settled[-1]._replace(model=last)], alone, tuple(rejected))


def _settle_single(context: SearchContext, alone: list[CandidateScore], step: CandidateScore) -> SettledSteps:
    """The best of all candidates takes the place of a single effect, which is scored with its last model."""
    if alone[0].name != step.name:
        models = {score.name: score.model for score in alone} | {step.name: step.model}
        alone = _score(context, models, context.problem.recalibrated)
    best, own = alone[0], [score for score in alone if score.name == step.name]
    better = find_better_rejected(alone) if best.is_accepted else None
    if better is not None:
        outdone = _outdone_reason(best, better, RejectionStage.SETTLING, ())
        return SettledSteps([], alone, (outdone, *score_reasons(own, RejectionStage.SETTLING)))
    if not best.is_accepted:
        return SettledSteps([], alone, score_reasons(own, RejectionStage.SETTLING))
    equivalents = find_equivalents(alone, context.blocks)
    rejected = rejected_reasons([best, *own], (best.name, *equivalents), RejectionStage.SETTLING)
    return SettledSteps([_with_equivalents(best, equivalents, alone)], alone, rejected)


def fit_and_score(
    context: SearchContext,
    names: Sequence[str],
    start: FitSummary | None = None,
    known: Mapping[str, FitSummary] | None = None,
) -> list[CandidateScore]:
    """Fit candidates beside a model and score them, the best first; the strongest are fitted on to their end.

    Args:
        start: the model that they are added to; None: the recalibrated one.
        known: models that are fitted on already, to be scored with them.
    """
    pool, base, known = context.pool, context.problem.recalibrated if start is None else start, known or {}
    models, refined = {**pool.fit_candidates(names, start), **known}, set(known)
    scores = _refine_best(context, models, base, refined)
    if scores and scores[0].evidence > CRITERIA.plain_evidence_nats:
        rest = [name for name in names if name in models and name not in refined]
        best = scores[0].model
        models |= _improved_fits(models, pool.fit_candidates(rest, start, best), best, context.blocks)
        scores = _refine_best(context, models, base, refined)
    return scores


def _refine_best(
    context: SearchContext, models: dict[str, FitSummary], base: FitSummary, refined: set[str]
) -> list[CandidateScore]:
    """Score all models, and fit the strongest on until no other comes near; updates `models` and `refined`."""
    scores = _score(context, models, base)
    share = SEARCH.refined_share if refined else SEARCH.first_refined_share
    while names := _refinement_candidates(scores, share, refined):
        models |= dict(zip(names, context.pool.refine_fits([models[name] for name in names]), strict=True))
        scores = _score(context, models, base)
        share = SEARCH.refined_share
        refined |= set(names)
    return scores


def _refinement_candidates(scores: Sequence[CandidateScore], share: float, refined: set[str]) -> list[str]:
    """The next candidates to be fitted on: those with a share of the best one's evidence, and the best one in any case.

    After one step of its fit the best one is still a little off, and an error that is the same in every row counts as
    noise, in which nothing has evidence.
    """
    relevant = sorted((score for score in scores if score.is_relevant), key=lambda score: -score.evidence)
    if not relevant:
        return []
    best = relevant[0]
    least = max(share * best.evidence, MIN_EVIDENCE_NATS)
    names = [
        score.name for score in relevant if (score is best or score.evidence > least) and score.name not in refined
    ]
    return names[: SEARCH.refined_at_once]


def _improved_fits(
    models: Mapping[str, FitSummary], refits: Mapping[str, FitSummary], best: FitSummary, blocks: Array
) -> dict[str, FitSummary]:
    """Those of the models fitted again that explain more than before, by the noise that the best one leaves.

    With the noise of a base that lacks a constant force, no grid finds its cause: the error is the same in every row.
    """
    rows = correlation_rows_by_target(best.fit)
    evidence = {
        name: [log_evidence(with_correlation_rows(model.fit, rows), blocks) for model in (models[name], refit)]
        for name, refit in refits.items()
    }
    return {name: refits[name] for name, (before, after) in evidence.items() if after > before}


def _score(context: SearchContext, models: Mapping[str, FitSummary], base: FitSummary) -> list[CandidateScore]:
    problem = context.problem
    against = Comparison(
        base=base,
        recalibrated=problem.recalibrated,
        signal_scales=problem.signal_scales,
        blocks=context.blocks,
        broken=problem.broken_targets,
        within_baseline=problem.targets_within_baseline,
    )
    return score_candidates(models, against)


def _score_beside_others(context: SearchContext, step: CandidateScore) -> CandidateScore:
    """Score a step against its own model without its effect, fitted on from there.

    So what the fit gains for the other effects does not count for this one.
    """
    rest = context.pool.fit_without_effects(step.model, [step.name])[step.name]
    return _score(context, {step.name: step.model}, rest)[0]


def _score_in_place(context: SearchContext, steps: list[CandidateScore], step: CandidateScore) -> SelectedSteps:
    """Score one of several steps among all other candidates, beside the rest of the steps."""
    last = steps[-1].model
    rest = context.pool.fit_without_effects(last, [step.name])[step.name]
    selected = {other.name for other in steps}
    names = [candidate.name for candidate in context.problem.candidates if candidate.name not in selected]
    scores = fit_and_score(context, names, rest, {step.name: last})
    score = next(score for score in scores if score.name == step.name)
    equal = [scores[0].name, *find_equivalents(scores, context.blocks)] if scores[0].is_accepted else []
    beside = tuple(other.name for other in steps if other.name != step.name)
    rejected = rejected_reasons(scores, (*equal, step.name), RejectionStage.SETTLING, beside)
    unfitted = context.pool.unfitted_beside(rest)
    settled = _with_equivalents(score, [name for name in equal if name != step.name], scores)
    return SelectedSteps([settled], (*unfitted, *rejected))


def _with_equivalents(score: CandidateScore, names: Sequence[str], scores: Sequence[CandidateScore]) -> CandidateScore:
    """A score with its equivalents, and the evidence of all candidates that were tried in its place."""
    return score._replace(equivalents=tuple(names), evidence_in_place={other.name: other.evidence for other in scores})
