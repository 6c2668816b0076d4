"""What a search came to survives a file bit for bit."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st

from tests.gap.made_answer import made_kept
from tunefree_hil.gap.kept import SCHEMA, as_json, from_json


def test_it_comes_back_as_it_was() -> None:
    kept = made_kept()
    data = json.loads(json.dumps(as_json(kept), allow_nan=False))
    assert data["schema"] == SCHEMA and from_json(data) == kept
    assert kept.verdict == "one" and kept.names == ["steer_dead_time"]


@given(st.dictionaries(st.text(min_size=1), st.floats(allow_nan=False, allow_infinity=False)))
def test_values_keep_every_bit(values: dict[str, float]) -> None:
    kept = made_kept()._replace(null=values, shape=None)
    assert from_json(json.loads(json.dumps(as_json(kept)))) == kept
