"""The thresholds of the selection, and the criteria that a candidate's score fails.

A name needs evidence and the agreement of the blocks, and has to explain enough of a signal: with enough rows anything
is significant. After each threshold stands the commit of the exam that first ran with it (docs/results/);
where there is none, it is derived. docs/results/criteria.md lists them all.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from tunefree_hil.gap.estimation.evidence import MIN_EVIDENCE_NATS, PairedComparison
from tunefree_hil.gap.selection.reasons import Criterion, Reason
from tunefree_hil.gap.workers.worker import FitSummary

NO_NUMBERS: Mapping[str, float] = {}
OF_OTHER_SIGNALS = (Criterion.DEGRADATION, Criterion.BROKEN_DEGRADATION)


class SelectionCriteria(NamedTuple):
    """Thresholds for naming one effect. Evidence and gains in nats, the others as shares (1 is all of it)."""

    # Evidence over the base model, and cross-validated gain. A likelihood ratio of 400.
    min_evidence_nats: float = MIN_EVIDENCE_NATS
    # Evidence above what a model mismatch reaches: 6 nats on clean logs of development (n = 47), 28 on clean cars of
    # the exam of fb4a7b1 (n = 300). e315ffe
    plain_evidence_nats: float = 60.0
    # A further effect: gain over its deviation between blocks. Less is noise of the first effect's fit. 206fe92
    min_gain_noise_ratio: float = 3.0
    # RMS explained, of the signal. Less does not matter to a simulation. 206fe92
    min_explained_share: float = 0.004
    # Share of its signal's error that a first effect removes. Less is not worth a repair. 206fe92
    min_error_reduction: float = 0.05
    # The same of a further effect: what the misfit of the first one's form leaves is less. 206fe92
    min_further_error_reduction: float = 0.1
    # The same where no link is broken: a real effect explains most of the error, a mismatch a part. a34517a
    plain_error_reduction: float = 0.4
    # Lower 95 % bound over blocks, as a share of the reduction required. 206fe92
    min_bound_share: float = 0.5
    # Instead of that bound: the reduction without the best block. What two blocks show clearly is no chance. 206fe92
    min_other_blocks_reduction: float = 0.3
    # Reduction from which on a single block is enough: a stop that one manoeuvre reaches. a34517a
    full_error_reduction: float = 0.95
    # Growth of another signal's mean square error. 206fe92
    max_degradation: float = 0.05
    # The same where the candidate surely removes nearly all of its own error and the other link is not broken. 41825b8
    max_degradation_if_nearly_full: float = 0.2
    # Lower 95 % bound of the reduction from which on that is so. 41825b8
    nearly_full_reduction: float = 0.9
    # The same of a signal that the model misses on its calibration logs too: the plant's form is off. 6ac729d
    max_baseline_degradation: float = 0.5
    # Growth below this share of what the candidate explains does not count: recalibration trades as much. 206fe92
    min_degradation_share: float = 0.1
    # Factor on all thresholds for a borderline candidate: no name, but an equivalent. 206fe92
    borderline_scale: float = 0.8
    # Squared change of a target by an effect that moves it, in variances of its noise: one.
    min_affected_squares: float = 1.0
    # RMS error of a target, of the best candidate's: a candidate with less gives the target's noise. d0a8c99
    noise_source_share: float = 0.5


class EquivalenceCriteria(NamedTuple):
    """Thresholds for calling two candidates indistinguishable; shares, but for `min_weak_set_nats`."""

    # Reduction of the best candidate's signal, of the best one's own. Less is an effect on another signal. d0a8c99
    min_shared_reduction: float = 0.25
    # Lead in gain, of the best one's gain. No model is more exact than that. 206fe92
    close_gain_share: float = 0.03
    # Excitation score below which effects that are easily confused are equivalents: half of what is needed. 206fe92
    low_excitation_score: float = 0.5
    # Evidence that such an effect needs, of the named one's. 206fe92
    confused_evidence_share: float = 0.7
    # Evidence of a set of weak candidates, nats; no holdout can confirm a set. Three times the least. e315ffe
    min_weak_set_nats: float = 3.0 * MIN_EVIDENCE_NATS


class RejectionCriteria(NamedTuple):
    """Thresholds for rejecting effects that were selected; shares, but for `cancellation_sigmas`."""

    # Of what could be explained of a signal before, what may be left. 206fe92
    max_unexplained_share: float = 0.25
    # Of what the effects explain of a signal, what a parameter that differs between blocks may move of it. 206fe92
    max_moved_share: float = 0.25
    # What is left of an effect of the calibration and one that cancels it: at most so many deviations. d0a8c99
    cancellation_sigmas: float = 3.0
    # The same as a share of the calibration's: its form is not quite the car's. d0a8c99
    cancellation_share: float = 0.1


class BaselineCriteria(NamedTuple):
    """Thresholds for what a model misses on its own calibration logs."""

    # Misfit over that on the calibration logs which is still the same: another drive shakes more, or less. e404040
    max_misfit_factor: float = 2.0
    # Deviations from neutral that the calibration logs may leave open, the effect being taken as known. 6ac729d
    known_sigmas: float = 2.0
    # Deviations of both values together from which on an effect has another value than then. d0a8c99
    new_value_sigmas: float = 4.0


class GradeCriteria(NamedTuple):
    """Thresholds for a hill that a calibration took for rolling resistance."""

    # Standard deviation of the logarithm of a rolling resistance, over tyres and roads of one kind of car. e404040
    rolling_log_sigma: float = 0.35
    # Log likelihood by which a rolling resistance excludes a hill, nats: a ratio of 7.
    min_exclusion_nats: float = 2.0
    # Share of an offset by which it may differ from one log to the next and be the same hill. e404040
    same_offset_share: float = 0.1


class SearchLimits(NamedTuple):
    """Effort of the search; no candidate is rejected by these."""

    max_effects: int = 3  # no further one is looked for
    refined_at_once: int = 4  # candidates that are fitted on together before they are compared
    first_refined_share: float = 0.5  # of the best one's evidence, from which on a candidate is fitted on
    refined_share: float = 0.8  # the same once the best ones are fitted on


CRITERIA, EQUIVALENCE, REJECTION = SelectionCriteria(), EquivalenceCriteria(), RejectionCriteria()
BASELINE, GRADE_CRITERIA, SEARCH = BaselineCriteria(), GradeCriteria(), SearchLimits()


class Reduction(NamedTuple):
    """Share of an error that is removed, with its 95 % interval over blocks."""

    value: float
    low: float
    high: float


class CandidateScore(NamedTuple):
    """A candidate effect scored against the model that it was added to.

    Args:
        evidence: log evidence over that base model, nats.
        gain: cross-validated log likelihood over it, nats.
        target: the signal where it reduces the error most clearly.
        error_reduction: share of the recalibrated error there that it removes.
        degradation, broken_degradation: largest growth of another signal's mean square error, as a share; the second
            of signals whose link is broken.
        is_relevant: it moves a signal, and explains `min_explained_share` of it.
        is_further: the base model has other candidates in it.
        other_blocks_reduction: the error reduction without the block that gains most.
        equivalents: names that explain as much in its place; known once the search is done.
        evidence_in_place: evidence of all candidates that were tried there, this one included.
        is_unbroken: recalibration alone leaves the target's link unbroken.
        error_reductions: the reduction by target.
        explained_share: RMS explained of the target, as a share of the signal.
    """

    name: str
    model: FitSummary
    evidence: float
    gain: PairedComparison
    target: str
    error_reduction: Reduction
    degradation: float
    is_relevant: bool
    is_further: bool = False
    other_blocks_reduction: float = 0.0
    equivalents: tuple[str, ...] = ()
    evidence_in_place: Mapping[str, float] = NO_NUMBERS
    is_unbroken: bool = False
    broken_degradation: float = 0.0
    error_reductions: Mapping[str, float] = NO_NUMBERS
    explained_share: float = 0.0

    @property
    def is_accepted(self) -> bool:
        """Whether it may be named."""
        return not failed_criteria(self)

    @property
    def is_borderline(self) -> bool:
        """Whether it may be named, or fails by at most a fifth; then it may be an equivalent, though not a name."""
        return not failed_criteria(self, scale=CRITERIA.borderline_scale)

    @property
    def is_weak(self) -> bool:
        """Whether only the holdout blocks can confirm it: its link is not broken, and it explains a part of the error,
        with little evidence, as some candidate does of any mismatch.
        """
        return (
            self.is_unbroken
            and self.error_reduction.value < CRITERIA.plain_error_reduction
            and self.evidence < CRITERIA.plain_evidence_nats
        )

    @property
    def degrades_others(self) -> bool:
        """Whether its evidence is plain, and it fails only by the signals that it degrades, as each of two effects that
        hide each other does alone.
        """
        is_plain = (
            self.evidence > CRITERIA.plain_evidence_nats and self.error_reduction.value > CRITERIA.plain_error_reduction
        )
        harmless = self._replace(degradation=0.0, broken_degradation=0.0)
        return is_plain and not self.is_accepted and harmless.is_accepted

    @property
    def explains_all(self) -> bool:
        """Whether it removes all of a broken link's error: one block is enough then."""
        return not self.is_unbroken and self.error_reduction.value > CRITERIA.full_error_reduction


def failed_criteria(
    score: CandidateScore, criteria: SelectionCriteria = CRITERIA, scale: float = 1.0
) -> tuple[Criterion, ...]:
    """The criteria that a score fails; empty where it may be named.

    Args:
        scale: factor on every threshold; below 1 it is easier to pass.
    """
    return tuple(reason.criterion for reason in failed_reasons(score, criteria, scale))


def failed_reasons(
    score: CandidateScore, criteria: SelectionCriteria = CRITERIA, scale: float = 1.0
) -> tuple[Reason, ...]:
    """The same with the numbers compared. A number that is NaN fails."""
    c, reduction = criteria, _required_reduction(score, criteria)
    least = scale * c.min_evidence_nats
    evidence = scale * c.plain_evidence_nats if score.is_further else least
    value, bound = score.error_reduction.value, score.error_reduction.low
    bound_limit, other_limit = scale * c.min_bound_share * reduction, scale * c.min_other_blocks_reduction
    in_blocks = bound > bound_limit or score.other_blocks_reduction > other_limit or score.explains_all
    is_nearly_full = bound > c.nearly_full_reduction
    growth = (c.max_degradation_if_nearly_full if is_nearly_full else c.max_degradation) / scale
    noise = scale * c.min_gain_noise_ratio * score.gain.std
    compared = [
        (Criterion.EVIDENCE, score.evidence > evidence, score.evidence, evidence),
        (Criterion.PREDICTIVE_GAIN, score.gain.total > least, score.gain.total, least),
        (Criterion.PREDICTIVE_GAIN_BOUND, score.gain.low > 0.0, score.gain.low, 0.0),
        (
            Criterion.GAIN_NOISE,
            not score.is_further or score.explains_all or score.gain.total > noise,
            score.gain.total,
            noise,
        ),
        (Criterion.EXPLAINED_SHARE, score.is_relevant, score.explained_share, c.min_explained_share),
        (Criterion.ERROR_REDUCTION, value > scale * reduction, value, scale * reduction),
        (Criterion.SINGLE_BLOCK, in_blocks, bound, bound_limit),
        (Criterion.DEGRADATION, score.degradation < growth, score.degradation, growth),
        (
            Criterion.BROKEN_DEGRADATION,
            score.broken_degradation < c.max_degradation / scale,
            score.broken_degradation,
            c.max_degradation / scale,
        ),
    ]
    return tuple(
        Reason(criterion, score.name, number, limit, key="" if criterion in OF_OTHER_SIGNALS else score.target)
        for criterion, has_passed, number, limit in compared
        if not has_passed
    )


def _required_reduction(score: CandidateScore, c: SelectionCriteria) -> float:
    """Share of the error that a candidate has to remove: more beside another, as any mismatch has a candidate."""
    if not score.is_further:
        return c.min_error_reduction
    return c.plain_error_reduction if score.is_unbroken else c.min_further_error_reduction
