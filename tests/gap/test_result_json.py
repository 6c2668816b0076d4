"""What a search came to survives a file bit for bit."""

from __future__ import annotations

import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.gap.made_answer import made_kept
from tunefree_hil.gap.estimation.least_squares import Fit
from tunefree_hil.gap.measured.blocks import cut_blocks
from tunefree_hil.gap.measured.excitation import Excitation, Shortage
from tunefree_hil.gap.pipeline import Diagnosis
from tunefree_hil.gap.result import KEYS, SCHEMA, SearchResult, as_json, from_json, make_search_result
from tunefree_hil.gap.selection.reasons import Criterion, Reason, RejectionStage, Verdict, VerdictKind, reason_entry
from tunefree_hil.gap.workers.worker import FitSummary, OpenProblem

FITTED = Fit("", (), np.zeros(0), (), {}, np.zeros((0, 0)), {}, {})
SUMMARY = FitSummary(FITTED, {})
PROBLEM = OpenProblem(SUMMARY, cut_blocks([9000], 0.01), {}, {}, (), {})


def test_it_comes_back_as_it_was() -> None:
    kept = made_kept()
    data = json.loads(json.dumps(as_json(kept), allow_nan=False))
    assert data["schema"] == SCHEMA and from_json(data) == kept
    assert kept.verdict == "one" and kept.names == ["steer_dead_time"]


@given(st.dictionaries(st.text(min_size=1), st.floats(allow_nan=False, allow_infinity=False)))
def test_values_keep_every_bit(values: dict[str, float]) -> None:
    kept = made_kept()._replace(recalibrated_values=values, shape=None)
    assert from_json(json.loads(json.dumps(as_json(kept)))) == kept


def nothing_missing(excitation: dict[str, Excitation]) -> Diagnosis:
    return Diagnosis(
        verdict=Verdict(VerdictKind.NONE_MISSING, (), (Reason(Criterion.NOTHING_BROKEN),)),
        link=None,
        location=None,
        links_before=(),
        excitation=excitation,
        problem=PROBLEM,
        repaired=SUMMARY,
        lack_of_fit_after={},
        unobservable_links={},
    )


def test_nothing_found_where_nothing_could_have_been_seen_is_no_answer() -> None:
    found = nothing_missing({"steer_lag": Excitation(0.1, False, (Shortage("moving_s", 3.0, 20.0),))})
    kept = make_search_result(found, "physics", 1.0)
    assert kept.verdict == "cannot_test" and "record a drive with more: 3 s above" in kept.answer["words"][0]
    unseen = {"name": "steer_lag", "criterion": "not_excited", "signal": "moving_s", "value": 3.0, "limit": 20.0}
    visible, *others = kept.answer["reasons"]
    assert visible == {"name": "", "criterion": "nothing_visible"} and others == [{**unseen, "stage": "untestable"}]
    seen = found._replace(excitation={"steer_lag": Excitation(2.0, True, ())})
    physics, hybrid = (make_search_result(seen, kind, 1.0) for kind in ("physics", "hybrid"))
    assert physics.verdict == "none_missing" and hybrid.answer["absorbed"] and not physics.answer["absorbed"]
    assert physics.answer["reasons"] == [{"name": "", "criterion": "nothing_broken"}]


def unmoving(*names: str) -> tuple[Reason, ...]:
    stage = RejectionStage.UNTESTABLE
    return tuple(Reason(Criterion.UNMOVING, name, 0.001, 0.004, stage=stage) for name in names)


def test_what_moves_nothing_that_is_compared_could_not_have_been_seen() -> None:
    excitation = {"steer_lag": Excitation(2.0, True, ()), "side_wind": Excitation(2.0, True, ())}
    found = nothing_missing(excitation)
    single = make_search_result(found._replace(unmoving=unmoving("side_wind")), "physics", 1.0)
    assert single.verdict == "none_missing" and list(single.answer["untold"]) == ["side_wind"]
    assert "by 0.4% of that signal" in single.answer["untold"]["side_wind"]
    assert not single.answer["excitation"]["side_wind"]["enough"]
    assert single.answer["excitation"]["steer_lag"]["enough"]
    none = make_search_result(found._replace(unmoving=unmoving(*excitation)), "physics", 1.0)
    assert none.verdict == "cannot_test" and "no value" in none.answer["words"][0]


def test_the_keys_of_the_file_stay_whatever_the_fields_are_called() -> None:
    assert set(KEYS) == set(SearchResult._fields)
    assert list(as_json(made_kept())) == [
        "schema", "answer", "null", "repaired", "free", "signal", "regions", "shape", "seconds", "named", "foretold",
    ]  # fmt: skip


def test_a_reason_is_written_with_its_numbers() -> None:
    reason = Reason(Criterion.EVIDENCE, "steer_lag", 3.0, 6.0, key="steer")
    found = {"name": "steer_lag", "criterion": "evidence", "signal": "steer", "value": 3.0, "limit": 6.0}
    assert reason_entry(reason) == found
    assert reason_entry(reason._replace(value=float("nan"), key="")) == {
        "name": "steer_lag",
        "criterion": "evidence",
        "limit": 6.0,
    }
