"""Constants that no car has are refused by their key, of every plant that takes them."""

from __future__ import annotations

import math

import pytest

from tests.plant.drives import PLANTS, REST, car, command, drive
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench.vehicle import PLANTS as ALL_KINDS
from tunefree_hil.bench.vehicle import load_plant
from tunefree_hil.plant.constants import FARTHER, LEAST, NOT_BELOW_0, POSITIVE, SHARES, require_constants

KINDS = sorted(PLANTS)
# Of either sign, measured against another one (FARTHER), checked by the plant itself (plant/paper.py)
FREE = {"linkage_bend", "throttle_zero_frac", "sample_spacing_s"}


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
        *((name, value) for name, least in LEAST.items() for value in (least - 0.01, math.nan)),
        *((name, value) for name in SHARES for value in (-0.1, 1.1, 7.0, math.nan)),
    ],
)
def test_what_no_car_has_is_refused(kind: str, name: str, value: float) -> None:
    with pytest.raises(InputError) as caught:
        require_constants(kind, PLANTS[kind].defaults, {name: value})
    assert caught.value.key == f"plant.params.{name}" and caught.value.hint


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_no_key_of_a_plant_is_unchecked(kind: str) -> None:
    """A key that is added to a plant belongs into one of the lists."""
    lists = (POSITIVE, NOT_BELOW_0, tuple(LEAST), SHARES, tuple(FREE))
    found = {name: sum(name in one for one in lists) for name in load_plant(kind).defaults}
    assert {name for name, count in found.items() if count != 1} == set()


@pytest.mark.parametrize("name", sorted({*NOT_BELOW_0, *SHARES} & set(PLANTS["reference"].defaults)))
def test_what_a_car_may_have_none_of_it_drives_without(name: str) -> None:
    """The reference car with 0 of it, under power, on the brake, in a bend."""
    require_constants("reference", PLANTS["reference"].defaults, {name: 0.0})
    body, start = car("reference", {name: 0.0}), Start(speed_mps=4.0)
    moved = drive(body, lambda t: command(0.4) if t < 0.2 else command(REST, 0.3, 0.5), 0.4, start=start)
    assert all(math.isfinite(value) for one in moved for value in one.motion)


@pytest.mark.parametrize(("far", "near"), FARTHER.items())
def test_what_must_lie_farther_is_named_whichever_was_given(far: str, near: str) -> None:
    defaults = {far: 2.0, near: 1.0}
    for given, key in (({far: 1.0}, far), ({near: 2.5}, near)):
        with pytest.raises(InputError) as caught:
            require_constants("physics", defaults, given)
        assert caught.value.key == f"plant.params.{key}" and f"not more than {near}" in caught.value.message


def test_of_a_users_own_plant_only_that_knows_what_its_names_mean() -> None:
    require_constants("mine.py:PLANT", {"mass_kg": 1500.0}, {"mass_kg": -1.0})
