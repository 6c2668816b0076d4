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
    MIN_REVERSAL_RAD,
    NOMINAL,
    POINTS,
    SWEEPS,
    CarVariant,
    DriveOutcome,
    Margin,
    MarginSearch,
    count_reversals,
    describe_variant,
    failure_rate,
    failure_rate_at_points,
    is_near_nominal,
    is_smaller_margin,
    steering_activity,
)

CALM, REPLANS, LEFT = DriveOutcome("finished", 0), DriveOutcome("finished", 2), DriveOutcome("left_lane", 1)
DT_S = 0.01


def walked(walk: MarginSearch, bad: dict[float, DriveOutcome], field: str) -> list[float]:
    """Walk to the end: values in `bad` come out as they say, others calm. The values that were driven."""
    asked = []
    while (car := walk.next_variant) is not None:
        asked.append(getattr(car, field))
        walk.record_outcomes({"first": CALM, "second": bad.get(asked[-1], CALM)})
    return asked


def test_a_known_delay_margin_is_found() -> None:
    walk = MarginSearch(SWEEPS[DELAY])
    asked = walked(walk, {0.07: REPLANS, 0.08: LEFT}, "steer_delay_s")
    assert walk.margin == Margin(0.07, False, "second", "re-plan")
    assert asked == [n / 100.0 for n in range(8)] and walk.remaining == 0


def test_behind_the_first_bad_value_nothing_counts() -> None:
    """Calm again at 50 ms and more: the margin is 40 ms all the same, and nobody drives those."""
    walk = MarginSearch(SWEEPS[DELAY])
    assert walked(walk, {0.04: LEFT}, "steer_delay_s")[-1] == 0.04
    assert walk.margin == Margin(0.04, False, "second", "left_lane")


@given(st.sets(st.integers(0, 30)))
def test_whatever_the_outcomes_the_first_bad_one_counts(bad: set[int]) -> None:
    walk = MarginSearch(SWEEPS[DELAY])
    walked(walk, {n / 100.0: REPLANS for n in bad}, "steer_delay_s")
    found = walk.margin
    assert found is not None
    assert (found.value, found.at_least) == ((min(bad) / 100.0, False) if bad else (0.30, True))


def test_one_that_replans_as_it_is_has_no_margin() -> None:
    for what, none in ((DELAY, 0.0), (GAIN_UP, 1.0), (GAIN_DOWN, 1.0)):
        walk = MarginSearch(SWEEPS[what])
        walk.record_outcomes({"first": REPLANS})
        assert walk.margin == Margin(none, False, "first", "re-plan") and walk.next_variant is None


def test_gain_goes_both_ways_from_one() -> None:
    up, down = MarginSearch(SWEEPS[GAIN_UP]), MarginSearch(SWEEPS[GAIN_DOWN])
    assert walked(up, {1.6: REPLANS, 0.7: LEFT}, "steer_gain")[:3] == [1.0, 1.05, 1.1]
    assert walked(down, {1.6: REPLANS, 0.7: LEFT}, "steer_gain") == [1.0, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7]
    assert up.margin == Margin(1.6, False, "second", "re-plan")
    assert down.margin == Margin(0.7, False, "second", "left_lane")


def test_a_walk_changes_one_thing() -> None:
    with pytest.raises(ValueError, match="one field"):
        MarginSearch((NOMINAL, CarVariant(mass=1.1, lag=1.1)))


def test_less_is_less_both_ways_and_a_cap_is_more_than_the_same_value_found() -> None:
    assert is_smaller_margin(Margin(0.06), Margin(0.11)) and not is_smaller_margin(Margin(0.11), Margin(0.06))
    assert not is_smaller_margin(Margin(0.06), Margin(0.06))
    assert is_smaller_margin(Margin(0.30), Margin(0.30, True)) and not is_smaller_margin(
        Margin(0.30, True), Margin(0.30)
    )
    assert is_smaller_margin(Margin(0.8), Margin(0.5), down=True) and not is_smaller_margin(
        Margin(0.5), Margin(0.8), down=True
    )
    assert is_smaller_margin(Margin(0.3), Margin(0.3, True), down=True)


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
    assert len(set(cars)) == len(cars) and NOMINAL not in cars
    assert {is_near_nominal(car) for car in POINTS["together"]} == {True, False}
    assert (
        is_near_nominal(CarVariant(mass=0.8, lag=1.2))
        and not is_near_nominal(CarVariant(mass=1.21))
        and not is_near_nominal(CarVariant(friction=0.7))
    )
    assert not is_near_nominal(CarVariant(steer_delay_s=0.01))


def test_a_car_in_words() -> None:
    assert describe_variant(NOMINAL) == "as it is"
    assert describe_variant(CarVariant(mass=1.3, dead_time=0.6)) == "mass +30 %, dead time -40 %"
    assert describe_variant(CarVariant(steer_delay_s=0.06)) == "60 ms more steer dead time"


def test_rates_tell_inside_from_beyond_and_failures_from_replans() -> None:
    inside, beyond = POINTS["mass"][0], POINTS["mass"][-1]
    driven = {
        inside: {"a": CALM, "b": REPLANS},
        beyond: {"a": LEFT, "b": CALM, "c": DriveOutcome("diverged", 0)},
        SWEEPS[DELAY][5]: {"a": LEFT},  # a walk's car is none of the fixed ones
        NOMINAL: {"a": LEFT},
    }
    assert failure_rate_at_points(driven, near_nominal=True) == (0, 2)
    assert failure_rate_at_points(driven, near_nominal=False) == (2, 3)
    assert math.isnan(failure_rate([]).share) and failure_rate([LEFT, CALM]).share == 0.5


def test_steering_of_a_sine() -> None:
    """Two reversals a period; the rate's RMS is a w / sqrt(2)."""
    t_s = np.arange(0.0, 20.0, DT_S)
    steering = steering_activity([0.5 * np.sin(2.0 * np.pi * 0.5 * t_s)], DT_S)
    assert steering is not None
    assert steering.rate_rms_radps == pytest.approx(0.5 * np.pi / math.sqrt(2.0), rel=1e-3)
    assert steering.reversals_per_s == pytest.approx(1.0, abs=0.1)


def test_steering_over_drives_is_weighted_by_their_time() -> None:
    ramp, still = np.linspace(0.0, 1.0, 101), np.zeros(301)
    steering = steering_activity([ramp, still, np.full(50, np.nan)], DT_S)
    assert steering is not None
    assert steering.rate_rms_radps == pytest.approx(math.sqrt(1.0 / 4.0)) and steering.reversals_per_s == 0.0
    assert steering_activity([np.full(9, np.nan)], DT_S) is None and steering_activity([], DT_S) is None


@given(st.lists(st.floats(-0.49, 0.49), min_size=1, max_size=60))
def test_noise_below_the_gap_is_no_reversal(noise: list[float]) -> None:
    assert count_reversals([MIN_REVERSAL_RAD * value for value in noise]) == 0


@given(st.lists(st.floats(1.1, 20.0), min_size=1, max_size=30), st.booleans())
def test_every_swing_beyond_the_gap_is_one_reversal(swings: list[float], left: bool) -> None:
    """A zigzag of n swings has n - 1 corners, whichever way it begins."""
    angles, way = [0.0], 1.0 if left else -1.0
    for swing in swings:
        angles += [angles[-1] + way * MIN_REVERSAL_RAD * swing * share for share in (0.3, 0.7, 1.0)]
        way = -way
    assert count_reversals(angles) == len(swings) - 1
