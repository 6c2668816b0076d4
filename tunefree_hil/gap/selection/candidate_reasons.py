"""Reasons of the candidates that a search does not name: what each of them fails, and where.

With the reasons of the verdict and of the dropped effects these are complete: every effect of the catalogue is named,
is in the set, or has a reason.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

from tunefree_hil.gap.estimation.candidates import indistinguishable_effects
from tunefree_hil.gap.measured.excitation import Excitation
from tunefree_hil.gap.selection.criteria import CandidateScore, failed_reasons
from tunefree_hil.gap.selection.reasons import Criterion, Reason, RejectionStage

OF_NO_EFFECT = (Criterion.NOTHING_BROKEN, Criterion.UNEXPLAINED)  # what a verdict says of the links alone


def excitation_reasons(excitation: Mapping[str, Excitation]) -> tuple[Reason, ...]:
    """What the logs lack to show an effect, by quantity."""
    return tuple(
        Reason(
            Criterion.NOT_EXCITED,
            name,
            shortage.available,
            shortage.least,
            key=shortage.quantity,
            stage=RejectionStage.UNTESTABLE,
        )
        for name, excited in excitation.items()
        for shortage in excited.shortages
    )


def in_order(reasons: Iterable[Reason]) -> tuple[Reason, ...]:
    """The reasons by stage, effects beside and name: workers finish their candidates in any order."""
    stages = (None, *RejectionStage)
    return tuple(sorted(reasons, key=lambda reason: (stages.index(reason.stage), reason.beside, reason.name)))


def score_reasons(
    scores: Iterable[CandidateScore], stage: RejectionStage, beside: tuple[str, ...] = ()
) -> tuple[Reason, ...]:
    """The criteria that candidates fail by their own scores.

    Args:
        beside: the effects in the model that they were added to.
    """
    return tuple(reason._replace(stage=stage, beside=beside) for score in scores for reason in failed_reasons(score))


def rejected_reasons(
    scores: Sequence[CandidateScore], standing: Collection[str], stage: RejectionStage, beside: tuple[str, ...] = ()
) -> tuple[Reason, ...]:
    """Why candidates are not taken: what each fails, or that the best one has more evidence.

    Args:
        scores: the best candidate first.
        standing: names that are taken, or equal to one that is.
        beside: the effects in the model that they were added to.
    """
    rejected = [score for score in scores if score.name not in standing]
    accepted = [score for score in rejected if score.is_accepted and score is not scores[0]]
    return (
        *score_reasons(rejected, stage, beside),
        *(outscored_reason(score, scores[0], stage, beside) for score in accepted),
    )


def outscored_reason(
    score: CandidateScore, best: CandidateScore, stage: RejectionStage, beside: tuple[str, ...] = ()
) -> Reason:
    """That an accepted candidate has less evidence than the best one."""
    return Reason(
        Criterion.OUTSCORED,
        score.name,
        score.evidence,
        best.evidence,
        others=(best.name,),
        stage=stage,
        beside=beside,
    )


def step_reasons(steps: Sequence[CandidateScore], reasons: Sequence[Reason]) -> tuple[Reason, ...]:
    """The reasons of a verdict that rejects all selected effects, once for each effect that it does not name.

    Args:
        steps: the effects that the search selected.
        reasons: of the verdict.
    """
    named = {reason.name for reason in reasons}
    return tuple(
        reason._replace(name=step.name, others=(), stage=RejectionStage.SELECTION)
        for reason in reasons
        for step in steps
        if step.name not in named and reason.criterion not in OF_NO_EFFECT
    )


def remaining_reasons(
    scores: Sequence[CandidateScore],
    steps: Sequence[CandidateScore],
    covered: Collection[str],
    has_lateral: bool,
) -> tuple[Reason, ...]:
    """Reasons of the candidates that pass their own scores and have no reason yet.

    Args:
        scores: every candidate scored alone, the best first.
        steps: the effects that the search selected, with all their equivalents.
        covered: names that are named, in a set, or have a reason.
        has_lateral: a drive has a lateral accelerometer, which separates some effects.
    """
    equivalent_to = {name: step.name for step in steps for name in _equivalents(step, has_lateral)}
    stage = RejectionStage.SELECTION
    best = max(scores, key=lambda score: score.evidence, default=None)
    return tuple(
        Reason(
            Criterion.INDISTINGUISHABLE, score.name, score.evidence, others=(equivalent_to[score.name],), stage=stage
        )
        if score.name in equivalent_to
        else outscored_reason(score, best, stage)
        for score in scores
        if score.name not in covered and best is not None
    )


def _equivalents(step: CandidateScore, has_lateral: bool) -> tuple[str, ...]:
    """Its equivalents in these logs, and in any log of this car."""
    return (*step.equivalents, *indistinguishable_effects(step.name, has_lateral))
