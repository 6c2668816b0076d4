"""INS frames that come late, by time and not by signal."""

from __future__ import annotations

import math

import pytest

from tests.effects.shared import driven, fixes, motions, reports, same, through
from tests.plant.drives import DT_S
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import Ins


@pytest.mark.parametrize("ticks", [1, 8])
def test_every_field_is_late_by_the_ticks_and_the_reports_are_not(ticks: int) -> None:
    with_it = driven("physics", {"ins_latency": {"delay_s": ticks * DT_S}})
    without = driven("physics", {})
    assert motions(with_it) == motions(without) and same(reports(with_it), reports(without))
    assert same(fixes(with_it)[ticks:], fixes(without)[:-ticks])
    assert not same(fixes(with_it), fixes(without))


def test_before_the_first_tick_the_car_rolled_straight_on() -> None:
    start = Start(3.0, -2.0, 0.7, 10.0)
    out = fixes(driven("physics", {"ins_latency": {"delay_s": 0.05}}, start=start))
    for k in range(5):
        back_m = (5 - k) * DT_S * 10.0
        where = (3.0 - back_m * math.cos(0.7), -2.0 - back_m * math.sin(0.7), 0.7, 10.0)
        assert out[k][:4] == pytest.approx(where)


def test_between_two_ticks_headings_go_the_short_way() -> None:
    turning = [Ins(float(k), 0.0, heading, 0.0, 0.0, 0.0) for k, heading in enumerate([3.1, 3.14, -3.12, -3.1])]
    out = through("ins_latency", {"delay_s": 0.005}, turning)
    assert [one.x_m for one in out] == pytest.approx([0.0, 0.5, 1.5, 2.5])
    middle = math.atan2(math.sin(3.14) + math.sin(-3.12), math.cos(3.14) + math.cos(-3.12))
    assert [one.heading_rad for one in out] == pytest.approx([3.1, 3.12, middle, -3.11])
