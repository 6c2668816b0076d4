"""Wind against the car: its own drag at the speed through the air."""

from __future__ import annotations

import pytest

from tests.effects.shared import KINDS, constants, driven
from tests.plant.drives import PLANTS, command
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import GEAR_NEUTRAL


def rate(kind: str, effects: dict[str, dict[str, float]], speed: float) -> float:
    return driven(kind, effects, lambda t: command(), 0.01, start=Start(speed_mps=speed))[-1].motion.speed_mps / 0.01


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("speed", "wind"), [(20.0, 10.0), (20.0, -8.0), (5.0, 10.0), (5.0, -12.0)])
def test_force_is_that_of_the_relative_wind(kind: str, speed: float, wind: float) -> None:
    half_rho_a = 0.5 * 1.2 * PLANTS[kind].defaults["drag_area_m2"]
    air = speed + wind
    expected = half_rho_a * (air * abs(air) - speed * speed) / constants(kind).mass_kg
    slowed = rate(kind, {}, speed) - rate(kind, {"head_wind": {"wind_mps": wind}}, speed)
    assert slowed == pytest.approx(expected, rel=5e-3)


def test_it_blows_on_all_the_area_that_there_is() -> None:
    both = {"aero_drag": {"drag_area_m2": 0.7}, "head_wind": {"wind_mps": 10.0}}
    once = rate("physics", {}, 20.0) - rate("physics", {"head_wind": {"wind_mps": 10.0}}, 20.0)
    more = rate("physics", {"aero_drag": {"drag_area_m2": 0.7}}, 20.0) - rate("physics", both, 20.0)
    assert more == pytest.approx(2.0 * once, rel=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_a_storm_from_behind_moves_a_standing_car_and_a_breeze_does_not(kind: str) -> None:
    def gone(wind: float) -> float:
        effect = {"head_wind": {"wind_mps": wind}}
        return driven(kind, effect, lambda t: command(gear=GEAR_NEUTRAL), 1.0, start=Start())[-1].motion.x_m

    assert gone(-40.0) > 0.05 and gone(-8.0) == gone(40.0) == 0.0
