"""From steps of a search to a verdict: who has rivals is one of a set, alone or beside others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
import pytest

from tests.gap.estimation.test_intervals import ALL as BLOCKS_OF
from tests.gap.estimation.test_intervals import DELAY, fitted
from tests.gap.selection.test_criteria import spread, weighed
from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.diagnostics.residual_tests import LinkResidual
from tunefree_hil.gap.estimation.intervals import block_inconsistency
from tunefree_hil.gap.estimation.nuisance import DRIFT_SIGMAS
from tunefree_hil.gap.measured.command_echo import CommandEcho
from tunefree_hil.gap.measured.excitation import Excitation, Shortage
from tunefree_hil.gap.result_text import drive_difference_texts, equivalent_texts, reason_text, verdict_texts
from tunefree_hil.gap.selection.baseline_misfit import NO_BASELINE, BaselineMisfit
from tunefree_hil.gap.selection.criteria import EQUIVALENCE, CandidateScore, Reduction
from tunefree_hil.gap.selection.equivalence import add_easily_confused, find_inseparable
from tunefree_hil.gap.selection.reasons import Criterion, Reason, Verdict, VerdictKind
from tunefree_hil.gap.selection.rejection import (
    ExplainedTargets,
    find_inconsistency_rejection,
    find_residual_rejection,
    inconsistency_limits,
    name_all,
)
from tunefree_hil.gap.selection.verdict import (
    Findings,
    decide_location,
    decide_verdict,
    find_changed_frames,
    find_day_sized,
    find_unexplained_beside,
)

SEEN, UNSEEN = Excitation(2.0, True, ()), Excitation(0.3, False, (Shortage("brakings", 3.0, 9.0),))
BARELY = Excitation(0.75, False, (Shortage("brakings", 3.0, 4.0),))
NAMES = ("brake_gain", "brake_fade", "brake_drag", "rolling_resistance", "steer_lag", "steer_dead_time")
DRIVES = cast(Any, [type("Drive", (), {"has_signals": lambda self, *names: True})()])
QUIET = LinkResidual("brake", Link.COMMAND_TO_REPORT, "1", 0.1, 0.1, 0.0, 0.0, False)


FADES = weighed(brake_gain=spread(1.0), brake_fade=spread(1.2), brake_drag=spread(6.0))
ALONE = {one.name: one.evidence for one in FADES}


def step(name: str, *others: str) -> CandidateScore:
    return weighed(**{name: spread(1.0)})[0]._replace(equivalents=others)


def verdict(
    *steps: CandidateScore,
    brakes: Excitation = SEEN,
    rejection: Reason | None = None,
    gains: dict[str, float] | None = None,
    placed: dict[str, float] | None = None,
) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """(kind, names of a set, texts)"""
    held = {name: brakes if name == "brake_gain" else SEEN for name in NAMES}
    told = [add_easily_confused(one._replace(evidence_in_place=placed or ALONE), steps, held, DRIVES) for one in steps]
    found = decide_verdict(Findings([QUIET], list(steps), told, rejection=rejection, inconsistent_gains=gains or {}))
    return as_tuple(found, held)


def as_tuple(found: Verdict, excitation: Mapping[str, Excitation]) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    names = found.names if found.kind is VerdictKind.SET else ()
    return found.kind.value, names, verdict_texts(found, excitation)


@pytest.mark.parametrize(
    ("steps", "says", "names"),
    [
        ((step("brake_gain"),), "one", ()),
        ((step("brake_gain", "brake_fade"),), "set", ("brake_gain", "brake_fade")),
        ((step("brake_gain"), step("steer_lag")), "several", ()),
        (
            (step("brake_gain"), step("steer_lag", "steer_dead_time")),
            "set",
            ("brake_gain", "steer_lag", "steer_dead_time"),
        ),
        ((step("brake_drag", "rolling_resistance"),), "one", ()),  # a class is one name
        ((step("brake_gain", "steer_lag"), step("steer_lag")), "several", ()),  # it is there already
        # nor do two of a class stand in a set: the better one does for both
        ((step("brake_gain", "rolling_resistance", "brake_drag"),), "set", ("brake_gain", "brake_drag")),
    ],
)
def test_rivals_make_a_set_of_one_effect_and_of_several(
    steps: tuple[CandidateScore, ...], says: str, names: tuple[str, ...]
) -> None:
    found = verdict(*steps)
    assert found[:2] == (says, names) and bool(found[2]) == (says == "set")


def test_who_would_look_the_same_is_told_beside_a_name() -> None:
    assert find_inseparable(["brake_drag", "rolling_resistance"], DRIVES) == {}, "both are named"
    none = cast(Any, [type("Drive", (), {"has_signals": lambda self, *names: False})()])
    assert "road_bank" in find_inseparable(["side_wind"], none)["side_wind"]
    assert find_inseparable(["side_wind"], [*none, *DRIVES]) == {}, "one log tells them apart, and that is enough"
    (words,) = equivalent_texts(find_inseparable(["steer_lag", "brake_drag"], DRIVES))
    assert words == "brake_drag: no log of this car separates it from rolling_resistance"


def test_faint_rivals_are_no_set_as_no_proof_could_bear_one_out() -> None:
    faint = step("brake_gain", "brake_fade")._replace(
        is_unbroken=True, error_reduction=Reduction(0.2, 0.1, 0.3), evidence=EQUIVALENCE.min_weak_set_nats - 1.0
    )
    assert verdict(faint._replace(evidence=EQUIVALENCE.min_weak_set_nats + 1.0))[:2] == (
        "set",
        ("brake_gain", "brake_fade"),
    )
    assert verdict(faint)[:2] == ("none_missing", ()) and "brake_gain, brake_fade" in verdict(faint)[2][0]
    held = dict.fromkeys(list[str](NAMES), SEEN)
    elsewhere = QUIET._replace(signal="steer", explainable_rms=0.05, explainable_share=0.5, is_broken=True)
    says, names, words = as_tuple(decide_verdict(Findings([QUIET, elsewhere], [faint], [faint])), held)
    assert (says, names) == ("none_of_these", ()) and elsewhere.text in words[0]
    assert verdict(faint, step("steer_lag"))[0] == "set", "one of several is plain"
    alone = verdict(faint._replace(equivalents=()))
    assert alone[0] == "one" and "only the holdout blocks can confirm it" in alone[2][0]


def test_what_the_drive_could_hardly_show_is_a_set_with_whom_it_is_easily_taken_for() -> None:
    says, names, words = verdict(step("brake_gain"), brakes=UNSEEN)
    assert (says, names) == ("set", ("brake_gain", "brake_fade")) and "9 are needed" in words[0]
    says, names, words = verdict(step("brake_gain"), brakes=BARELY)
    assert (says, names) == ("one", ()) and "4 are needed" in words[0]


def test_beside_other_effects_it_is_asked_who_comes_near_in_its_place() -> None:
    """Alone the other effect is in everybody's evidence, and makes all of them near."""
    steps, brakes = (step("brake_gain"), step("steer_lag")), UNSEEN
    assert verdict(*steps, brakes=brakes)[:2] == ("set", ("brake_gain", "brake_fade", "steer_lag"))
    placed = {"brake_gain": 300.0, "brake_fade": 40.0}
    assert verdict(*steps, brakes=brakes, placed=placed)[:2] == ("several", ())


def test_nothing_found_and_nothing_missed_is_nothing_missing() -> None:
    assert verdict()[0] == "none_missing"


def test_a_gain_that_is_another_one_in_each_block_is_no_recalibration() -> None:
    says, _, words = verdict(gains={"throttle_gain.gain_frac": 3.2})
    assert says == "none_of_these" and "throttle_gain.gain_frac" in words[0] and "3.2 standard" in words[0]
    assert verdict(step("brake_gain"), gains={"throttle_gain.gain_frac": 3.2})[0] == "one"


BROKEN, LOUD = QUIET._replace(is_broken=True, explainable_share=0.1), QUIET._replace(is_broken=True, burst_share=0.4)
HUM = BROKEN._replace(burst_share=0.14)  # moments that no link is broken by
WORKED = {"brake": 0.135}


LEFT, PEAK, ELSEWHERE = Criterion.RESIDUAL_LEFT, Criterion.RESIDUAL_PEAK, Criterion.LARGER_ELSEWHERE


@pytest.mark.parametrize(
    ("was", "still", "left", "criterion", "value"),
    [
        (BROKEN, QUIET, 0.6, None, 0.0),  # what is left there a calibrated model may miss
        (BROKEN, BROKEN, 0.2, None, 0.0),
        (BROKEN, BROKEN, 0.6, LEFT, 0.6),
        (LOUD, LOUD._replace(burst_share=0.3), 0.0, PEAK, 0.3),
        (LOUD._replace(burst_share=5.0), LOUD, 0.0, None, 0.0),  # its form is not quite the catalogue's
        (LOUD._replace(burst_share=1.7), LOUD, 0.0, None, 0.0),  # less than a quarter
        (LOUD._replace(burst_share=1.5), LOUD, 0.0, PEAK, 0.4),
        (BROKEN._replace(gross_share=0.9), BROKEN._replace(gross_share=0.5), 0.2, PEAK, 0.5),
        (BROKEN._replace(gross_share=2.1), BROKEN._replace(gross_share=0.5), 0.2, None, 0.0),
        (BROKEN, BROKEN._replace(tolerated_share=0.12), 0.6, None, 0.0),  # as much its own calibration missed
        (BROKEN, HUM._replace(signal="steer", explainable_share=0.13), 1.0, None, 0.0),
        (BROKEN, HUM._replace(signal="steer", explainable_share=0.13, burst_share=0.9), 1.0, ELSEWHERE, 0.9),
        (BROKEN, BROKEN._replace(signal="steer"), 1.0, None, 0.0),  # another thing, and a smaller one
        (BROKEN, LOUD._replace(signal="steer"), 1.0, ELSEWHERE, 0.4),
    ],
)
def test_a_name_is_answerable_for_what_is_left(
    was: LinkResidual, still: LinkResidual, left: float, criterion: Criterion | None, value: float
) -> None:
    before = [was, *([still] if still.signal != was.signal else [])]
    reason = find_residual_rejection(before, [still], ExplainedTargets(WORKED, {"brake": left, "steer": 1.0}))
    assert (None if reason is None else reason.criterion) is criterion
    if reason is not None:
        assert reason.value == value and reason.key == still.signal
        reason = name_all(reason, [step("brake_gain"), step("steer_lag")])
        assert reason_text(reason).startswith("brake_gain, steer_lag comes nearest, but")
    assert (verdict(step("brake_gain"), rejection=reason)[0] == "none_of_these") == (criterion is not None)


@pytest.mark.parametrize(
    ("differ", "moves", "explains", "says"),
    [
        (0.5, 0.2, 0.3, False),
        (30.0, 0.2, 0.3, True),
        (30.0, 0.02, 0.03, False),  # as much a calibrated model may miss
        (30.0, 0.05, 0.3, False),  # a sixth of what it explains
    ],
)
def test_what_is_another_one_in_each_block_is_no_effect(
    differ: float, moves: float, explains: float, says: bool
) -> None:
    one, asked = step("steer_dead_time"), list[tuple[str, float]]()

    def moved(key: str, by: float) -> dict[str, float]:
        asked.append((key, by))
        return {"brake": moves}

    repaired = one.model._replace(fit=fitted(DELAY, differ=differ))
    limits = inconsistency_limits([QUIET], {"brake": explains})
    found = block_inconsistency(repaired.fit, one.name, BLOCKS_OF, np.zeros(len(BLOCKS_OF)))
    reason = find_inconsistency_rejection({one.name: found}, limits, moved)
    assert (reason is not None) == says
    if reason is not None:
        assert reason.criterion is Criterion.BLOCK_INCONSISTENCY and "steer_dead_time differs by" in reason_text(reason)
    assert [key for key, _ in asked] == ([DELAY.key] if differ > 1.0 else [])


def test_what_is_of_the_day_and_differs_between_drives_is_told() -> None:
    (words,) = drive_difference_texts({"grade.grade_rad": 2.3})
    assert words.startswith("grade.grade_rad differs by 2.3 standard deviations between the drives")
    assert drive_difference_texts({}) == ()


def test_of_a_name_no_larger_than_a_days_change_that_is_said() -> None:
    by = DRIFT_SIGMAS["brake_gain.gain_frac"]
    small = {"brake_gain": {"gain_frac": 1.0 - 1.9 * by}, "steer_lag": {"tau_s": 0.001}}
    assert find_day_sized(small) == ("brake_gain",)
    assert find_day_sized({"brake_gain": {"gain_frac": 1.0 + 2.1 * by}}) == ()


def test_only_what_is_missed_beyond_usual_is_quoted_and_the_worst_of_that_first() -> None:
    yaw = LinkResidual("yaw_rate", Link.REPORT_TO_MOTION, "rad/s", 0.2, 0.1, 0.2, 0.35, True, burst_share=0.25)
    speed = yaw._replace(signal="rate_of_speed", explainable_share=0.2, burst_share=0.39)
    usual = BaselineMisfit(
        {}, {}, burst_share={"yaw_rate": 0.2, "rate_of_speed": 0.39}, explainable_share={"yaw_rate": 0.02}
    )
    _, _, (words,) = as_tuple(decide_verdict(Findings([speed, yaw], baseline=usual)), {})
    assert words == "yaw_rate is missed by 35.0%, and no effect explains it"
    (beside,) = find_unexplained_beside([yaw], {}, usual)
    assert beside.text == "yaw_rate is missed by 35.0%"
    gross = yaw._replace(gross_share=0.5)
    reason = find_residual_rejection([gross], [gross], ExplainedTargets({"yaw_rate": 0.3}, {"yaw_rate": 0.1}), usual)
    assert reason is not None and reason.criterion is Criterion.RESIDUAL_PEAK and reason.value == 0.5


def test_what_is_missed_beside_a_name_is_said() -> None:
    yaw = LinkResidual("yaw_rate", Link.REPORT_TO_MOTION, "rad/s", 0.2, 0.1, 0.2, 0.06, True)
    assert find_unexplained_beside([yaw, QUIET], {"rate_of_speed": 0.1}) == (yaw,)
    assert find_unexplained_beside([yaw], {"yaw_rate": 0.1}) == (), "who works on it is asked for it"
    assert find_unexplained_beside([yaw], {}, NO_BASELINE._replace(misfit_unexplained={"yaw_rate": 0.05})) == ()


def test_lost_frames_go_before_all_else() -> None:
    echoes = [CommandEcho("steer", 0.0, 0.3, 100), CommandEcho("brake", 0.0, 0.0, 100)]
    (reason,) = changed = find_changed_frames(echoes)
    assert reason.criterion is Criterion.FRAMES_CHANGED and (reason.key, reason.value) == ("steer", 0.3)
    found = decide_verdict(Findings([QUIET], steps=[step("brake_gain")], changed_frames=changed))
    assert found.kind is VerdictKind.NONE_OF_THESE and "steer commands echoed" in verdict_texts(found, {})[0]
    assert decide_location([BROKEN], changed).kind is VerdictKind.NONE_OF_THESE
    assert decide_location([BROKEN], ()).kind is VerdictKind.NOT_SEARCHED
    assert decide_location([QUIET], ()).kind is VerdictKind.NONE_MISSING


def test_where_nothing_is_found_the_criteria_that_the_strongest_candidate_fails_are_told() -> None:
    weak = step("brake_gain")._replace(evidence=3.0)
    found = decide_verdict(Findings([BROKEN], [weak]))
    assert found.kind is VerdictKind.NONE_OF_THESE
    assert [reason.criterion for reason in found.reasons] == [Criterion.UNEXPLAINED, Criterion.EVIDENCE]
    assert verdict_texts(found, {}) == (f"{BROKEN.text}, and no effect explains it",)
