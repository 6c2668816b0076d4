"""The envelope of searched roads, and the roads to be verified that lie outside it."""

from __future__ import annotations

import pytest

from tunefree_hil.base.course import Course
from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec
from tunefree_hil.episode.scenario import build_course
from tunefree_hil.roads import envelope, outside, outside_text
from tunefree_hil.roads.coverage import DrivenQuantity


def course(low_mps: float, high_mps: float, curvature_1pm: float = 0.0, seconds: float = 20.0) -> Course:
    """From one speed to the other and on, with a bend at the end."""
    return build_course(
        ScenarioSpec(
            schema="tunefree.scenario/1",
            name="test",
            speed=ProfileSpec(t_s=[0.0, seconds, seconds + 8.0], value=[low_mps, high_mps, high_mps]),
            curvature=ProfileSpec(
                t_s=[0.0, seconds, seconds + 2.0, seconds + 6.0], value=[0.0, 0.0, curvature_1pm, curvature_1pm]
            ),
        ),
        0.01,
    )


SEARCHED = envelope([course(5.0, 22.0, 0.004), course(12.0, 2.0, 0.05, seconds=10.0)])


def test_the_envelope_has_speeds_and_accelerations_by_speed() -> None:
    assert (SEARCHED.speed_low_mps, SEARCHED.speed_high_mps) == pytest.approx((2.0, 22.0))
    assert SEARCHED.cells[4].lateral_accel_mps2 == pytest.approx(22.0**2 * 0.004, rel=0.01)
    assert SEARCHED.cells[0].lateral_accel_mps2 == pytest.approx(2.0**2 * 0.05, rel=0.01)
    assert SEARCHED.cells[2].accel_mps2 == pytest.approx(17.0 / 20.0)
    assert SEARCHED.cells[1].decel_mps2 == pytest.approx(1.0)
    assert SEARCHED.cells[3].decel_mps2 == 0.0


def test_a_searched_road_lies_inside() -> None:
    assert outside(SEARCHED, {"again": course(5.0, 22.0, 0.004), "gentle": course(7.0, 9.0)}) == []


def test_what_was_searched_at_the_next_speed_counts() -> None:
    """Between 15 and 20 m/s the searched roads are straight, above they bend with 1.9 m/s2."""
    assert SEARCHED.cells[3].lateral_accel_mps2 < 0.1
    assert outside(SEARCHED, {"near": course(18.0, 19.0, 0.0045)}) == []


@pytest.mark.parametrize(
    ("road", "quantity", "value"),
    [
        (course(20.0, 26.0), DrivenQuantity.SPEED, 26.0),
        (course(20.0, 21.0, 0.006), DrivenQuantity.LATERAL_ACCEL, 21.0**2 * 0.006),
        (course(5.0, 21.0, seconds=8.0), DrivenQuantity.ACCEL, 2.0),
        (course(20.0, 4.0, seconds=8.0), DrivenQuantity.DECEL, 2.0),
    ],
)
def test_what_was_not_searched_is_named(road: Course, quantity: DrivenQuantity, value: float) -> None:
    records = outside(SEARCHED, {"new": road, "again": course(5.0, 22.0, 0.004)})
    assert [(record.road, record.quantity) for record in records] == [("new", quantity)]
    assert records[0].value == pytest.approx(value, rel=0.02)
    assert records[0].limit < records[0].value
    text = outside_text(records[0])
    assert text.startswith("new is to be verified, and lies outside the searched envelope") and quantity.value in text


def test_a_standstill_outside_slow_roads_is_named() -> None:
    records = outside(SEARCHED, {"stop": course(4.0, 0.0, seconds=10.0)})
    assert [record.quantity for record in records] == [DrivenQuantity.SPEED] and records[0].value == 0.0


def test_an_envelope_needs_a_road() -> None:
    with pytest.raises(ValueError, match="needs a course"):
        envelope([])
