"""A gyro behind a filter: a first-order lag of the reported yaw rate."""

from __future__ import annotations

import math

import pytest

from tests.effects.shared import driven, fixes, motions, reports, same, through
from tests.plant.drives import DT_S
from tunefree_hil.base.records import Report


def test_a_turn_is_followed_by_the_filters_own_time() -> None:
    """Of a steady sine a first-order lag leaves cos(a), later by a = atan(w tau); no half tick beside it."""
    turn = 2.0 * math.pi * 0.7
    out = through(
        "yaw_rate_filter",
        {"tau_s": 0.1},
        [Report(yaw_rate_radps=0.5 * math.sin(turn * DT_S * k), speed_mps=3.0) for k in range(400)],
    )
    late = math.atan(turn * 0.1)
    asked = [0.5 * math.cos(late) * math.sin(turn * DT_S * k - late) for k in range(200, 400)]
    assert [one.yaw_rate_radps for one in out[200:]] == pytest.approx(asked, abs=2e-4)
    assert all(one.speed_mps == 3.0 for one in out)


def test_the_rest_of_the_report_and_the_ins_are_as_before() -> None:
    with_it, without = driven("physics", {"yaw_rate_filter": {"tau_s": 0.2}}), driven("physics", {})
    assert motions(with_it) == motions(without) and same(fixes(with_it), fixes(without))
    for seen, plain in zip(reports(with_it), reports(without), strict=True):
        assert same(seen._replace(yaw_rate_radps=0.0), plain._replace(yaw_rate_radps=0.0))
    assert max(one.yaw_rate_radps for one in reports(with_it)) < 0.9 * max(
        one.yaw_rate_radps for one in reports(without)
    )
