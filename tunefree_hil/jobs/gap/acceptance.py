"""Decides on the holdout blocks whether the named effects stand, and whether a repaired model is kept.

`answer` is the content of gap.json. `gap_share` is the share of the gap that the repair closes in the holdout blocks
(value, low and high end of the 95 % interval); None where there is no gap or no block.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.gap.result import NO_LOCATION, may_be_absorbed
from tunefree_hil.gap.selection.criteria import CRITERIA
from tunefree_hil.gap.selection.reasons import Criterion, Reason, VerdictKind, reason_entry
from tunefree_hil.gap.validation.gap_closed import MIN_OPEN_GAP

NAMED = (VerdictKind.ONE.value, VerdictKind.SEVERAL.value)


class AcceptanceCriteria(NamedTuple):
    """Thresholds on the holdout blocks, all of them shares (docs/results/criteria.md)."""

    min_upper_gap_share: float = 2.0 / 3.0  # upper bound of the closed share; below, a third of the gap surely stays
    min_weak_gap_share: float = 0.3  # lower bound of the closed share, for an effect of weak evidence
    min_baseline_reduction: float = 0.8  # of the own signal's error; stands for the evidence if the model is poor
    min_repeated_share: float = 0.5  # error reduction there, of the reduction on the fitted blocks
    min_error_share: float = 0.02  # of an error or of the gap; less may be chance
    min_effect_energy: float = 0.05  # of the squared error; blocks that an effect changes by less do not show it
    min_gap_share: float = 0.01  # of the gap; no model is written for less


ACCEPTANCE = AcceptanceCriteria()


class SignalEvidence(NamedTuple):
    """Change of the signal that shows an effect best, each as a share of the error without the effect.

    Attributes:
        fit_reduction: Error reduction on the blocks that the effect was fitted on.
        holdout_reduction: Error reduction on the holdout blocks.
        holdout_energy: Squared change by the effect on the holdout blocks.
    """

    fit_reduction: float
    holdout_reduction: float
    holdout_energy: float

    @property
    def is_repeated(self) -> bool:
        """Whether the effect reduces the error on the holdout blocks about as elsewhere."""
        least = max(ACCEPTANCE.min_repeated_share * self.fit_reduction, ACCEPTANCE.min_error_share)
        return self.holdout_reduction > least


def is_confirmed(answer: Mapping[str, Any], gap_share: Mapping[str, float] | None) -> bool:
    """Whether the holdout blocks confirm the named effects: by the gap, or by the effects' own signals."""
    return closes_gap(answer, gap_share) or (gap_share is not None and _is_confirmed_by_own_signals(answer, gap_share))


def closes_gap(answer: Mapping[str, Any], gap_share: Mapping[str, float] | None) -> bool:
    """Whether the repair closes some of the gap and, within its interval, most of it; without a gap, only weak effects
    are not confirmed.

    Where no link is broken, only the effect itself shows that something is missing; then the lower bound may not be
    clearly negative. An effect of weak evidence (gap/selection/criteria.py) needs a clearly positive one.
    """
    is_weak = any(effect.get("faint") for effect in answer["effects"])
    if gap_share is None:
        return not is_weak
    if gap_share["high"] < ACCEPTANCE.min_upper_gap_share:
        return False
    if is_weak:
        return gap_share["low"] > ACCEPTANCE.min_weak_gap_share
    return gap_share["value"] > 0.0 and (has_broken_link(answer) or gap_share["low"] > -MIN_OPEN_GAP)


def _is_confirmed_by_own_signals(answer: Mapping[str, Any], gap_share: Mapping[str, float]) -> bool:
    """Whether effects of plain evidence change their own signals on the holdout blocks as they do elsewhere.

    A free run of the whole vehicle sums up everything that a model misses, so that few blocks, or one block that
    diverges, may hide what is plain from row to row. A model that misses its own calibration logs (`as_usual`) shows
    nothing in such a run: there the own signals alone decide.
    """
    signals = [_signal_evidence(effect) for effect in answer["effects"]]
    if not _has_plain_evidence(answer, gap_share) or None in signals:
        return False
    known = [signal for signal in signals if signal is not None]
    if any(signal.holdout_reduction < -ACCEPTANCE.min_error_share for signal in known):
        return False
    if answer.get("as_usual"):
        return all(signal.is_repeated for signal in known)
    if is_absent_from_holdout(answer) or max(abs(share) for share in gap_share.values()) < ACCEPTANCE.min_error_share:
        return (
            abs(gap_share["value"]) < ACCEPTANCE.min_error_share and gap_share["low"] > -ACCEPTANCE.min_weak_gap_share
        )
    return gap_share["high"] > MIN_OPEN_GAP and all(
        signal.is_repeated or signal.holdout_energy < ACCEPTANCE.min_effect_energy for signal in known
    )


def _has_plain_evidence(answer: Mapping[str, Any], gap_share: Mapping[str, float]) -> bool:
    """Whether every effect is plain by its log evidence, or, with a poor model, by nearly all of its signal's error."""
    is_poor = bool(answer.get("as_usual")) and gap_share["low"] > ACCEPTANCE.min_error_share
    return all(
        (effect.get("evidence") or 0.0) > CRITERIA.plain_evidence_nats
        or (
            is_poor
            and not effect.get("faint")
            and (effect.get("unseen_shrink") or 0.0) > ACCEPTANCE.min_baseline_reduction
        )
        for effect in answer["effects"]
    )


def _signal_evidence(effect: Mapping[str, Any]) -> SignalEvidence | None:
    """None where the holdout blocks hold nothing of the signal."""
    fit, holdout, energy = (effect.get(key) for key in ("shrink", "unseen_shrink", "unseen_stirs"))
    return None if fit is None or holdout is None or energy is None else SignalEvidence(fit, holdout, energy)


def has_broken_link(answer: Mapping[str, Any]) -> bool:
    """Whether recalibration alone leaves a link of the chain broken."""
    return any(link["broken"] for link in answer["links"])


def is_absent_from_holdout(answer: Mapping[str, Any]) -> bool:
    """Whether the holdout blocks show none of the named effects."""
    energies = [effect.get("unseen_stirs") for effect in answer["effects"]]
    return bool(energies) and all(energy is not None and energy < ACCEPTANCE.min_effect_energy for energy in energies)


def has_no_gain(answer: Mapping[str, Any]) -> bool:
    """Whether effects are named whose repair closes nothing on the holdout blocks."""
    gap_share = answer.get("explained_frac")
    return answer["verdict"] in NAMED and bool(gap_share) and gap_share["value"] < ACCEPTANCE.min_gap_share


def needs_further_drive(answer: Mapping[str, Any]) -> bool:
    """Whether there is a repaired model whose effects no holdout block shows."""
    gap_share = answer.get("explained_frac")
    is_shown = bool(gap_share) and gap_share["value"] > ACCEPTANCE.min_error_share
    return bool(answer.get("model")) and is_absent_from_holdout(answer) and not is_shown


def is_within_baseline(answer: Mapping[str, Any]) -> bool:
    """Whether no link is missed by more than on the model's calibration logs, and nothing else indicates an effect."""
    broken = {link["signal"] for link in answer["links"] if link["broken"]}
    has_reason = any(entry["criterion"] == Criterion.WITHIN_BASELINE.value for entry in answer.get("reasons", ()))
    return has_reason and bool(broken) and broken <= set(answer["as_usual"])


def rejection_reason(answer: Mapping[str, Any], gap_share: Mapping[str, float] | None) -> Reason:
    """Why the holdout blocks do not confirm the named effects."""
    if gap_share is None:
        return Reason(Criterion.NOT_MEASURED)
    if gap_share["value"] <= 0.0:
        return Reason(Criterion.GAP_NOT_CLOSED, value=gap_share["value"], limit=0.0)
    if gap_share["high"] < ACCEPTANCE.min_upper_gap_share:
        return Reason(Criterion.GAP_LEFT, value=gap_share["high"], limit=ACCEPTANCE.min_upper_gap_share)
    is_weak = any(effect.get("faint") for effect in answer["effects"])
    limit = ACCEPTANCE.min_weak_gap_share if is_weak else -MIN_OPEN_GAP
    return Reason(Criterion.GAP_UNCERTAIN, value=gap_share["low"], limit=limit)


def rejection_fields(
    answer: Mapping[str, Any], gap_share: Mapping[str, float] | None, reason: Reason, kind: str
) -> dict[str, Any]:
    """Keys of gap.json that change where the named effects are rejected; `words` is made from `reason` elsewhere.

    Args:
        answer: The answer of the search.
        gap_share: Closed share of the gap.
        reason: Of `rejection_reason`.
        kind: Kind of the model's plant.
    """
    names = [effect["name"] for effect in answer["effects"]]
    reductions = [[effect.get("shrink"), effect.get("unseen_shrink")] for effect in answer["effects"]]
    is_broken = has_broken_link(answer)
    verdict = (VerdictKind.NONE_OF_THESE if is_broken else VerdictKind.NONE_MISSING).value
    return {
        **({} if is_broken else {"where": NO_LOCATION}),
        "verdict": verdict,
        "absorbed": may_be_absorbed(verdict, kind),
        "effects": [],
        "reasons": [*(reason_entry(reason._replace(name=name)) for name in names), *answer.get("reasons", ())],
        "changes": [],
        "taken_back": {"names": names, "explained_frac": gap_share and dict(gap_share), "shrinks": reductions},
        "explained_frac": None,
        "explicable_frac": None,
        "worse": [],
    }


def holdout_misfit_fields(answer: Mapping[str, Any], missed: Mapping[str, float], kind: str) -> dict[str, Any]:
    """Keys of gap.json that change where only the holdout blocks miss more than any calibrated model does.

    What these blocks hold alone, no search could find.

    Args:
        answer: The answer so far, in which nothing is missing.
        missed: Misfit by signal, as a share of the signal.
        kind: Kind of the model's plant.

    Returns:
        The keys without `words`; `missed_in_proof` has the worst signal first.
    """
    worst = dict(sorted(missed.items(), key=lambda item: -item[1]))
    verdict = VerdictKind.NONE_OF_THESE.value
    reasons = [reason_entry(Reason(Criterion.MISSED_IN_HOLDOUT, key=key, value=share)) for key, share in worst.items()]
    return {
        "verdict": verdict,
        "absorbed": may_be_absorbed(verdict, kind),
        "missed_in_proof": worst,
        "reasons": [*reasons, *answer.get("reasons", ())],
    }
