"""What a road asks of a car beyond what that car can do at all: no controller drives it.

Made roads lie within shares of the vehicle's limits (roads/limits.py). A heavier or less sticky car of an ensemble may
still be asked for more than it has. Limits are taken as wide as the data allow, so that no failure is excused by them.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.units import G_MPS2
from tunefree_hil.bench import Bench, model_of
from tunefree_hil.bench.load import drive_ability_of
from tunefree_hil.bench.vehicle import load_plant
from tunefree_hil.config.schema import ProfileSpec, ScenarioSpec
from tunefree_hil.roads.drive_ability import DriveAbility
from tunefree_hil.tune.ensemble import EnsembleCar

STEP_S = 0.1  # of the grid on which a road is looked at, that of its making


class PhysicalCriteria(NamedTuple):
    """When a road is beyond a car."""

    tolerance_share: float = 0.02  # of a limit: rounding of the road, and the error of a map
    friction: float = 1.0  # of a plant that does not state it: the upper end of dry asphalt, 0.8 to 1.0


CRITERIA = PhysicalCriteria()


class PhysicalLimit(Enum):
    """A limit of a car; the value is its name in a message."""

    GRIP = "grip of the tyres"
    DRIVE = "power of the drive"
    BRAKES = "power of the brakes"
    STEERING = "steering angle"


class PhysicalExcess(NamedTuple):
    """A limit with the largest ratio of what is asked for to what there is."""

    limit: PhysicalLimit
    ratio: float


class CarAbility(NamedTuple):
    """What the nominal car can do. Infinite, or None, where it is not known."""

    friction: float
    decel_mps2: float
    curvature_1pm: float
    drive: DriveAbility | None


class PeakDemand(NamedTuple):
    """The largest values of a road: lateral acceleration without bank and wind, longitudinal one with the slope."""

    speed_mps: float
    lateral_mps2: float
    longitudinal_mps2: float
    curvature_1pm: float


class _RoadDemand(NamedTuple):
    """A road between the points of the grid: speed, acceleration with the slope's share, lateral acceleration with the
    shares of bank and wind, curvature, friction.
    """

    speed_mps: np.ndarray
    pull_mps2: np.ndarray
    side_mps2: np.ndarray
    curvature_1pm: np.ndarray
    friction_frac: np.ndarray


def ability_of(bench: Bench, model: str) -> CarAbility:
    """The ability of a model of the bench's vehicle."""
    spec = model_of(bench, model)
    stated = {**load_plant(spec.plant.kind).defaults, **spec.plant.params}.get("friction", CRITERIA.friction)
    limits, nominal = bench.vehicle.limits, bench.vehicle.nominal
    curvature = math.inf
    if nominal.wheelbase_m and nominal.steer_ratio:
        curvature = math.tan(min(limits.steer_rad / nominal.steer_ratio, 1.5)) / nominal.wheelbase_m
    return CarAbility(stated, -limits.accel_mps2[0], curvature, drive_ability_of(bench.spec, bench.vehicle))


def find_physical_excesses(road: ScenarioSpec, car: EnsembleCar, ability: CarAbility) -> list[PhysicalExcess]:
    """The limits of a car that a road is beyond, in the order of PhysicalLimit."""
    demand, variant = _read_demand(road), car.variant
    grip = ability.friction * variant.friction * demand.friction_frac * G_MPS2
    drive = np.full(len(demand.speed_mps), np.inf)
    if ability.drive is not None:
        # its map has more than nothing at the speeds of a road, or the road would not have been made
        given = np.interp(demand.speed_mps, ability.drive.speed_mps, ability.drive.accel_mps2)
        drive = np.maximum(given, 1e-3) / variant.mass
    ratios = {
        PhysicalLimit.GRIP: np.hypot(demand.pull_mps2, demand.side_mps2) / grip,
        PhysicalLimit.DRIVE: np.maximum(demand.pull_mps2, 0.0) / drive,
        PhysicalLimit.BRAKES: np.maximum(-demand.pull_mps2, 0.0) * variant.mass / ability.decel_mps2,
        PhysicalLimit.STEERING: np.abs(demand.curvature_1pm) / (ability.curvature_1pm * variant.steer_gain),
    }
    excesses = [PhysicalExcess(limit, float(np.max(ratio))) for limit, ratio in ratios.items()]
    return [excess for excess in excesses if excess.ratio > 1.0 + CRITERIA.tolerance_share]


def peak_demand(road: ScenarioSpec) -> PeakDemand:
    """The largest values of a road."""
    demand = _read_demand(road)
    curvature = np.abs(demand.curvature_1pm)
    return PeakDemand(
        float(np.max(demand.speed_mps)),
        float(np.max(demand.speed_mps * demand.speed_mps * curvature)),
        float(np.max(np.abs(demand.pull_mps2))),
        float(np.max(curvature)),
    )


def _read_demand(road: ScenarioSpec) -> _RoadDemand:
    time_s = _grid(road)
    speed = _values(road.speed, time_s, 0.0)
    side = G_MPS2 * np.sin(_values(road.bank, time_s, 0.0)) - _values(road.side_wind, time_s, 0.0)
    curvature, middle_mps = _middle(_values(road.curvature, time_s, 0.0)), _middle(speed)
    return _RoadDemand(
        middle_mps,
        np.diff(speed) / STEP_S + G_MPS2 * np.sin(_middle(_values(road.grade, time_s, 0.0))),
        middle_mps * middle_mps * curvature + _middle(side),
        curvature,
        _middle(_values(road.friction, time_s, 1.0)),
    )


def _grid(road: ScenarioSpec) -> np.ndarray:
    return np.arange(0.0, road.speed.t_s[-1] + 0.5 * STEP_S, STEP_S)


def _values(profile: ProfileSpec | None, time_s: np.ndarray, otherwise: float) -> np.ndarray:
    return np.full(len(time_s), otherwise) if profile is None else np.interp(time_s, profile.t_s, profile.value)


def _middle(values: np.ndarray) -> np.ndarray:
    return 0.5 * (values[1:] + values[:-1])
