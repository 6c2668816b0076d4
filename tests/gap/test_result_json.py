"""What a search came to survives a file bit for bit."""

from __future__ import annotations

import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.gap.made_answer import made_kept
from tunefree_hil.gap.estimation.least_squares import Fitted
from tunefree_hil.gap.measured.blocks import blocks_of
from tunefree_hil.gap.measured.excitation import Excited
from tunefree_hil.gap.pipeline import Named
from tunefree_hil.gap.result import SCHEMA, as_json, from_json, keep
from tunefree_hil.gap.workers.worker import Modelled, Question

FITTED = Fitted("", (), np.zeros(0), (), {}, np.zeros((0, 0)), {}, {})
MODELLED = Modelled(FITTED, {})
QUESTION_OF = Question(MODELLED, blocks_of([9000], 0.01), {}, {}, (), {})


def test_it_comes_back_as_it_was() -> None:
    kept = made_kept()
    data = json.loads(json.dumps(as_json(kept), allow_nan=False))
    assert data["schema"] == SCHEMA and from_json(data) == kept
    assert kept.verdict == "one" and kept.names == ["steer_dead_time"]


@given(st.dictionaries(st.text(min_size=1), st.floats(allow_nan=False, allow_infinity=False)))
def test_values_keep_every_bit(values: dict[str, float]) -> None:
    kept = made_kept()._replace(null=values, shape=None)
    assert from_json(json.loads(json.dumps(as_json(kept)))) == kept


def test_nothing_found_where_nothing_could_have_been_seen_is_no_answer() -> None:
    lacking = Excited(0.1, False, ("3 s above 2 m/s, 20 are needed",))
    found = Named(
        "none_missing", (), (), "", None, None, (), {"steer_lag": lacking}, (), QUESTION_OF, MODELLED, {}, {}, {}, ()
    )  # fmt: skip
    kept = keep(found, "physics", 1.0)
    assert kept.verdict == "cannot_test" and "record a drive with more: 3 s above" in kept.answer["words"][0]
    seen = found._replace(excitation={"steer_lag": Excited(2.0, True, ())})
    assert keep(seen, "physics", 1.0).verdict == "none_missing"
    assert keep(seen, "hybrid", 1.0).answer["absorbed"] and not keep(seen, "physics", 1.0).answer["absorbed"]


def test_what_moves_nothing_that_is_compared_could_not_have_been_seen() -> None:
    held = {"steer_lag": Excited(2.0, True, ()), "side_wind": Excited(2.0, True, ())}
    found = Named("none_missing", (), (), "", None, None, (), held, (), QUESTION_OF, MODELLED, {}, {}, {}, ())
    one = keep(found._replace(unmoved={"side_wind": "no value"}), "physics", 1.0)
    assert one.verdict == "none_missing" and one.answer["untold"] == {"side_wind": "no value"}
    assert not one.answer["excitation"]["side_wind"]["enough"] and one.answer["excitation"]["steer_lag"]["enough"]
    none = keep(found._replace(unmoved=dict.fromkeys(held, "no value")), "physics", 1.0)
    assert none.verdict == "cannot_test" and "no value" in none.answer["words"][0]
