"""Constants that no car has are refused by their key, of every plant that takes them."""

from __future__ import annotations

import math

import pytest

from tests.plant.drives import PLANTS
from tunefree_hil.base.errors import InputError
from tunefree_hil.plant.constants import FARTHER, NOT_BELOW_0, POSITIVE, require_constants

KINDS = sorted(PLANTS)


@pytest.mark.parametrize("kind", KINDS)
def test_a_plants_own_constants_are_a_cars(kind: str) -> None:
    defaults = PLANTS[kind].defaults
    require_constants(kind, defaults, {})
    require_constants(kind, defaults, defaults)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name in POSITIVE for value in (0.0, -1.0, math.inf, math.nan)),
        *((name, value) for name in NOT_BELOW_0 for value in (-1.0, math.inf)),
    ],
)
def test_what_no_car_has_is_refused(kind: str, name: str, value: float) -> None:
    with pytest.raises(InputError) as caught:
        require_constants(kind, PLANTS[kind].defaults, {name: value})
    assert caught.value.key == f"plant.params.{name}" and caught.value.hint


@pytest.mark.parametrize(("far", "near"), FARTHER.items())
def test_what_must_lie_farther_is_named_whichever_was_given(far: str, near: str) -> None:
    defaults = {far: 2.0, near: 1.0}
    for given, key in (({far: 1.0}, far), ({near: 2.5}, near)):
        with pytest.raises(InputError) as caught:
            require_constants("physics", defaults, given)
        assert caught.value.key == f"plant.params.{key}" and f"not more than {near}" in caught.value.message


def test_of_a_users_own_plant_only_that_knows_what_its_names_mean() -> None:
    require_constants("mine.py:PLANT", {"mass_kg": 1500.0}, {"mass_kg": -1.0})
