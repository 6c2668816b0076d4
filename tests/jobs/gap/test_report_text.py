"""The sentence of a gap: what is missing first, and why no model is written in one signal."""

from __future__ import annotations

from tests.gap.made_answer import answer
from tunefree_hil.base.contracts import Link
from tunefree_hil.gap.diagnostics.residual_tests import LinkResidual
from tunefree_hil.gap.selection.baseline_misfit import BaselineMisfit
from tunefree_hil.gap.selection.reasons import reason_entry
from tunefree_hil.gap.selection.verdict import Findings, decide_verdict
from tunefree_hil.jobs.gap.report_text import describe_answer, describe_parameters, format_percent, list_remarks

CLOSED = {"value": 0.97, "low": 0.9, "high": 0.99}
MISSING = "steer_dead_time (delay_s 0.070 s (0.069 to 0.071)) is missing; it closes 97 % (90 to 99) of the gap"


def test_numbers_are_said_as_people_say_them() -> None:
    assert format_percent({"value": 0.941, "low": -0.003, "high": 0.97}) == "94 % (0 to 97)"
    value = {"value": -0.2, "low": -1.4, "high": 1.1, "unit": "m"}
    assert describe_parameters({"params": {"ahead_m": value}}) == "ahead_m 0 m (-1 to 1)"
    unsure = {"value": 0.4731, "low": None, "high": None, "unit": "rad"}
    assert describe_parameters({"params": {"limit_rad": unsure}}) == "limit_rad 0.473 rad (interval unknown)"


def test_what_is_missing_comes_first() -> None:
    told = describe_answer(answer(explained_frac=CLOSED, worse=[]))
    assert told == f"{MISSING} that recalibration leaves"


def test_why_no_model_is_written_comes_last_in_one_signal() -> None:
    worse = ["report.steer_rad of before.log (by 900 %)", *(f"report.{k} of before.log (by 9 %)" for k in range(6))]
    told = describe_answer(answer(explained_frac=CLOSED, worse=worse))
    assert told.startswith(MISSING) and told.count("before.log") == 1
    assert told.endswith("worse, above all report.steer_rad of before.log (by 900 %)")


def test_a_set_of_one_effect_is_one_of_its_names() -> None:
    told = describe_answer(
        answer("set", set=["steer_lag", "steer_friction", "steer_backlash"], separate_by="small sines")
    )
    assert told == (
        "one of steer_lag, steer_friction and steer_backlash is missing, and these logs cannot tell which; "
        "to separate them, drive small sines"
    )


def test_a_set_of_several_effects_says_that_they_are_together() -> None:
    both = ["steer_lag", "brake_gain"]
    told = describe_answer(answer("set", set=["steer_lag", "steer_friction", "brake_gain"], together=both))
    assert told.startswith("steer_lag and brake_gain are missing together, or steer_friction in place of one of them,")
    more = answer("set", set=["steer_lag", "steer_friction", "brake_gain", "brake_fade"], together=both)
    assert "together, or one of steer_friction and brake_fade in place of one of them, and" in describe_answer(more)


MOVED = "recalibration moves actuator.steer.dead_time_s by +3.1 standard deviations"


def test_nothing_missing_is_not_said_bare_where_recalibration_moved_much() -> None:
    assert f"recalibration; but {MOVED}, which may" in describe_answer(answer("none_missing", moved=[MOVED]))
    told = describe_answer(answer("none_missing", moved=[MOVED, "recalibration moves x by -2.7 standard deviations"]))
    assert f"{MOVED} and 1 more, which may" in told
    assert "but" not in describe_answer(answer("none_missing", moved=[]))


def test_what_a_missing_signal_hides_is_told_first() -> None:
    told = describe_answer(answer("none_missing", untold={"ins_latency": "no INS"}))
    assert told.endswith("; these logs could not have shown ins_latency, brake_fade")


def test_what_is_in_the_sentence_is_not_told_beside_it() -> None:
    why = "steer_lag explains these logs as well as steer_friction"
    assert list_remarks(answer("set", words=[why], moved=[MOVED])) == [why, MOVED]
    assert list_remarks(answer("none_of_these", words=["yaw_rate is missed"], moved=[])) == []
    assert list_remarks(answer("none_missing", words=["nothing beyond noise"], moved=[MOVED])) == []
    assert list_remarks(answer("none_missing", words=["nothing beyond noise"], moved=[MOVED, "more"])) == [
        MOVED,
        "more",
    ]
    many = list_remarks(answer("one", moved=[MOVED] * 7))
    assert (
        many[:-1] == [MOVED] * 3
        and many[-1] == "recalibration moves 4 further parameters about as far (`moved` in gap.json)"
    )


def test_a_misfit_within_the_baseline_is_no_alarm() -> None:
    """The reason is that of gap/selection/verdict.py; no text is read for it."""
    link = LinkResidual("yaw_rate", Link.REPORT_TO_MOTION, "rad/s", 0.2, 0.1, 0.2, 0.3, True)
    verdict = decide_verdict(Findings([link], baseline=BaselineMisfit({"yaw_rate": 0.2}, {})))
    reasons = [reason_entry(reason) for reason in verdict.reasons]
    links = [{"signal": "yaw_rate", "broken": True}, {"signal": "steer", "broken": False}]
    same = answer(verdict.kind.value, words=["yaw_rate"], links=links, as_usual=["yaw_rate"], where={"card": ""})
    same["reasons"] = reasons
    assert describe_answer(same).startswith("nothing exceeds what this model misses of its calibration logs")
    beyond = {**same, "links": [*links, {"signal": "steer", "broken": True}]}
    other = {**same, "reasons": [{"name": "steer_lag", "criterion": "residual_peak"}]}
    for one in (beyond, other, {**same, "as_usual": []}):
        assert describe_answer(one).startswith("something is missing that is not in the catalogue")
