"""What own logs make of an effect: nothing where they do not tell it, and of a limit that it lies beyond them."""

from __future__ import annotations

import pytest

from tests.gap.test_decide import spread, weighed
from tests.gap.test_interval import ALL, DELAY, fitted
from tunefree_hil.gap.ask import Modelled
from tunefree_hil.gap.interval import across
from tunefree_hil.gap.own_logs import known_of
from tunefree_hil.gap.problem import Free
from tunefree_hil.gap.usual import Usual, parted

LIMIT = Free("steer_rate_limit.rate_radps", 0.1, 20.0, True, float("inf"), -0.35, 1.35)
STEP = weighed(steer_rate_limit=spread(1.0))[0]


def model(free: Free, curve: float, z: float) -> Modelled:
    return Modelled(fitted(free, curve=curve, z=z), {})


@pytest.mark.parametrize("z", [0.2, 0.0])
def test_what_is_told_is_known_as_well_as_the_fit_knows_it_be_it_nothing(z: float) -> None:
    told = model(DELAY, 400.0, z)
    assert known_of("steer_dead_time", told, ALL) == across(told.fitted, ALL)


def test_what_is_not_told_is_not_known() -> None:
    assert known_of("steer_dead_time", model(DELAY, 0.0, 0.2), ALL) == {}


@pytest.mark.parametrize(("z", "news"), [(0.35, True), (0.75, False)])
def test_a_limit_below_all_that_the_own_logs_reached_came_later(z: float, news: bool) -> None:
    beyond = model(LIMIT, 0.0, 0.75)
    (limit,) = known_of("steer_rate_limit", beyond, ALL).items()
    assert limit == ("steer_rate_limit.rate_radps", (pytest.approx(LIMIT.value(0.75)), 0.0))
    usual = Usual({STEP.target: 0.5}, {"steer_rate_limit": {"rate_radps": limit[1]}}, frozenset({STEP.target}))
    found, words = parted([STEP], fitted(LIMIT, z=z), usual, ALL)
    assert bool(found) == news and bool(words) != news
