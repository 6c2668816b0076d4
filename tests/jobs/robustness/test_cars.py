"""Cars of a sweep: the nominal one, all corners in opposite pairs, then cars within; the same for the same seed."""

from __future__ import annotations

from itertools import product

from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.grade.margins import NOMINAL
from tunefree_hil.jobs.robustness.cars import make_cars
from tunefree_hil.tune.ensemble import CarRanges, EnsembleCar, FactorRange

RANGES = CarRanges(
    {"mass": FactorRange(0.9, 1.2), "lag": FactorRange(0.8, 1.3), "friction": FactorRange(0.7, 1.0)},
    {"steer.gain": FactorRange(0.95, 1.05)},
)
NUMBERS = CarRanges({}, {"steer.gain": FactorRange(0.95, 1.05), "brake.gain": FactorRange(0.9, 1.2)})


def ends(car: EnsembleCar) -> tuple[float, ...]:
    return tuple(getattr(car.variant, name) for name in RANGES.variant)


def test_all_corners_come_first_and_each_is_followed_by_its_opposite() -> None:
    cars = make_cars(RANGES, 12, 1)
    assert [car.number for car in cars] == list(range(12)) and cars[0] == EnsembleCar(0)
    corners = cars[1:9]
    assert {ends(car) for car in corners} == set(product((0.9, 1.2), (0.8, 1.3), (0.7, 1.0)))
    for one, other in zip(corners[::2], corners[1::2], strict=True):
        assert all(a != b for a, b in zip(ends(one), ends(other), strict=True))
        assert {one.numbers["steer.gain"], other.numbers["steer.gain"]} == {0.95, 1.05}
    assert all(ends(car) not in {ends(corner) for corner in corners} for car in cars[9:])


@given(st.integers(2, 40), st.integers(0, 2**20), st.sampled_from([RANGES, NUMBERS]))
def test_cars_are_within_their_ranges_and_follow_from_the_seed(count: int, seed: int, ranges: CarRanges) -> None:
    cars = make_cars(ranges, count, seed)
    assert len(cars) == count and cars == make_cars(ranges, count, seed)
    assert len({(car.variant, tuple(car.numbers.items())) for car in cars}) >= min(count, 3)
    for car in cars[1:]:
        for name, span in ranges.variant.items():
            assert span.low <= getattr(car.variant, name) <= span.high
        for name, span in ranges.numbers.items():
            assert span.low <= car.numbers[name] <= span.high
        assert car.variant.steer_delay_s == NOMINAL.steer_delay_s


def test_another_seed_gives_other_cars() -> None:
    assert make_cars(RANGES, 20, 1) != make_cars(RANGES, 20, 2)
    assert set(map(ends, make_cars(RANGES, 9, 1))) == set(map(ends, make_cars(RANGES, 9, 2)))
