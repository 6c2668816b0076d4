"""The stepwise search over effects, and the search again without those that are not new.

Forward: the best accepted candidate is added, and all others are scored beside it. Backward: an effect that is no
longer accepted beside the later ones is taken out. Settle: each effect that stays is compared with all candidates in
its place; those that explain as much are its equivalents. Models are refined before they are compared: else what the
fit gains for the other effects would count for the candidate.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Mapping, Sequence

import numpy as np

from tunefree_hil.gap.estimation.evidence import (
    MIN_EVIDENCE_NATS,
    correlation_rows_by_target,
    log_evidence,
    with_correlation_rows,
)
from tunefree_hil.gap.progress import SearchProgress, SearchStage
from tunefree_hil.gap.selection.baseline_misfit import BaselineMisfit
from tunefree_hil.gap.selection.criteria import CRITERIA, SEARCH, CandidateScore
from tunefree_hil.gap.selection.equivalence import find_better_rejected, find_equivalents
from tunefree_hil.gap.selection.model_misfit import ModelMisfit, SearchContext
from tunefree_hil.gap.selection.reasons import Reason
from tunefree_hil.gap.selection.rejection import SelectionOutcome, reject_effects
from tunefree_hil.gap.selection.scoring import Comparison, score_candidates
from tunefree_hil.gap.workers.worker import FitSummary, OpenProblem

Array = np.ndarray


def select_effects(
    context: SearchContext, scores: list[CandidateScore], recalibrated: ModelMisfit, baseline: BaselineMisfit
) -> Generator[SearchProgress, None, tuple[list[CandidateScore], SelectionOutcome]]:
    """Repeat the search, each time without effects that the calibration logs had as well, until none of these is found:
    an effect that is not new must not hide a new one.

    Args:
        scores: every candidate scored alone.
        recalibrated: what the model without effects leaves.

    Returns:
        the candidates scored alone in the last round, and its outcome.
    """
    known_names, known = set[str](), tuple[Reason, ...]()
    while True:
        remaining = context._replace(problem=_without_candidates(context.problem, known_names))
        alone = [score for score in scores if score.name not in known_names]
        added = yield from search_forward(remaining, alone)
        steps = yield from search_backward(remaining, added)
        steps, alone = yield from settle_steps(remaining, alone, steps, shortened=len(steps) < len(added))
        yield SearchProgress(SearchStage.REMAINDER, "what is left unexplained")
        outcome = reject_effects(remaining, steps, alone, recalibrated, baseline)
        known += outcome.known
        if not outcome.known_names:
            return alone, outcome._replace(known=known)
        known_names |= set(outcome.known_names)


def _without_candidates(problem: OpenProblem, names: Collection[str]) -> OpenProblem:
    return problem._replace(candidates=tuple(c for c in problem.candidates if c.name not in names))


def search_forward(
    context: SearchContext, alone: list[CandidateScore]
) -> Generator[SearchProgress, None, list[CandidateScore]]:
    """Add one effect after another, each scored beside those before it and fitted with them."""
    first = _first_step(alone)
    if first is None:
        return []
    steps = [first]
    while len(steps) < SEARCH.max_effects:
        selected = {step.name for step in steps}
        names = [candidate.name for candidate in context.problem.candidates if candidate.name not in selected]
        yield SearchProgress(
            SearchStage.FURTHER_EFFECTS, f"further effects beside {', '.join(step.name for step in steps)}"
        )
        scores = fit_and_score(context, names, steps[-1].model)
        if not scores or not scores[0].is_accepted or find_better_rejected(scores):
            break
        score = _score_beside_others(context, scores[0])
        if not score.is_accepted:
            break
        steps.append(_with_equivalents(score, find_equivalents(scores, context.blocks), scores))
    return steps if first.is_accepted or len(steps) > 1 else []


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
) -> Generator[SearchProgress, None, list[CandidateScore]]:
    """Take out effects that are no longer accepted beside those found later."""
    if len(steps) < 2:
        return steps
    yield SearchProgress(SearchStage.ELIMINATION, "each effect without the others")
    last, stay = steps[-1].model, steps
    for name in [step.name for step in steps]:
        # The newest was accepted beside all the others
        if len(stay) == 1 or (name == steps[-1].name and len(stay) == len(steps)):
            break
        rest = context.pool.fit_without_effects(last, [name])[name]
        if not _score(context, {name: last}, rest)[0].is_accepted:
            last, stay = rest, [step for step in stay if step.name != name]
    return [*stay[:-1], stay[-1]._replace(model=last)]


def settle_steps(
    context: SearchContext, alone: list[CandidateScore], steps: list[CandidateScore], shortened: bool = False
) -> Generator[SearchProgress, None, tuple[list[CandidateScore], list[CandidateScore]]]:
    """Find the equivalents of each effect; a single one is scored again, and the best candidate takes its place.

    Args:
        alone: every candidate scored alone.
        shortened: an effect was taken out, so that the equivalents of the newest have to be found again.

    Returns:
        the effects with their equivalents; the candidates scored alone, a single effect with its last model.
    """
    if not steps:
        return [], alone
    if len(steps) == 1:
        if alone[0].name != steps[0].name:
            models = {score.name: score.model for score in alone} | {steps[0].name: steps[0].model}
            alone = _score(context, models, context.problem.recalibrated)
        if not alone[0].is_accepted or find_better_rejected(alone):
            return [], alone
        return [_with_equivalents(alone[0], find_equivalents(alone, context.blocks), alone)], alone
    settled, last = [], steps[-1].model
    for step in steps if shortened else steps[:-1]:
        yield SearchProgress(SearchStage.ELIMINATION, f"each candidate in the place of {step.name}")
        settled.append(_score_in_place(context, steps, step))
    settled += steps[len(settled) :]
    return [*settled[:-1], settled[-1]._replace(model=last)], alone


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


def _score_in_place(context: SearchContext, steps: list[CandidateScore], step: CandidateScore) -> CandidateScore:
    """Score one of several steps among all other candidates, beside the rest of the steps."""
    last = steps[-1].model
    rest = context.pool.fit_without_effects(last, [step.name])[step.name]
    selected = {other.name for other in steps}
    names = [candidate.name for candidate in context.problem.candidates if candidate.name not in selected]
    scores = fit_and_score(context, names, rest, {step.name: last})
    score = next(score for score in scores if score.name == step.name)
    equal = [scores[0].name, *find_equivalents(scores, context.blocks)] if scores[0].is_accepted else []
    return _with_equivalents(score, [name for name in equal if name != step.name], scores)


def _with_equivalents(score: CandidateScore, names: Sequence[str], scores: Sequence[CandidateScore]) -> CandidateScore:
    """A score with its equivalents, and the evidence of all candidates that were tried in its place."""
    return score._replace(equivalents=tuple(names), evidence_in_place={other.name: other.evidence for other in scores})
