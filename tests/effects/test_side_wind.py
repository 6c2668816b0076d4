"""A force from the side at the centre of mass: where the car drifts, and what the accelerometer feels."""

from __future__ import annotations

import numpy as np
import pytest

from tests.effects.shared import KINDS, constants, driven
from tests.plant.drives import REST, command
from tests.plant.test_single_track import holding_throttle
from tunefree_hil.base.course import Start
from tunefree_hil.base.records import GEAR_NEUTRAL, Disturbance, Motion


@pytest.mark.parametrize("speed", [8.0, 20.0])
def test_steady_drift_of_an_understeering_car(speed: float) -> None:
    """The two linear equations of side speed and yaw rate, solved, with a force and no steering."""
    front, rear = 120e3, 170e3
    params = {"front_stiffness_n_per_rad": front, "rear_stiffness_n_per_rad": rear}
    effect, throttle = {"side_wind": {"force_n": 600.0}}, holding_throttle(speed)
    last = driven("physics", effect, lambda t: command(throttle), 6.0, start=Start(speed_mps=speed), params=params)[-1]
    p, v = constants("physics"), last.motion.speed_mps
    a, b, mass = p.front_axle_m, p.rear_axle_m, p.mass_kg
    matrix = np.array(
        [
            [-(front + rear) / v, -(a * front - b * rear) / v - mass * v],
            [-(a * front - b * rear) / v, -(a * a * front + b * b * rear) / v],
        ]
    )
    side, yaw = np.linalg.solve(matrix, [-600.0, 0.0])
    assert last.motion.side_speed_mps == pytest.approx(side, rel=5e-3)
    assert last.motion.yaw_rate_radps == pytest.approx(yaw, rel=5e-3)
    assert last.motion.lateral_accel_mps2 == pytest.approx(v * yaw, rel=5e-3), "no gravity in it"


@pytest.mark.parametrize("kind", KINDS)
def test_it_pushes_to_the_left_by_force_over_mass(kind: str) -> None:
    def driven_at(force: float) -> list[float]:
        effect = {"side_wind": {"force_n": force}}
        outputs = driven(kind, effect, lambda t: command(0.2, REST), 0.5, start=Start(speed_mps=20.0))
        return [out.motion.y_m for out in outputs] + [outputs[1].motion.lateral_accel_mps2]

    left, right = driven_at(900.0), driven_at(-900.0)
    assert left[-2] > 0.005 and right[-2] == pytest.approx(-left[-2], rel=0.02)
    assert left[-1] == pytest.approx(900.0 / constants(kind).mass_kg, rel=0.15), "at first, before the tyres hold"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("relaxation_m", [0.0, 0.8])
def test_a_wind_of_the_road_is_the_same_and_adds_up(kind: str, relaxation_m: float) -> None:
    force_n = 900.0

    def motion(of_effect: float, of_road: float) -> Motion:
        effects = {"side_wind": {"force_n": of_effect * force_n}, "tyre_relaxation": {"length_m": relaxation_m}}
        road = Disturbance(side_wind_mps2=of_road * force_n / constants(kind).mass_kg)
        outputs = driven(kind, effects, lambda t: command(0.2, REST), 0.5, start=Start(speed_mps=20.0), road=road)
        return outputs[-1].motion

    by_effect = motion(1.0, 0.0)
    assert by_effect.y_m > 0.005, "to the left"
    assert motion(0.0, 1.0) == pytest.approx(by_effect, rel=1e-9, abs=1e-12)
    assert motion(0.3, 0.7) == pytest.approx(by_effect, rel=1e-9, abs=1e-12)
    assert motion(1.0, -1.0).y_m == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_standing_car_stays_and_feels_nothing(kind: str) -> None:
    for effect, road in (({"side_wind": {"force_n": 900.0}}, Disturbance()), ({}, Disturbance(side_wind_mps2=0.5))):
        outputs = driven(kind, effect, lambda t: command(gear=GEAR_NEUTRAL), 0.3, start=Start(), road=road)
        last = outputs[-1].motion
        assert (last.x_m, last.y_m, last.lateral_accel_mps2) == (0.0, 0.0, 0.0)
