"""Air drag: with the square of speed, on top of the car's own."""

from __future__ import annotations

import pytest

from tests.effects.shared import EFFECTS, KINDS, constants, driven
from tests.plant.drives import car, command
from tunefree_hil.base.course import Start
from tunefree_hil.base.errors import InputError


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("speed", [8.0, 20.0])
def test_deceleration_is_half_rho_a_v_squared_over_m(kind: str, speed: float) -> None:
    def rate(effect: dict[str, dict[str, float]]) -> float:
        return driven(kind, effect, lambda t: command(), 0.01, start=Start(speed_mps=speed))[-1].motion.speed_mps / 0.01

    slowed = rate({}) - rate({"aero_drag": {"drag_area_m2": 1.5}})
    assert slowed == pytest.approx(0.5 * 1.2 * 1.5 * speed**2 / constants(kind).mass_kg, rel=2e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_no_more_can_be_taken_away_than_there_is(kind: str) -> None:
    car(kind, effects=((EFFECTS["aero_drag"], {"drag_area_m2": -0.7}),))
    with pytest.raises(InputError) as caught:
        car(kind, effects=((EFFECTS["aero_drag"], {"drag_area_m2": -0.8}),))
    assert caught.value.key == "aero_drag"
