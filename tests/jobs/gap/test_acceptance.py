"""Which effects the holdout blocks confirm, and why others are rejected."""

from __future__ import annotations

from typing import Any

import pytest

from tests.gap.made_answer import answer
from tunefree_hil.gap.selection.reasons import Criterion
from tunefree_hil.jobs.gap.acceptance import is_confirmed, rejection_fields, rejection_reason
from tunefree_hil.jobs.gap.report_text import describe_answer, describe_rejection

WORDS = "steer_dead_time fits best, but the repair closes nothing of the gap in the holdout blocks"
CLOSES = {"value": -0.4, "low": -0.9, "high": 0.1}


@pytest.mark.parametrize(
    ("broken", "faint", "closes", "says"),
    [
        (True, False, {"value": 0.5, "low": -0.2, "high": 0.9}, True),
        (True, False, CLOSES, False),
        (True, False, {"value": 0.4, "low": 0.2, "high": 0.6}, False),  # a third is left for sure
        (False, False, {"value": 0.5, "low": 0.2, "high": 0.9}, True),
        (
            False,
            False,
            {"value": 0.5, "low": -0.2, "high": 0.9},
            False,
        ),  # the name alone says so
        (False, False, {"value": 0.99, "low": 0.0, "high": 1.0}, True),  # some blocks do not show it
        (False, False, None, True),  # there is no gap to close
        (False, True, {"value": 0.99, "low": 0.0, "high": 1.0}, False),  # and so do not speak for it
        (False, True, {"value": 0.9, "low": 0.5, "high": 1.0}, True),
        (False, True, None, False),
    ],
)
def test_who_is_borne_out(broken: bool, faint: bool, closes: dict[str, float] | None, says: bool) -> None:
    effects = [{"name": "a"}, {"name": "b", "faint": faint}]
    assert is_confirmed({"effects": effects, "links": [{"broken": False}, {"broken": broken}]}, closes) == says


SOME, NONE = {"value": 0.1, "low": -0.9, "high": 0.5}, {"value": 0.0, "low": 0.0, "high": 0.0}


@pytest.mark.parametrize(
    ("evidence", "here", "there", "stirs", "closes", "says"),
    [
        (200.0, 0.6, 0.5, 0.7, SOME, True),  # its own signal says so, row by row
        (200.0, 0.6, 0.2, 0.4, SOME, False),  # it is hardly there
        (200.0, 0.6, 0.5, 0.7, {"value": -0.6, "low": -9.0, "high": 0.0}, False),  # the car is none the better for it
        (200.0, 0.6, 0.001, 0.002, NONE, True),  # these blocks do not show it
        (200.0, 0.6, 0.1, 0.2, NONE, True),  # what recalibration spoilt there was left
        (200.0, 0.6, -0.1, 0.2, {"value": -0.2, "low": -0.5, "high": 0.1}, False),  # they show it, and it spoils them
        (200.0, 0.6, -0.5, 0.9, NONE, False),  # its own signal speaks against it
        (200.0, 0.6, 0.0, 0.6, SOME, False),  # it helps one block and spoils another
        (200.0, 0.6, 0.001, 0.002, {"value": 0.0, "low": -9.0, "high": 0.01}, False),  # one of them goes far astray
        (200.0, -0.3, -0.01, 0.2, SOME, False),  # nowhere of any use
        (200.0, 0.6, None, None, NONE, False),  # those blocks have nothing of its signal
        (40.0, 0.6, 0.5, 0.7, SOME, False),  # not plain
    ],
)
def test_a_plain_name_is_borne_out_by_its_own_signal_as_well(
    evidence: float, here: float, there: float | None, stirs: float | None, closes: dict[str, float], says: bool
) -> None:
    seen = {"shrink": here, "unseen_shrink": there, "unseen_stirs": stirs}
    effects = [{"name": "a", "evidence": evidence, "faint": False, **seen}]
    assert is_confirmed({"effects": effects, "links": [{"broken": True}]}, closes) == says


def test_each_of_several_plain_names_needs_its_own_signals_word() -> None:
    sure = {"evidence": 200.0, "faint": False, "shrink": 0.6, "unseen_shrink": 0.5, "unseen_stirs": 0.7}
    links = [{"broken": True}]
    assert is_confirmed({"effects": [sure, sure], "links": links}, SOME)
    assert not is_confirmed({"effects": [sure, {**sure, "unseen_shrink": 0.01}], "links": links}, SOME)
    assert is_confirmed({"effects": [sure, {**sure, "unseen_shrink": 0.0, "unseen_stirs": 0.0}], "links": links}, SOME)


@pytest.mark.parametrize(
    ("there", "low", "usual", "faint", "says"),
    [
        (0.95, 0.04, ["rate_of_speed"], False, True),
        (0.95, 0.04, [], False, False),  # the model comes near its own logs: then the whole gap has to go
        (0.75, 0.04, ["rate_of_speed"], False, False),  # a quarter of its own signal stays
        (0.95, -0.02, ["rate_of_speed"], False, False),  # nothing is surely the better for it
        (0.95, 0.004, ["rate_of_speed"], False, False),  # nothing to speak of is
        (0.95, 0.04, ["rate_of_speed"], True, False),  # a faint name needs the gap itself
    ],
)
def test_with_a_poor_model_most_of_its_own_signal_speaks_for_a_name_of_little_evidence(
    there: float, low: float, usual: list[str], faint: bool, says: bool
) -> None:
    scale = {"name": "speed_scale", "evidence": 27.0, "faint": faint, "shrink": 0.95, "unseen_shrink": there}
    told = {"effects": [{**scale, "unseen_stirs": 0.99}], "links": [{"broken": True}], "as_usual": usual}
    assert is_confirmed(told, {"value": 0.2, "low": low, "high": 0.58}) is says


def rejected(found: dict[str, Any], gap_share: dict[str, float] | None, kind: str = "physics") -> dict[str, Any]:
    """The keys that change, with the text as the repair writes it."""
    reason = rejection_reason(found, gap_share)
    text = describe_rejection([one["name"] for one in found["effects"]], reason, gap_share)
    return {**rejection_fields(found, gap_share, reason, kind), "words": [text]}


@pytest.mark.parametrize(
    ("closes", "criterion", "value", "text"),
    [
        (None, Criterion.NOT_MEASURED, None, "the gap could not be measured in the holdout blocks"),
        (CLOSES, Criterion.GAP_NOT_CLOSED, -0.4, "the repair closes nothing of the gap in the holdout blocks"),
        (
            {"value": 0.4, "low": 0.2, "high": 0.6},
            Criterion.GAP_LEFT,
            0.6,
            "the repair closes 40 % (20 to 60) of the gap in the holdout blocks, which leaves a third or more",
        ),
        (
            {"value": 0.5, "low": -0.2, "high": 0.9},
            Criterion.GAP_UNCERTAIN,
            -0.2,
            "the repair closes 50 % (-20 to 90) of the gap in the holdout blocks, which may be none",
        ),
    ],
)
def test_a_rejection_has_its_criterion_with_the_number_and_a_text(
    closes: dict[str, float] | None, criterion: Criterion, value: float | None, text: str
) -> None:
    reason = rejection_reason(answer(), closes)
    assert (reason.criterion, reason.value) == (criterion, value)
    found = rejected(answer(), closes)
    assert found["words"] == [f"steer_dead_time fits best, but {text}"]
    (entry,) = found["reasons"]
    assert (entry["name"], entry["criterion"], entry.get("value")) == ("steer_dead_time", criterion.value, value)
    assert found["taken_back"]["explained_frac"] == closes


def test_what_the_search_rejected_stays_beside_the_holdouts_reason() -> None:
    screened = {"name": "grade", "criterion": "screened", "stage": "screening"}
    found = rejected({**answer(), "reasons": [screened]}, {"value": 0.5, "low": -0.2, "high": 0.9})
    assert [entry["criterion"] for entry in found["reasons"]] == ["gap_uncertain", "screened"]


def test_a_weak_effect_needs_more_of_the_gap() -> None:
    unsure = {"value": 0.9, "low": 0.2, "high": 1.0}
    assert rejection_reason(answer(), unsure).limit == pytest.approx(-0.02)
    weak = [{**one, "faint": True} for one in answer()["effects"]]
    assert rejection_reason({**answer(), "effects": weak}, unsure).limit == pytest.approx(0.3)


@pytest.mark.parametrize(("broken", "verdict"), [(True, "none_of_these"), (False, "none_missing")])
def test_what_is_said_in_place_of_a_name_that_is_taken_back(broken: bool, verdict: str) -> None:
    one = answer()
    one["links"] = [{**link, "broken": broken} for link in one["links"]]
    now = {**one, **rejected(one, CLOSES)}
    assert now["verdict"] == verdict and now["explained_frac"] is None and now["forced"] == "steer_dead_time"
    assert WORDS in describe_answer(now) and now["absorbed"] is False
    assert rejected(one, CLOSES, "hybrid")["absorbed"], "its net may hide what is not named any more"


def test_the_free_run_of_a_model_that_misses_its_own_logs_tells_nothing() -> None:
    sure = {"evidence": 300.0, "shrink": 0.9, "unseen_shrink": 0.85, "unseen_stirs": 0.9}
    links, usual = [{"broken": True}], ["rate_of_speed"]
    lost = {"value": -1.4, "low": -1.5, "high": -0.8}
    assert not is_confirmed({"effects": [sure], "links": links, "as_usual": []}, lost)
    assert is_confirmed({"effects": [sure], "links": links, "as_usual": usual}, lost)
    silent = {**sure, "unseen_shrink": 0.0, "unseen_stirs": 0.0}  # blocks that do not show it bear nobody out
    for other in ({**sure, "unseen_shrink": 0.4}, {**sure, "evidence": 30.0}, silent):
        assert not is_confirmed({"effects": [sure, other], "links": links, "as_usual": usual}, lost)


def test_where_nothing_is_broken_a_name_that_is_taken_back_leaves_no_place_and_no_change() -> None:
    one = {**answer(), "changes": [{"key": "effects.steer_dead_time.delay_s", "before": None, "after": 0.07}]}
    broken = rejected(one, CLOSES)
    assert broken["changes"] == [] and "where" not in broken, "what is missed is missed there all the same"
    one["links"] = [{**link, "broken": False} for link in one["links"]]
    assert rejected(one, CLOSES)["where"] == {"link": None, "signal": "", "regime": [], "card": ""}
