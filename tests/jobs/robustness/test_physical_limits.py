"""What is beyond a car, whatever drives it: grip, power, brakes, steering; made roads of the nominal car are not."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.jobs.robustness.made_sweep import plan_of
from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec
from tunefree_hil.grade.margins import NOMINAL
from tunefree_hil.jobs.robustness.physical_limits import (
    CarAbility,
    PhysicalLimit,
    ability_of,
    find_physical_excesses,
    peak_demand,
)
from tunefree_hil.roads.drive_ability import DriveAbility
from tunefree_hil.tune.ensemble import EnsembleCar

ABILITY = CarAbility(0.9, 8.0, 0.2, DriveAbility((0.0, 10.0, 30.0), (4.0, 3.0, 0.5)))
G = 9.80665


def road(speed: list[float], curvature: float = 0.0, grade: float = 0.0, friction: float = 1.0) -> ScenarioSpec:
    def level(value: float) -> ProfileSpec:
        return ProfileSpec(t_s=[0.0, 10.0], value=[value, value])

    t_s = [10.0 * i / (len(speed) - 1) for i in range(len(speed))]
    return ScenarioSpec(
        schema="tunefree.scenario/1",
        name="made",
        speed=ProfileSpec(t_s=t_s, value=speed),
        curvature=level(curvature),
        grade=level(grade),
        friction=level(friction),
    )


def beyond(spec: ScenarioSpec, **factors: float) -> list[PhysicalLimit]:
    car = EnsembleCar(1, NOMINAL._replace(**factors))
    return [excess.limit for excess in find_physical_excesses(spec, car, ABILITY)]


def test_each_limit_is_found_alone() -> None:
    assert beyond(road([10.0, 10.0], 0.05)) == []  # 5 m/s2 of 8.8
    assert beyond(road([10.0, 10.0], 0.1)) == [PhysicalLimit.GRIP]
    assert beyond(road([10.0, 10.0], 0.05, friction=0.5)) == [PhysicalLimit.GRIP]
    assert beyond(road([5.0, 50.0])) == [PhysicalLimit.DRIVE]  # 4.5 m/s2
    assert beyond(road([28.0, 28.0], grade=0.09)) == [PhysicalLimit.DRIVE]
    assert beyond(road([85.0, 3.0])) == [PhysicalLimit.BRAKES]  # 8.2 m/s2
    assert beyond(road([1.0, 1.0], 0.25)) == [PhysicalLimit.STEERING]


def test_a_car_that_can_do_less_is_beyond_earlier() -> None:
    climb = road([9.0, 9.0], grade=math.asin(2.9 / G))
    assert beyond(climb) == [] and beyond(climb, mass=1.2) == [PhysicalLimit.DRIVE]
    turn = road([10.0, 10.0], 0.07)
    assert beyond(turn) == [] and beyond(turn, friction=0.7) == [PhysicalLimit.GRIP]
    tight = road([1.0, 1.0], 0.19)
    assert beyond(tight) == [] and beyond(tight, steer_gain=0.9) == [PhysicalLimit.STEERING]


def test_the_excess_is_the_ratio_of_what_is_asked_for() -> None:
    [excess] = find_physical_excesses(road([10.0, 10.0], 0.15), EnsembleCar(0), ABILITY)
    assert excess.ratio == pytest.approx(15.0 / (0.9 * G))


def test_no_made_road_is_beyond_the_nominal_car(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, 170)
    ability = ability_of(plan.bench, plan.order.model)
    assert ability.friction < 1.0 and ability.drive is not None and 0.0 < ability.curvature_1pm < 1.0
    assert not any(find_physical_excesses(one.spec, plan.cars[0], ability) for one in plan.roads)


def test_the_peak_is_where_speed_and_curvature_are() -> None:
    assert peak_demand(road([10.0, 20.0], -0.01)) == pytest.approx((19.95, 3.98, 1.0, 0.01), rel=1e-3)
    assert peak_demand(road([10.0, 10.0], grade=0.1)).longitudinal_mps2 == pytest.approx(G * math.sin(0.1))
