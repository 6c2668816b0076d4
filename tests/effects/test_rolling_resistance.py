"""Rolling resistance: a share of the car's own, at every speed, and never a push."""

from __future__ import annotations

import pytest

from tests.effects.shared import EFFECTS, KINDS, driven
from tests.plant.drives import PLANTS, car, command
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.units import G_MPS2


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("speed", [4.0, 20.0])
@pytest.mark.parametrize("extra", [-0.5, 2.0])
def test_deceleration_is_the_share_of_its_own(kind: str, speed: float, extra: float) -> None:
    def slowed(effect: dict[str, dict[str, float]]) -> float:
        return driven(kind, effect, lambda t: command(), 0.1, start=Start(speed_mps=speed))[-1].motion.speed_mps

    gained = slowed({}) - slowed({"rolling_resistance": {"extra_frac": extra}})
    assert gained == pytest.approx(0.1 * extra * PLANTS[kind].defaults["rolling_frac"] * G_MPS2, rel=0.01)


def test_it_is_of_the_laden_car_and_holds_a_standing_one() -> None:
    heavy = {"payload": {"mass_kg": 2000.0}}
    last = [
        driven("physics", {**heavy, **more}, lambda t: command(gear=3.0), 0.1)[-1].motion.speed_mps
        for more in ({}, {"rolling_resistance": {"extra_frac": 1.0}})
    ]
    assert last[0] - last[1] == pytest.approx(0.1 * PLANTS["physics"].defaults["rolling_frac"] * G_MPS2, rel=0.01)
    standing = driven(
        "physics", {"rolling_resistance": {"extra_frac": 9.0}}, lambda t: command(gear=3.0), 0.5, start=Start()
    )
    assert standing[-1].motion.x_m == 0.0 and standing[-1].motion.speed_mps == 0.0


def test_two_that_leave_less_than_nothing_are_refused() -> None:
    most = (EFFECTS["rolling_resistance"], {"extra_frac": -0.7})
    for kind in KINDS:
        with pytest.raises(InputError) as caught:
            car(kind, effects=(most, most))
        assert caught.value.key == "rolling_resistance"
