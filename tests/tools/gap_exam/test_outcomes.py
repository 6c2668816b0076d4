"""Answers written by hand, and what each is worth: every outcome of every kind of row."""

from __future__ import annotations

from typing import Any

import pytest

from tools.gap_exam.outcomes import Mark, forced_name, mark, outcome


def named(*names: str, verdict: str = "", **more: Any) -> dict[str, Any]:
    """An answer that states effects."""
    verdict = verdict or ("one" if len(names) == 1 else "several")
    return {"verdict": verdict, "effects": [{"name": name, "params": {}} for name in names], "set": [], **more}


def a_set(*names: str, **more: Any) -> dict[str, Any]:
    return {"verdict": "set", "effects": [], "set": list(names), **more}


def silence(verdict: str, **more: Any) -> dict[str, Any]:
    return {"verdict": verdict, "effects": [], "set": [], **more}


ONE, TWO, FREE, OUTSIDE = ["steer_lag"], ["steer_lag", "payload"], [], ["body_roll"]


@pytest.mark.parametrize(
    ("truths", "answer", "wanted"),
    [
        (ONE, named("steer_lag"), "right"),
        (ONE, named("steer_lag", verdict="several"), "right"),
        (ONE, named("steer_dead_time"), "wrong"),
        (ONE, named("steer_lag", "payload"), "wrong"),  # a false name beside the truth
        (ONE, a_set("steer_lag", "steer_dead_time"), "in_set"),
        (ONE, a_set("payload", "steer_dead_time"), "wrong"),
        (ONE, a_set("steer_lag"), "right"),
        (ONE, a_set(), "wrong"),
        (ONE, {**a_set("steer_lag", "payload"), "effects": [{"name": "payload"}]}, "wrong"),
        (ONE, silence("none_missing"), "silent"),
        (ONE, silence("none_of_these"), "silent"),
        (ONE, silence("cannot_test"), "cannot_test"),
        (ONE, named(verdict="one"), "wrong"),
        (ONE, {"verdict": "one", "effects": [{}]}, "wrong"),
        (ONE, silence("perhaps"), "failed"),
        (ONE, {}, "failed"),
        (ONE, None, "failed"),
        (["brake_drag"], named("rolling_resistance"), "right"),  # a class counts as one name
        (["rolling_resistance"], a_set("brake_drag", "rolling_resistance"), "right"),
        (["rolling_resistance"], a_set("brake_drag", "aero_drag"), "in_set"),
        (["side_wind"], named("road_bank"), "wrong"),  # this car reports its lateral acceleration
        (TWO, named("payload", "steer_lag"), "right"),
        (TWO, named("payload"), "partial"),
        (TWO, named("payload", "steer_lag", "grade"), "wrong"),
        (TWO, named("payload", "grade"), "wrong"),
        (TWO, a_set("payload", "steer_lag"), "in_set"),
        (TWO, a_set("grade", "aero_drag"), "wrong"),
        (TWO, silence("none_of_these"), "silent"),
        (FREE, silence("none_missing"), "right"),
        (FREE, silence("none_of_these"), "silent"),
        (FREE, named("payload"), "wrong"),
        (FREE, a_set("payload", "grade"), "wrong"),
        (FREE, silence("cannot_test"), "cannot_test"),
        (OUTSIDE, silence("none_of_these"), "right"),
        (OUTSIDE, silence("none_missing"), "silent"),
        (OUTSIDE, named("payload"), "wrong"),
    ],
)
def test_outcomes(truths: list[str], answer: dict[str, Any] | None, wanted: str) -> None:
    assert outcome(truths, answer) == wanted


def test_a_set_is_a_good_answer_to_what_is_outside() -> None:
    """A set of names of which none is true is honest doubt there, and wrong anywhere else."""
    assert outcome(OUTSIDE, a_set("payload", "grade")) == "in_set"


@pytest.mark.parametrize(
    ("row", "found", "answer", "wanted", "true"),
    [
        ("start_d", False, silence("none_missing", absorbed=True), "right", True),
        ("start_d", False, silence("none_of_these", absorbed=True), "silent", False),  # something is there, it says
        ("start_d", False, silence("none_missing", absorbed=False), "silent", None),
        ("start_d", True, silence("none_missing", absorbed=True), "silent", False),  # the net has not taken it in
        ("start_d", True, silence("none_of_these", absorbed=True), "silent", False),
        ("start_d", False, named("payload", absorbed=True), "wrong", False),
        ("start_d", True, named("steer_lag"), "right", None),
        ("start_c", False, silence("none_missing", absorbed=True), "silent", False),
    ],
)
def test_absorbed_is_right_where_it_is_true(
    row: str, found: bool, answer: dict[str, Any], wanted: str, true: bool | None
) -> None:
    truth = {"row": row, "effects": {"steer_lag": {"tau_s": 0.1}}, "oracle": {"detectable": found}}
    one = mark(truth, answer)
    assert (one.outcome, one.absorbed) == (wanted, true)


def test_of_a_recording_as_it_is_no_name_is_right() -> None:
    """What a real car lacks nobody knows: that something is, and none of these, is no mistake; a name is."""
    truth = {"row": "semi_free", "effects": {}, "oracle": None}
    answers = (silence("none_missing"), silence("none_of_these"), named("payload"), a_set("payload", "grade"))
    assert [mark(truth, one).outcome for one in answers] == ["right", "right", "wrong", "wrong"]


def test_values_intervals_and_links() -> None:
    truth = {"row": "one", "effects": {"steer_gain": {"gain_frac": 1.2}}}
    params = {"gain_frac": {"value": 1.19, "low": 1.17, "high": 1.21, "unit": "1"}}
    answer = named("steer_gain", elapsed_s=31.0, where={"link": "report_to_motion"})
    answer["effects"][0]["params"] = params
    answer["explained_frac"] = {"value": 0.97, "low": 0.9, "high": 1.0}
    found = mark(truth, answer, 99.0)
    assert found.value_errors == (pytest.approx(0.05),), "of the distance from neutral"
    assert (found.covered, found.link, found.closed, found.seconds) == ((True,), True, 0.97, 31.0)
    assert (found.set_size, found.at_least_one, found.forced) == (1, None, "right")
    off = mark(truth, {**answer, "where": {"link": "clock"}})
    assert off.link is False
    narrow = {"gain_frac": {"value": 1.19, "low": 1.185, "high": 1.195}}
    assert mark(truth, {**answer, "effects": [{"name": "steer_gain", "params": narrow}]}).covered == (False,)


def test_a_limit_is_in_error_by_its_own_size() -> None:
    truth = {"row": "one", "effects": {"power_limit": {"power_w": 20e3}}}
    answer = named("power_limit")
    answer["effects"][0]["params"] = {"power_w": {"value": 21e3, "low": 19e3, "high": 22e3}}
    assert mark(truth, answer).value_errors == (pytest.approx(0.05),)


def test_at_least_one_is_counted_apart() -> None:
    truth = {"row": "two_same", "effects": {"steer_lag": {"tau_s": 0.1}, "payload": {"mass_kg": 200.0}}}
    both, one, beside, none = named("steer_lag", "payload"), named("payload"), named("payload", "grade"), named("grade")
    marks = [mark(truth, answer) for answer in (both, one, beside, none, silence("none_missing"), None)]
    assert [one.at_least_one for one in marks] == [True, True, True, False, False, False]
    assert [one.outcome for one in marks] == ["right", "partial", "wrong", "wrong", "silent", "failed"]


def test_forced_to_answer() -> None:
    """What it would have said without a set and without 'none': `forced`, else the first that it names."""
    assert forced_name(silence("none_missing", forced="steer_lag")) == "steer_lag"
    assert forced_name(a_set("payload", "steer_lag")) == "payload"
    assert forced_name(silence("none_missing")) is None
    truth = {"row": "one", "effects": {"steer_lag": {"tau_s": 0.1}}}
    answers = (silence("none_missing", forced="steer_lag"), a_set("payload", "steer_lag"), silence("none_of_these"))
    forced = [mark(truth, one).forced for one in answers]
    assert forced == ["right", "wrong", "silent"]
    assert mark({"row": "free", "effects": {}}, silence("none_missing")).forced is None


def test_no_answer_is_marked_too() -> None:
    truth = {"row": "one", "effects": {"steer_lag": {"tau_s": 0.1}}}
    assert mark(truth, None, 900.0) == Mark("failed", seconds=900.0)
