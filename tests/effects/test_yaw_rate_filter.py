"""A gyro behind a filter: a first-order lag of the reported yaw rate."""

from __future__ import annotations

import math

import pytest

from tests.effects.shared import driven, fixes, motions, reports, same, through
from tests.plant.drives import DT_S
from tunefree_hil.base.records import Report


def test_a_step_is_answered_by_an_exponential() -> None:
    out = through("yaw_rate_filter", {"tau_s": 0.1}, [Report(yaw_rate_radps=0.5, speed_mps=3.0)] * 40)
    assert [one.yaw_rate_radps for one in out] == pytest.approx(
        [0.5 * (1.0 - math.exp(-DT_S * (k + 1) / 0.1)) for k in range(40)]
    )
    assert all(one.speed_mps == 3.0 for one in out)


def test_the_rest_of_the_report_and_the_ins_are_as_before() -> None:
    with_it, without = driven("physics", {"yaw_rate_filter": {"tau_s": 0.2}}), driven("physics", {})
    assert motions(with_it) == motions(without) and same(fixes(with_it), fixes(without))
    for seen, plain in zip(reports(with_it), reports(without), strict=True):
        assert same(seen._replace(yaw_rate_radps=0.0), plain._replace(yaw_rate_radps=0.0))
    assert max(one.yaw_rate_radps for one in reports(with_it)) < 0.9 * max(
        one.yaw_rate_radps for one in reports(without)
    )
