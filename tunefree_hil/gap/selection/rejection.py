"""Every place where the selected effects are rejected, in their order; each gives a `Reason`.

1. `split_known_effects`: the model's calibration logs had the effect already.
2. `drop_dependent_effects`: it gains nothing without an effect that is not new.
3. `find_residual_rejection`: it does not explain its own signal, or less than what is missed elsewhere.
4. `find_inconsistency_rejection`: its value differs from block to block.
5. `drop_absorbed_effects`: it only cancels an effect that the calibration put in for another cause.

Before that a candidate may fail its score (criteria.py), after it the holdout blocks may reject a name
(jobs/gap/acceptance.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.config.schema import ModelSpec
from tunefree_hil.gap.diagnostics.residual_tests import LinkResidual
from tunefree_hil.gap.estimation.evidence import MIN_EVIDENCE_NATS
from tunefree_hil.gap.estimation.intervals import CRITERIA as INTERVAL_CRITERIA
from tunefree_hil.gap.estimation.intervals import BlockInconsistency, block_inconsistency, estimates_across_blocks
from tunefree_hil.gap.estimation.least_squares import Fit
from tunefree_hil.gap.estimation.nuisance import RECALIBRATED, UNWRITTEN_EFFECTS
from tunefree_hil.gap.model.graph import load_catalogue
from tunefree_hil.gap.selection.baseline_misfit import NO_BASELINE, BaselineMisfit, Known
from tunefree_hil.gap.selection.confounding import add_grade_equivalent
from tunefree_hil.gap.selection.criteria import BASELINE, REJECTION, CandidateScore
from tunefree_hil.gap.selection.model_misfit import ModelMisfit, SearchContext, assess_model
from tunefree_hil.gap.selection.reasons import Criterion, Reason
from tunefree_hil.gap.selection.scoring import explained_targets, unexplained_share
from tunefree_hil.gap.workers import worker
from tunefree_hil.gap.workers.worker import FitSummary

Array = np.ndarray

FROM_GAP = "log"  # key in the provenance of effects that `gap` named; effects without it are the calibration's


class ExplainedTargets(NamedTuple):
    """What the selected effects explain, by target.

    Args:
        shares: of the targets that they explain, the RMS explained as a share of the signal.
        left: of every target, the share of what could be explained that is left.
    """

    shares: Mapping[str, float]
    left: Mapping[str, float]


class EffectSplit(NamedTuple):
    """Effects that stay, and why the others, or some that stay all the same, are rejected."""

    effects: list[CandidateScore]
    reasons: tuple[Reason, ...] = ()


class SelectionOutcome(NamedTuple):
    """A search's result after all rejections.

    Args:
        new_effects: the effects that may be named, each with its equivalents.
        repaired: the model with them.
        misfit: what that model leaves.
        links_with_all_steps: every target, with all effects of the search in the model.
        rejection: why none of them is named; None where they may be.
        dropped: why single effects were dropped.
        known: why effects are not new.
        known_names: the effects that were left out because they are not new.
        rejected_candidates: why the search did not take, or took out, other candidates.
    """

    new_effects: list[CandidateScore]
    repaired: FitSummary
    misfit: ModelMisfit
    links_with_all_steps: list[LinkResidual]
    rejection: Reason | None
    dropped: tuple[Reason, ...]
    known: tuple[Reason, ...] = ()
    known_names: tuple[str, ...] = ()
    rejected_candidates: tuple[Reason, ...] = ()


def reject_effects(
    context: SearchContext,
    steps: Sequence[CandidateScore],
    alone: Sequence[CandidateScore],
    recalibrated: ModelMisfit,
    baseline: BaselineMisfit,
) -> SelectionOutcome:
    """Reject effects of a search that are not new or do not explain what is missing.

    Args:
        steps: the effects of the search, in its order.
        alone: every candidate scored alone.
        recalibrated: what the model without effects leaves.
    """
    pool, problem, blocks = context
    model = pool.spec.model
    repaired = steps[-1].model if steps else problem.recalibrated
    misfit = assess_model(pool, problem, repaired, blocks) if steps else recalibrated
    links = misfit.links
    is_all_explained = any(link.is_broken for link in recalibrated.links) and not any(link.is_broken for link in links)
    effects, known = split_known_effects(steps, repaired.fit, baseline, blocks, explained=is_all_explained)
    known_names = tuple(step.name for step in steps if step not in effects)
    effects, dependent = drop_dependent_effects(effects, steps, alone)
    effects = add_grade_equivalent(effects, repaired.fit, baseline, model)
    rejection = None
    if effects:
        explained = _assess_explained(context, repaired, recalibrated, misfit)
        rejection = find_residual_rejection(recalibrated.links, links, explained, baseline)
        if rejection is None:
            rejection = _find_inconsistency(context, effects, repaired, inconsistency_limits(links, explained.shares))
        rejection = None if rejection is None else name_all(rejection, effects)
    if len(effects) < len(steps):
        repaired = _fit_without_dropped(context, repaired, steps, effects)
        misfit = assess_model(pool, problem, repaired, blocks)
    effects, absorbed = drop_absorbed_effects(effects, alone, repaired.fit, model, blocks)
    return SelectionOutcome(effects, repaired, misfit, links, rejection, (*absorbed, *dependent), known, known_names)


def _assess_explained(
    context: SearchContext, repaired: FitSummary, before: ModelMisfit, after: ModelMisfit
) -> ExplainedTargets:
    """What the effects in a model explain, and what they leave."""
    problem = context.problem
    shares = explained_targets(problem.recalibrated, repaired, problem.signal_scales, context.blocks)
    left = {name: unexplained_share(before.lack_of_fit[name], fit) for name, fit in after.lack_of_fit.items()}
    return ExplainedTargets(shares, left)


def _find_inconsistency(
    context: SearchContext, steps: Sequence[CandidateScore], repaired: FitSummary, limits: Mapping[str, float]
) -> Reason | None:
    """`find_inconsistency_rejection`, with what a parameter moves simulated in the processes."""
    pool, problem, blocks = context

    def moved_shares(key: str, std_u: float) -> dict[str, float]:
        moved = pool.call(worker.measure_sensitivity, repaired.fit, key, std_u)
        return {target: rms / problem.signal_scales[target] for target, rms in moved.items()}

    drives = problem.blocks.drives[blocks]
    inconsistencies = {step.name: block_inconsistency(repaired.fit, step.name, blocks, drives) for step in steps}
    return find_inconsistency_rejection(inconsistencies, limits, moved_shares)


def name_all(reason: Reason, steps: Sequence[CandidateScore]) -> Reason:
    """A reason against all effects of a search at once."""
    return reason._replace(name=steps[0].name, others=tuple(step.name for step in steps[1:]))


def _fit_without_dropped(
    context: SearchContext,
    model: FitSummary,
    steps: Sequence[CandidateScore],
    stay: Sequence[CandidateScore],
) -> FitSummary:
    """A model without those of its effects that do not stay, the rest fitted on."""
    if not stay:
        return context.problem.recalibrated
    names = {step.name for step in stay}
    for step in steps:
        if step.name not in names:
            model = context.pool.fit_without_effects(model, [step.name])[step.name]
    return model


def split_known_effects(
    steps: Sequence[CandidateScore], model: Fit, baseline: BaselineMisfit, blocks: Array, *, explained: bool = False
) -> EffectSplit:
    """Drop effects that the model's calibration logs had as well, where the model misses those logs.

    An effect on a signal that the model does not miss there is new, unless those logs clearly had as much of it.

    Args:
        model: the fit with all effects.
        explained: nothing is broken with them. Then they stay, with the reason.
    """
    if not baseline.broken:
        return EffectSplit(list(steps))
    values, stay, reasons = estimates_across_blocks(model, blocks), list[CandidateScore](), list[Reason]()
    for step in steps:
        may_be_known = step.target in baseline.broken or _had_effect(step.name, baseline)
        reason = _known_reason(step.name, values, baseline) if may_be_known else None
        if reason is not None:
            reasons.append(reason)
        if explained or reason is None:
            stay.append(step)
    return EffectSplit(stay, tuple(reasons))


def _had_effect(name: str, baseline: BaselineMisfit) -> bool:
    """Whether a parameter of the effect was off neutral in the calibration logs; limits, whose neutral value is
    infinite, are not compared.
    """
    neutral, known = load_catalogue()[name].neutral, baseline.effects.get(name, {})
    finite = {key: estimate for key, estimate in known.items() if math.isfinite(neutral[key])}
    return any(abs(value - neutral[key]) > BASELINE.known_sigmas * sigma for key, (value, sigma) in finite.items())


def _known_reason(name: str, values: Mapping[str, Known], baseline: BaselineMisfit) -> Reason | None:
    """Why an effect is not new; None where one of its values differs from that in the calibration logs."""
    compared: list[tuple[str, float, float]] = []
    distance = 0.0
    for key, (value, sigma) in values.items():
        owner, _, parameter = key.partition(".")
        if owner != name:
            continue
        known = baseline.effects.get(name, {}).get(parameter)
        if known is None:
            return Reason(Criterion.UNTESTED_IN_CALIBRATION, name)
        before, known_sigma = known
        if abs(value - before) > BASELINE.new_value_sigmas * math.hypot(sigma, known_sigma):
            return None
        compared.append((parameter, value, before))
        both = math.hypot(sigma, known_sigma)
        distance = max(distance, abs(value - before) / both if both > 0.0 else 0.0)
    if not compared:
        return None
    detail = tuple(compared)
    return Reason(Criterion.KNOWN_TO_CALIBRATION, name, distance, BASELINE.new_value_sigmas, detail=detail)


def drop_dependent_effects(
    effects: Sequence[CandidateScore], steps: Sequence[CandidateScore], alone: Sequence[CandidateScore]
) -> EffectSplit:
    """Drop all effects if some steps are not new and none of the others gains anything without those.

    What is not new is not put into the model, so the others would change nothing.

    Args:
        alone: every candidate scored alone.
    """
    names = {step.name for step in effects}
    left_out = tuple(step.name for step in steps if step.name not in names)
    evidence = {score.name: score.evidence for score in alone}
    gains_alone = any(evidence.get(step.name, math.inf) > MIN_EVIDENCE_NATS for step in effects)
    if not (effects and left_out) or gains_alone:
        return EffectSplit(list(effects))
    return EffectSplit(
        [],
        tuple(
            Reason(Criterion.DEPENDENT, step.name, evidence[step.name], MIN_EVIDENCE_NATS, others=left_out)
            for step in effects
        ),
    )


def find_residual_rejection(
    before: Sequence[LinkResidual],
    after: Sequence[LinkResidual],
    explained: ExplainedTargets,
    baseline: BaselineMisfit = NO_BASELINE,
) -> Reason | None:
    """Why effects do not explain what is missing; None where they do.

    They have to explain the signals that they work on, and more than what is missed elsewhere. What the model misses
    within its baseline does not count.

    Args:
        before, after: every target without the effects and with them.
    """
    links_before = {link.signal: link for link in before}
    largest = max(explained.shares.values(), default=0.0)
    for link in after:
        if baseline.is_within(link):
            continue
        excess, signal = baseline.excess_over(link), link.signal
        if signal not in explained.shares:
            if link.is_broken and not baseline.is_known(link) and excess.misfit_share > largest:
                return Reason(
                    Criterion.LARGER_ELSEWHERE, value=excess.misfit_share, limit=largest, key=signal, link=excess
                )
        elif _is_peak_left(link, links_before[signal], baseline):
            return Reason(Criterion.RESIDUAL_PEAK, value=excess.misfit_share, key=signal, link=excess)
        elif (
            link.is_broken
            and link.explainable_share > link.tolerated_share
            and explained.left[signal] > REJECTION.max_unexplained_share
        ):
            left, limit = explained.left[signal], REJECTION.max_unexplained_share
            return Reason(Criterion.RESIDUAL_LEFT, value=left, limit=limit, key=signal, link=link)
    return None


def _is_peak_left(link: LinkResidual, before: LinkResidual, baseline: BaselineMisfit) -> bool:
    """Whether its bursts, or all of it whether predictable or not, are missed as before and beyond the baseline."""
    burst_limit, gross_limit = baseline.burst_limit(link.signal), baseline.gross_limit(link.signal)
    return _is_mostly_left(link.burst_share, before.burst_share, burst_limit) or _is_mostly_left(
        link.gross_share, before.gross_share, gross_limit
    )


def _is_mostly_left(share: float, before: float, limit: float) -> bool:
    """Whether more than the limit is missed of a signal, and a good part of what was missed before."""
    return share > max(limit, REJECTION.max_unexplained_share * before)


def inconsistency_limits(links: Sequence[LinkResidual], explained: Mapping[str, float]) -> dict[str, float]:
    """By target, what an inconsistent parameter may move of its signal: what a calibrated model may miss, or a part of
    what the effects explain there (the effect's form is not quite the car's).
    """
    share = REJECTION.max_moved_share
    return {link.signal: max(link.tolerated_share, share * explained.get(link.signal, 0.0)) for link in links}


def find_inconsistency_rejection(
    inconsistencies: Mapping[str, BlockInconsistency],
    limits: Mapping[str, float],
    moved_shares: Callable[[str, float], Mapping[str, float]],
) -> Reason | None:
    """Why effects are rejected: one has a parameter that is no constant over the blocks. None where all are constant.

    Args:
        inconsistencies: by effect.
        limits: by target, what the parameter may move of the signal (`inconsistency_limits`).
        moved_shares: (key, deviation in u) -> by target, the share of the signal that this moves.
    """
    limit = INTERVAL_CRITERIA.max_inconsistency_share
    for name, inconsistency in inconsistencies.items():
        if inconsistency.share > limit and any(
            share > limits[target] for target, share in moved_shares(inconsistency.key, inconsistency.std_u).items()
        ):
            return Reason(Criterion.BLOCK_INCONSISTENCY, name, inconsistency.share, limit, key=name)
    return None


def drop_absorbed_effects(
    steps: Sequence[CandidateScore], alone: Sequence[CandidateScore], fit: Fit, model: ModelSpec, blocks: Array
) -> EffectSplit:
    """Drop an effect that cancels the same effect of the model's calibration, and would be no name alone.

    A model of drives across a banked road has a steering offset for the bank. Once the bank is named, the opposite
    offset is found beside it; the model does not lack that.

    Args:
        alone: every candidate scored alone.
        fit: the fit with all steps.
    """
    calibrated, is_accepted = _calibrated_effects(model), {score.name: score.is_accepted for score in alone}
    values = estimates_across_blocks(fit, blocks)
    absorbed = [
        step
        for step in steps
        if step.name in calibrated
        and not step.equivalents
        and not is_accepted.get(step.name)
        and _cancels_out(step.name, calibrated[step.name], values)
    ]
    if not absorbed or len(absorbed) == len(steps):
        return EffectSplit(list(steps))
    stay = [step for step in steps if step not in absorbed]
    causes = tuple(step.name for step in stay)
    return EffectSplit(
        stay, tuple(Reason(Criterion.ABSORBED_BY_CALIBRATION, step.name, others=causes) for step in absorbed)
    )


def _calibrated_effects(model: ModelSpec) -> dict[str, list[Mapping[str, float]]]:
    """Parameters of the effects that a model's calibration put in, by effect."""
    calibrated: dict[str, list[Mapping[str, float]]] = {}
    for effect in model.effects:
        # What the calibration logs say of the day is in no folder (validation/repair.py, `apply_own_numbers`)
        is_of_day = effect.provenance == RECALIBRATED and effect.name in UNWRITTEN_EFFECTS
        if FROM_GAP not in effect.provenance and not is_of_day:
            calibrated.setdefault(effect.name, []).append(effect.params)
    return calibrated


def _cancels_out(name: str, calibrated: Sequence[Mapping[str, float]], values: Mapping[str, Known]) -> bool:
    """Whether the model's effects, which are not neutral, and the new one cancel."""
    sigmas, share = REJECTION.cancellation_sigmas, REJECTION.cancellation_share
    for parameter, neutral in load_catalogue()[name].neutral.items():
        if neutral not in (0.0, 1.0):  # of limits the lower one counts, and no other cancels it
            return False
        value, sigma = values[f"{name}.{parameter}"]
        numbers = [params[parameter] for params in calibrated]
        before = sum(numbers) if neutral == 0.0 else math.prod(numbers)
        rest = value + before if neutral == 0.0 else value * before - 1.0
        size = abs(before - neutral)
        if size <= sigmas * sigma or abs(rest) > max(sigmas * sigma, share * size):
            return False
    return True
