"""The front axle's cornering stiffness: the understeer gradient, and which way it goes."""

from __future__ import annotations

import pytest

from tests.effects.shared import driven
from tests.plant.drives import REST, command
from tests.plant.test_single_track import holding_throttle
from tunefree_hil.base.course import Start
from tunefree_hil.plant.data_sheet import DEFAULTS

MASS, BASE, ARM = DEFAULTS["mass_kg"], DEFAULTS["wheelbase_m"], DEFAULTS["front_axle_m"]


@pytest.mark.parametrize("gain", [0.7, 1.4])
@pytest.mark.parametrize("speed", [6.0, 15.0])
def test_understeer_is_that_of_the_other_stiffness(speed: float, gain: float) -> None:
    """yaw rate = v delta / (L + K v^2), K = m (lr Cr - lf Cf) / (Cf Cr L), the front one multiplied; small angles."""
    front, rear = DEFAULTS["front_stiffness_n_per_rad"], DEFAULTS["rear_stiffness_n_per_rad"]
    front *= gain
    gradient = MASS * ((BASE - ARM) * rear - ARM * front) / (front * rear * BASE)
    road_wheel, throttle = 0.1 * BASE / speed**2, holding_throttle(speed)
    effect = {"front_stiffness": {"gain_frac": gain}}
    last = driven(
        "physics", effect, lambda t: command(throttle, REST, 16.0 * road_wheel), 5.0, start=Start(speed_mps=speed)
    )
    motion = last[-1].motion
    v = motion.speed_mps
    assert motion.yaw_rate_radps == pytest.approx(v * road_wheel / (BASE + gradient * v * v), rel=2e-3)


def test_softer_tyres_on_the_front_turn_the_two_track_car_less() -> None:
    def turned(gain: float) -> float:
        effect = {"front_stiffness": {"gain_frac": gain}}
        outputs = driven("reference", effect, lambda t: command(0.2, REST, 0.5), 3.0, start=Start(speed_mps=14.0))
        return outputs[-1].motion.yaw_rate_radps

    assert turned(0.7) < 0.99 * turned(1.0)
    assert turned(1.4) > turned(1.0)
