"""Which other candidates explain as much as an accepted one: effects that these logs, or any logs, cannot separate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tunefree_hil.gap.estimation.candidates import indistinguishable_effects
from tunefree_hil.gap.estimation.evidence import MIN_EVIDENCE_NATS, compare_paired, select_by_holm
from tunefree_hil.gap.measured.chain import MeasuredDrive
from tunefree_hil.gap.measured.excitation import Excitation
from tunefree_hil.gap.model.graph import load_catalogue
from tunefree_hil.gap.selection.criteria import CRITERIA, EQUIVALENCE, CandidateScore

Array = np.ndarray


def find_better_rejected(scores: Sequence[CandidateScore]) -> CandidateScore | None:
    """The candidate that explains more of the best one's signal and is not accepted; None where there is none.

    It needs 6 nats more evidence. If its blocks do not agree, it needs 6 nats more cross-validated gain as well.
    """
    best = scores[0]
    least = MIN_EVIDENCE_NATS
    beyond = [
        score
        for score in scores[1:]
        if not score.is_accepted
        and score.is_relevant
        and score.evidence > best.evidence + least
        and _shares_target(score, best)
    ]
    better = [score for score in beyond if score.gain.low > 0.0 or score.gain.total > best.gain.total + least]
    return max(better, key=lambda score: score.evidence) if better else None


def find_equivalents(scores: Sequence[CandidateScore], blocks: Array) -> list[str]:
    """Names of candidates that cannot be separated from the best one.

    These are candidates on the same signal that the blocks do not separate from it (paired test, Holm's correction);
    where no link is broken, those that explain as much with nearly the evidence; and, of candidates scored alone, those
    that explain more on no less evidence, whatever criterion they fail.
    """
    best = scores[0]
    others = [score for score in scores[1:] if score.is_borderline and _shares_target(score, best)]
    pairs = {score.name: compare_paired(best.model.fit, score.model.fit, blocks) for score in others}
    separated = select_by_holm({name: pair.p_value for name, pair in pairs.items()})
    close = EQUIVALENCE.close_gain_share * max(best.gain.total, 0.0)
    equal = {score.name for score in others if best.is_unbroken and _explains_as_much(score, best)}
    inseparable = [
        name
        for name, pair in pairs.items()
        if name not in separated or pair.total < max(MIN_EVIDENCE_NATS, close) or name in equal
    ]
    return inseparable + [score.name for score in scores[1:] if score.name not in pairs and _explains_more(score, best)]


def _shares_target(score: CandidateScore, best: CandidateScore) -> bool:
    """Whether it removes a good part of what the best one removes of the same signal."""
    reductions, target = score.error_reductions, best.target
    return (
        target not in reductions or reductions[target] > EQUIVALENCE.min_shared_reduction * best.error_reduction.value
    )


def _explains_as_much(score: CandidateScore, best: CandidateScore) -> bool:
    """Whether it explains as much of the same signal, with hardly less evidence."""
    as_much = (
        score.target == best.target
        and score.error_reduction.value > (1.0 - EQUIVALENCE.close_gain_share) * best.error_reduction.value
    )
    return as_much and best.evidence - score.evidence < CRITERIA.plain_evidence_nats


def _explains_more(score: CandidateScore, best: CandidateScore) -> bool:
    """Whether it, alone in the model, explains more of the same signal on no less evidence."""
    as_sure = score.is_relevant and not best.is_further and score.evidence >= best.evidence
    return as_sure and score.target == best.target and score.error_reduction.value > best.error_reduction.value


def add_easily_confused(
    step: CandidateScore,
    steps: Sequence[CandidateScore],
    excitation: Mapping[str, Excitation],
    drives: Sequence[MeasuredDrive],
) -> CandidateScore:
    """A step with its equivalents: one of each class that no log separates, none of the other steps.

    Where the drive hardly excites the effect, effects that are easily confused with it (`impostors` of the catalogue)
    are equivalents too, if they come near to its evidence.
    """
    has_lateral = has_lateral_acceleration(drives)
    equivalents, evidence = step.equivalents, step.evidence_in_place
    if excitation[step.name].score < EQUIVALENCE.low_excitation_score:
        least = EQUIVALENCE.confused_evidence_share * evidence.get(step.name, step.evidence)
        confused = [
            name
            for name in load_catalogue()[step.name].impostors
            if evidence.get(name, 0.0) > max(least, MIN_EVIDENCE_NATS)
        ]
        equivalents += tuple(name for name in confused if name not in equivalents)
    covered, listed = indistinguishable_effects(step.name, has_lateral) | {other.name for other in steps}, set[str]()
    for name in sorted(equivalents, key=lambda name: -evidence.get(name, 0.0)):
        if name not in covered:
            listed.add(name)
            covered |= indistinguishable_effects(name, has_lateral)
    return step._replace(equivalents=tuple(name for name in equivalents if name in listed))


def find_inseparable(names: Sequence[str], drives: Sequence[MeasuredDrive]) -> dict[str, tuple[str, ...]]:
    """Of each named effect, the effects that no log of this car separates from it and that are not named beside it."""
    has_lateral = has_lateral_acceleration(drives)
    inseparable = {name: tuple(sorted(indistinguishable_effects(name, has_lateral) - set(names))) for name in names}
    return {name: others for name, others in inseparable.items() if others}


def has_lateral_acceleration(drives: Sequence[MeasuredDrive]) -> bool:
    """Whether one of the drives has a lateral accelerometer, which separates some effects."""
    return any(drive.has_signals("report.lateral_accel_mps2") for drive in drives)
