"""Why a candidate is not named, and why a verdict is what it is: records, of which the texts are made last."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from tunefree_hil.gap.diagnostics.residual_tests import LinkResidual


class VerdictKind(Enum):
    """The result of a search. The value is the `verdict` of gap.json; NOT_SEARCHED is written as null."""

    ONE = "one"
    SEVERAL = "several"
    SET = "set"
    NONE_MISSING = "none_missing"
    NONE_OF_THESE = "none_of_these"
    CANNOT_TEST = "cannot_test"
    NOT_SEARCHED = ""


NAMED = (VerdictKind.ONE, VerdictKind.SEVERAL)


class RejectionStage(Enum):
    """Where a search rejects a candidate. The value is the `stage` of gap.json's `reasons`."""

    UNTESTABLE = "untestable"  # before the search: the model, the vehicle or these logs cannot show it
    SCREENING = "screening"  # its grid points, before it is fitted
    SCAN = "scan"  # alone, over the recalibrated model
    FORWARD = "forward"  # added to the effects in `beside`
    BACKWARD = "backward"  # selected before, and scored again with the effects in `beside`
    SETTLING = "settling"  # in the place of a selected effect, with the others of them in `beside`
    SELECTION = "selection"  # after the search: rejected together with another effect, or less likely than one


class Criterion(Enum):
    """What a candidate, a set, or a whole search failed. The value is the `criterion` of gap.json's `reasons`."""

    # Before the search (measured/, estimation/candidates.py, workers/pool.py)
    UNSUPPORTED = "unsupported"  # the model's plant or the vehicle cannot have it
    NO_SENSOR = "no_sensor"  # it is an effect on a sensor that the vehicle does not have
    IMPOSSIBLE = "impossible"  # no value of it gives a possible car
    UNMOVING = "unmoving"  # largest RMS change that a value of it makes to a signal, share of that signal
    UNOBSERVABLE = "unobservable"  # its link, or the channel that it acts on, is not in the logs
    NOT_EXCITED = "not_excited"  # what the logs hold of a quantity that it needs, in the quantity's unit
    SCREENED = "screened"  # squared residuals that its best grid point removes, in units of the noise
    TOO_FEW_BLOCKS = "too_few_blocks"  # blocks that the logs give, a count
    TOO_FEW_DRIVEN_BLOCKS = "too_few_driven_blocks"  # blocks in which the car drives, a count
    IDLE_TIME = "idle_time"  # time in which the signal is silent or the car does not drive, s; limit: of the logs' s
    NO_MOTION = "no_motion"  # the logs hold no speed
    NOTHING_COMPARABLE = "nothing_comparable"  # the logs hold no signal that a simulation gives
    LOG_WITHOUT_SPEED = "log_without_speed"  # a log is left out
    # The others of the search (search.py)
    OUTSCORED = "outscored"  # evidence, less than that of the candidate in `others`, nats
    # A candidate's own score (criteria.py)
    EVIDENCE = "evidence"  # log evidence over its base model, nats
    PREDICTIVE_GAIN = "holdout_gain"  # cross-validated log likelihood over its base model, nats
    PREDICTIVE_GAIN_BOUND = "holdout_gain_bound"  # lower 95 % bound of that, nats
    GAIN_NOISE = "gain_noise"  # that gain against its standard deviation between blocks, nats
    EXPLAINED_SHARE = "explained_share"  # RMS explained, as a share of the signal
    ERROR_REDUCTION = "error_reduction"  # share of the signal's error that it removes
    SINGLE_BLOCK = "single_block"  # lower 95 % bound of that share over blocks
    DEGRADATION = "degradation"  # growth of another signal's mean square error, share
    BROKEN_DEGRADATION = "broken_degradation"  # the same of a signal whose link is broken
    # The selected candidates (rejection.py)
    RESIDUAL_PEAK = "residual_peak"  # its signal is still missed in moments or as a whole, share of the signal
    RESIDUAL_LEFT = "residual_left"  # share of what could be explained of its signal that is left
    LARGER_ELSEWHERE = "larger_elsewhere"  # another signal is missed by more than it explains, share of that signal
    BLOCK_INCONSISTENCY = "block_inconsistency"  # its value differs between blocks, share of the value
    KNOWN_TO_CALIBRATION = "known_to_calibration"  # the calibration logs had the same value
    UNTESTED_IN_CALIBRATION = "untested_in_calibration"  # the calibration logs could not have shown it
    DEPENDENT = "dependent"  # gains nothing without an effect that is not new
    ABSORBED_BY_CALIBRATION = "absorbed_by_calibration"  # cancels an effect that the calibration had put in
    # The verdict (verdict.py)
    BETTER_REJECTED = "better_rejected"  # a candidate that fails its own score explains clearly more
    INDISTINGUISHABLE = "indistinguishable"  # other candidates explain these logs as well
    WEAK_SET = "weak_set"  # a set of weak candidates only, nats
    WEAK = "weak"  # named, and only the holdout blocks can confirm it
    FRAMES_CHANGED = "frames_changed"  # commands were echoed that were never sent, share of the echoes
    UNEXPLAINED = "unexplained"  # a broken link that no effect explains, share of the signal
    WITHIN_BASELINE = "within_baseline"  # nothing is missed by more than on the model's calibration logs
    RECALIBRATION_INCONSISTENCY = "recalibration_inconsistency"  # a gain differs between blocks, standard deviations
    NOTHING_BROKEN = "nothing_broken"  # no link is broken
    NOTHING_VISIBLE = "nothing_visible"  # these logs could have shown no effect (result.py)
    # The holdout blocks (jobs/gap/acceptance.py)
    NOT_MEASURED = "not_measured"  # no holdout block could be run, or there is no gap
    GAP_NOT_CLOSED = "gap_not_closed"  # the repair closes nothing there, share of the gap
    GAP_LEFT = "gap_left"  # upper bound of the closed share is too small
    GAP_UNCERTAIN = "gap_uncertain"  # lower bound of the closed share is too small
    MISSED_IN_HOLDOUT = "missed_in_holdout"  # the holdout blocks miss a signal grossly, share of the signal


class Reason(NamedTuple):
    """One criterion that failed, and the numbers compared.

    Args:
        criterion: which.
        name: the effect that failed it; "" where it is no single effect's.
        value, limit: the number and the threshold that it was compared with, in the criterion's unit.
        others: further effects that the reason is about (equivalents, absorbed causes, what hides it).
        key: the signal, parameter or effect that the numbers are of.
        link: the signal's residual, where the reason is one.
        detail: of KNOWN_TO_CALIBRATION, (parameter, value now, value in the calibration logs).
        stage: where the search rejected a candidate; None for the reasons of the verdict.
        beside: of a stage, the effects that were in the model beside this one.
        note: what the model or the logs say of it (a plant's message); only shown.
    """

    criterion: Criterion
    name: str = ""
    value: float | None = None
    limit: float | None = None
    others: tuple[str, ...] = ()
    key: str = ""
    link: LinkResidual | None = None
    detail: tuple[tuple[str, float, float], ...] = ()
    stage: RejectionStage | None = None
    beside: tuple[str, ...] = ()
    note: str = ""


class Verdict(NamedTuple):
    """names: the effects of a SET, else empty. reasons: why it is this verdict, the decisive one first."""

    kind: VerdictKind
    names: tuple[str, ...] = ()
    reasons: tuple[Reason, ...] = ()

    def has(self, criterion: Criterion) -> bool:
        """Whether one of the reasons is this criterion."""
        return any(reason.criterion is criterion for reason in self.reasons)


def reason_entry(reason: Reason) -> dict[str, Any]:
    """An entry of gap.json's `reasons`: name, criterion, the finite numbers compared, and of a rejected candidate the
    stage.
    """
    numbers = {"value": reason.value, "limit": reason.limit}
    finite = {key: float(number) for key, number in numbers.items() if number is not None and isfinite(number)}
    signal = {"signal": reason.key} if reason.key else {}
    entry = {"name": reason.name, "criterion": reason.criterion.value, **signal, **finite}
    if reason.stage is None:
        return entry
    names = {key: list(group) for key, group in (("beside", reason.beside), ("others", reason.others)) if group}
    return {**entry, "stage": reason.stage.value, **names}


def reason_from_entry(entry: Mapping[str, Any]) -> Reason:
    """The reason in an entry of gap.json, as far as it is written there."""
    stage = entry.get("stage")
    return Reason(
        Criterion(entry["criterion"]),
        entry["name"],
        entry.get("value"),
        entry.get("limit"),
        tuple(entry.get("others", ())),
        entry.get("signal", ""),
        stage=None if stage is None else RejectionStage(stage),
        beside=tuple(entry.get("beside", ())),
    )
