"""The texts of an answer, made last: from the verdict's reasons and the diagnosis, and never read by a decision."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from tunefree_hil.gap.measured.excitation import Shortage
from tunefree_hil.gap.selection.reasons import NAMED, Criterion, Reason, RejectionStage, Verdict, VerdictKind

if TYPE_CHECKING:
    from tunefree_hil.gap.measured.excitation import Excitation
    from tunefree_hil.gap.pipeline import Diagnosis
    from tunefree_hil.gap.selection.baseline_misfit import BaselineMisfit


def diagnosis_texts(diagnosis: Diagnosis) -> tuple[str, ...]:
    """All texts beside the verdict, in the order of gap.json's `words`."""
    return (
        *verdict_texts(diagnosis.verdict, diagnosis.excitation),
        *(f"{name}: so small a value may come and go from day to day" for name in diagnosis.day_sized),
        *(f"{link.text} as well, and no named effect explains that" for link in diagnosis.unexplained_beside),
        *equivalent_texts(diagnosis.inseparable),
        *(reason_text(reason) for reason in diagnosis.rejected),
        *baseline_texts(diagnosis.baseline),
        *drive_difference_texts(diagnosis.drive_differences),
    )


def verdict_texts(verdict: Verdict, excitation: Mapping[str, Excitation]) -> tuple[str, ...]:
    """The reasons of a verdict. excitation: of each effect, what the logs lack to show it."""
    reasons = verdict.reasons
    if verdict.kind in NAMED:
        lacking = [f"{name}: {lack}" for name in verdict.names for lack in _shortage_texts(excitation[name])]
        return (*lacking, *(reason_text(reason) for reason in reasons))
    if verdict.kind is VerdictKind.SET:
        return tuple(_set_text(reason, excitation[reason.name]) for reason in reasons)
    texts = [reason_text(reason) for reason in reasons if reason.criterion in TEXTS]
    if verdict.has(Criterion.WEAK_SET):
        return ("; ".join(reversed(texts)),)
    return tuple(texts)


def _set_text(reason: Reason, excited: Excitation) -> str:
    if not reason.others:
        return f"{reason.name} beside them"
    why = f": {'; '.join(_shortage_texts(excited))}" if excited.shortages else ""
    return f"{reason.name} explains these logs as well as {', '.join(reason.others)}{why}"


def _shortage_texts(excited: Excitation) -> list[str]:
    return [shortage.text for shortage in excited.shortages]


def reason_text(reason: Reason) -> str:
    """One reason as a sentence; "" for a criterion that has no text."""
    make = TEXTS.get(reason.criterion)
    return make(reason) if make else ""


def _missed(reason: Reason) -> str:
    return reason.link.text if reason.link is not None else ""


def _nearest(reason: Reason) -> str:
    return f"{', '.join((reason.name, *reason.others))} comes nearest, but"


def _known(reason: Reason) -> str:
    numbers = (
        f"{key} {value:.4g}, and {before:.4g} in the model's calibration logs" for key, value, before in reason.detail
    )
    return f"{reason.name} is not new: {', '.join(numbers)}"


TEXTS: Mapping[Criterion, Callable[[Reason], str]] = {
    Criterion.UNSUPPORTED: lambda r: r.note,
    Criterion.NO_SENSOR: lambda r: f"no {r.key}: the yaw rate of the chassis is computed from its wheel speeds",
    Criterion.IMPOSSIBLE: lambda r: r.note,
    Criterion.UNMOVING: lambda r: (
        f"no value of it that a car has moves any compared signal by {r.limit:.1%} of that signal"
    ),
    Criterion.UNOBSERVABLE: lambda r: r.note,
    Criterion.NOT_EXCITED: lambda r: Shortage(r.key, r.value or 0.0, r.limit or 0.0).text,
    Criterion.LOG_WITHOUT_SPEED: lambda r: f"{r.key} holds no speed and is left out",
    Criterion.BETTER_REJECTED: lambda r: (
        f"{r.name} would explain it, but {r.others[0]} explains more and fails a criterion (docs/reference/gap.md)"
    ),
    Criterion.RESIDUAL_PEAK: lambda r: f"{_nearest(r)} {_missed(r)} all the same",
    Criterion.RESIDUAL_LEFT: lambda r: f"{_nearest(r)} leaves {r.value:.0%} of what could be explained of {r.key}",
    Criterion.LARGER_ELSEWHERE: lambda r: f"{_nearest(r)} explains less than what is left elsewhere: {_missed(r)}",
    Criterion.BLOCK_INCONSISTENCY: lambda r: (
        f"{_nearest(r)} the value of {r.key} differs by {r.value:.0%} of itself from block to block"
    ),
    Criterion.KNOWN_TO_CALIBRATION: _known,
    Criterion.UNTESTED_IN_CALIBRATION: lambda r: (
        f"{r.name} is not new: the model's calibration logs could not have shown it, and the model misses those as well"
    ),
    Criterion.DEPENDENT: lambda r: f"{r.name} shows only beside {' and '.join(r.others)}, which is not new",
    Criterion.ABSORBED_BY_CALIBRATION: lambda r: (
        f"{r.name} of the model goes: its calibration had put it in for {' and '.join(r.others)}"
    ),
    Criterion.WEAK_SET: lambda r: (
        f"{', '.join((r.name, *r.others))} would each explain a part of what a calibrated model may miss"
    ),
    Criterion.WEAK: lambda r: f"{r.name}: its link is not broken, and only the holdout blocks can confirm it",
    Criterion.FRAMES_CHANGED: lambda r: (
        f"{r.value:.1%} of the {r.key} commands echoed were not sent at that time: frames are lost or changed"
    ),
    Criterion.UNEXPLAINED: lambda r: f"{_missed(r)}, and no effect explains it",
    Criterion.WITHIN_BASELINE: lambda r: f"{_missed(r)}, as usual with this model",
    Criterion.RECALIBRATION_INCONSISTENCY: lambda r: (
        f"{r.key} would have to be recalibrated to another value in each block, by {r.value:.1f} standard deviations, "
        "and no effect explains that"
    ),
    Criterion.NOTHING_BROKEN: lambda _: "nothing beyond noise and recalibration",
}


def candidate_text(reason: Reason) -> str:
    """Why a search does not name a candidate, with the effects beside it; a number that is not known is '?'."""
    make = SCORE_TEXTS.get(reason.criterion)
    text = make(reason, _figure(reason.value), _figure(reason.limit)) if make else reason_text(reason)
    text = text or reason.criterion.value.replace("_", " ")
    where = STAGE_TEXTS[reason.stage] if reason.stage else ""
    beside = f"beside {' and '.join(reason.beside)}" if reason.beside else ""
    return f"{' '.join(part for part in (reason.name, where, beside) if part)}: {text}"


def _figure(number: float | None) -> str:
    return "?" if number is None else f"{number:.3g}"


STAGE_TEXTS: Mapping[RejectionStage, str] = {
    RejectionStage.UNTESTABLE: "cannot be tested",
    RejectionStage.SCREENING: "is not fitted",
    RejectionStage.SCAN: "alone",
    RejectionStage.FORWARD: "added",
    RejectionStage.BACKWARD: "taken out again",
    RejectionStage.SETTLING: "in the place of another effect",
    RejectionStage.SELECTION: "is not named",
}
# Of a candidate's own score (criteria.py), and of its screening: (reason, value, limit) -> text
SCORE_TEXTS: Mapping[Criterion, Callable[[Reason, str, str], str]] = {
    Criterion.EVIDENCE: lambda _, value, limit: f"its evidence is {value} nats, more than {limit} are needed",
    Criterion.PREDICTIVE_GAIN: lambda _, value, limit: (
        f"its cross-validated gain is {value} nats, more than {limit} are needed"
    ),
    Criterion.PREDICTIVE_GAIN_BOUND: lambda _, value, limit: (
        f"its cross-validated gain may be {value} nats only, more than {limit} are needed"
    ),
    Criterion.GAIN_NOISE: lambda _, value, limit: (
        f"its cross-validated gain of {value} nats is no more than noise between blocks, {limit}"
    ),
    Criterion.EXPLAINED_SHARE: lambda r, value, limit: (
        f"it explains {value} of {r.key} as a share of the signal, more than {limit} is needed"
    ),
    Criterion.ERROR_REDUCTION: lambda r, value, limit: (
        f"it removes {value} of the error of {r.key} as a share, more than {limit} is needed"
    ),
    Criterion.SINGLE_BLOCK: lambda r, value, limit: (
        f"one block decides: it may remove {value} only of the error of {r.key} as a share, {limit} is needed"
    ),
    Criterion.DEGRADATION: lambda _, value, limit: (
        f"another signal's mean square error grows by {value} of itself, less than {limit} is allowed"
    ),
    Criterion.BROKEN_DEGRADATION: lambda _, value, limit: (
        f"the mean square error of a signal that is missed grows by {value} of itself, less than {limit} is allowed"
    ),
    Criterion.OUTSCORED: lambda r, value, limit: (
        f"its evidence is {value} nats, and that of {' and '.join(r.others)} {limit}"
    ),
    Criterion.INDISTINGUISHABLE: lambda r, _, limit: f"these logs cannot tell it from {' and '.join(r.others)}",
    Criterion.SCREENED: lambda _, value, limit: (
        f"its best grid point removes {value} squared residuals in units of the noise, more than {limit} are needed"
    ),
}


def equivalent_texts(inseparable: Mapping[str, Iterable[str]]) -> tuple[str, ...]:
    """Of each named effect, those that no log of this car separates from it."""
    return tuple(
        f"{name}: no log of this car separates it from {', '.join(names)}" for name, names in inseparable.items()
    )


def baseline_texts(baseline: BaselineMisfit) -> tuple[str, ...]:
    """A remark that the model misses its own calibration logs."""
    if not baseline.misfit:
        return ()
    name, share = max(baseline.misfit.items(), key=lambda item: item[1])
    return (f"the model misses {name} by {share:.0%} of the signal in its own calibration logs",)


def drive_difference_texts(differences: Mapping[str, float]) -> tuple[str, ...]:
    """Numbers of the day that differ between the drives, by how many standard deviations."""
    return tuple(
        f"{key} differs by {sigmas:.1f} standard deviations between the drives, but has one value for all of them "
        "here: search the drives one by one as well"
        for key, sigmas in differences.items()
    )


def few_blocks_text(n_blocks: int) -> str:
    """A remark that a short recording shows little."""
    return f"only {n_blocks} blocks were searched: what else may be missing hardly shows in so short a recording"


def lacking_text(excitation: Mapping[str, Mapping[str, Any]]) -> str:
    """What to record where no effect could have been seen. excitation: as in gap.json."""
    lacks = sorted({lack for entry in excitation.values() for lack in entry["lacks"]})
    return f"no effect of the catalogue could have shown itself; record a drive with more: {'; '.join(lacks)}"
