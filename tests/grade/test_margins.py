"""Margins from made-up outcomes: the first value that is not calm counts, whatever comes behind it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.grade.margins import (
    DELAY,
    GAIN_DOWN,
    GAIN_UP,
    POINTS,
    REVERSAL_GAP_RAD,
    SAME,
    WALKS,
    Came,
    Car,
    Margin,
    Walk,
    is_inside,
    is_less,
    rate_of,
    rates,
    reversals_of,
    said,
    steering_of,
)

CALM, REPLANS, LEFT = Came("finished", 0), Came("finished", 2), Came("left_lane", 1)
DT_S = 0.01


def walked(walk: Walk, bad: dict[float, Came], field: str) -> list[float]:
    """Walk to the end: values in `bad` come out as they say, others calm. The values that were driven."""
    asked = []
    while (car := walk.ahead) is not None:
        asked.append(getattr(car, field))
        walk.tell({"first": CALM, "second": bad.get(asked[-1], CALM)})
    return asked


def test_a_known_delay_margin_is_found() -> None:
    walk = Walk(WALKS[DELAY])
    asked = walked(walk, {0.07: REPLANS, 0.08: LEFT}, "steer_delay_s")
    assert walk.found == Margin(0.07, False, "second", "re-plan")
    assert asked == [n / 100.0 for n in range(8)] and walk.left == 0


def test_behind_the_first_bad_value_nothing_counts() -> None:
    """Calm again at 50 ms and more: the margin is 40 ms all the same, and nobody drives those."""
    walk = Walk(WALKS[DELAY])
    assert walked(walk, {0.04: LEFT}, "steer_delay_s")[-1] == 0.04
    assert walk.found == Margin(0.04, False, "second", "left_lane")


@given(st.sets(st.integers(0, 30)))
def test_whatever_the_outcomes_the_first_bad_one_counts(bad: set[int]) -> None:
    walk = Walk(WALKS[DELAY])
    walked(walk, {n / 100.0: REPLANS for n in bad}, "steer_delay_s")
    found = walk.found
    assert found is not None
    assert (found.value, found.at_least) == ((min(bad) / 100.0, False) if bad else (0.30, True))


def test_one_that_replans_as_it_is_has_no_margin() -> None:
    for what, none in ((DELAY, 0.0), (GAIN_UP, 1.0), (GAIN_DOWN, 1.0)):
        walk = Walk(WALKS[what])
        walk.tell({"first": REPLANS})
        assert walk.found == Margin(none, False, "first", "re-plan") and walk.ahead is None


def test_gain_goes_both_ways_from_one() -> None:
    up, down = Walk(WALKS[GAIN_UP]), Walk(WALKS[GAIN_DOWN])
    assert walked(up, {1.6: REPLANS, 0.7: LEFT}, "steer_gain")[:3] == [1.0, 1.05, 1.1]
    assert walked(down, {1.6: REPLANS, 0.7: LEFT}, "steer_gain") == [1.0, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7]
    assert up.found == Margin(1.6, False, "second", "re-plan")
    assert down.found == Margin(0.7, False, "second", "left_lane")


def test_a_walk_changes_one_thing() -> None:
    with pytest.raises(ValueError, match="one field"):
        Walk((SAME, Car(mass=1.1, lag=1.1)))


def test_less_is_less_both_ways_and_a_cap_is_more_than_the_same_value_found() -> None:
    assert is_less(Margin(0.06), Margin(0.11)) and not is_less(Margin(0.11), Margin(0.06))
    assert not is_less(Margin(0.06), Margin(0.06))
    assert is_less(Margin(0.30), Margin(0.30, True)) and not is_less(Margin(0.30, True), Margin(0.30))
    assert is_less(Margin(0.8), Margin(0.5), down=True) and not is_less(Margin(0.5), Margin(0.8), down=True)
    assert is_less(Margin(0.3), Margin(0.3, True), down=True)


def test_the_cars_are_those_that_were_asked_for() -> None:
    values = {group: sorted({getattr(car, group.replace(" ", "_")) for car in cars})
              for group, cars in POINTS.items() if group != "together"}  # fmt: skip
    assert values == {
        "mass": [0.9, 1.1, 1.2, 1.3],
        "lag": [0.6, 0.8, 1.2, 1.4],
        "dead time": [0.6, 0.8, 1.2, 1.4],
        "friction": [0.6, 0.7, 0.8, 0.9],
        "steer gain": [0.6, 0.8, 1.2, 1.4],
    }
    cars = [car for some in POINTS.values() for car in some]
    assert len(set(cars)) == len(cars) and SAME not in cars
    assert {is_inside(car) for car in POINTS["together"]} == {True, False}
    assert is_inside(Car(mass=0.8, lag=1.2)) and not is_inside(Car(mass=1.21)) and not is_inside(Car(friction=0.7))
    assert not is_inside(Car(steer_delay_s=0.01))


def test_a_car_in_words() -> None:
    assert said(SAME) == "as it is"
    assert said(Car(mass=1.3, dead_time=0.6)) == "mass +30 %, dead time -40 %"
    assert said(Car(steer_delay_s=0.06)) == "60 ms more steer dead time"


def test_rates_tell_inside_from_beyond_and_failures_from_replans() -> None:
    inside, beyond = POINTS["mass"][0], POINTS["mass"][-1]
    driven = {
        inside: {"a": CALM, "b": REPLANS},
        beyond: {"a": LEFT, "b": CALM, "c": Came("diverged", 0)},
        WALKS[DELAY][5]: {"a": LEFT},  # a walk's car is none of the fixed ones
        SAME: {"a": LEFT},
    }
    assert rates(driven, inside=True) == (0, 2)
    assert rates(driven, inside=False) == (2, 3)
    assert math.isnan(rate_of([]).share) and rate_of([LEFT, CALM]).share == 0.5


def test_steering_of_a_sine() -> None:
    """Two reversals a period; the rate's RMS is a w / sqrt(2)."""
    t_s = np.arange(0.0, 20.0, DT_S)
    steering = steering_of([0.5 * np.sin(2.0 * np.pi * 0.5 * t_s)], DT_S)
    assert steering is not None
    assert steering.rate_rms_radps == pytest.approx(0.5 * np.pi / math.sqrt(2.0), rel=1e-3)
    assert steering.reversals_per_s == pytest.approx(1.0, abs=0.1)


def test_steering_over_drives_is_weighted_by_their_time() -> None:
    ramp, still = np.linspace(0.0, 1.0, 101), np.zeros(301)
    steering = steering_of([ramp, still, np.full(50, np.nan)], DT_S)
    assert steering is not None
    assert steering.rate_rms_radps == pytest.approx(math.sqrt(1.0 / 4.0)) and steering.reversals_per_s == 0.0
    assert steering_of([np.full(9, np.nan)], DT_S) is None and steering_of([], DT_S) is None


@given(st.lists(st.floats(-0.49, 0.49), min_size=1, max_size=60))
def test_noise_below_the_gap_is_no_reversal(noise: list[float]) -> None:
    assert reversals_of([REVERSAL_GAP_RAD * value for value in noise]) == 0


@given(st.lists(st.floats(1.1, 20.0), min_size=1, max_size=30), st.booleans())
def test_every_swing_beyond_the_gap_is_one_reversal(swings: list[float], left: bool) -> None:
    """A zigzag of n swings has n - 1 corners, whichever way it begins."""
    angles, way = [0.0], 1.0 if left else -1.0
    for swing in swings:
        angles += [angles[-1] + way * REVERSAL_GAP_RAD * swing * share for share in (0.3, 0.7, 1.0)]
        way = -way
    assert reversals_of(angles) == len(swings) - 1
