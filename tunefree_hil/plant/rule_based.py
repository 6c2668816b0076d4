"""Plant kind `rule_based`: the open-loop map read forwards, and a kinematic bicycle (comparison of paper Fig. 3b).

Its file is a calibration.npz (docs/reference/files.md: speed, acceleration, command, brake negative). Of the two pedals
the one further from rest is used; acceleration is linear in the command, linear between speeds, and constant beyond the
ends. Yaw rate = speed * tan(road-wheel angle) / wheelbase.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.open_loop_map import MAP_FILE, Refusal, SpeedRows, read_triples, rows_by_speed, value_at
from tunefree_hil.base.records import Motion
from tunefree_hil.plant.learned.kinematics import DEFAULTS, Carriage, carriage_of, driven, over_rest
from tunefree_hil.plant.types import ChassisInput, ChassisParams, Plant, rolling_motion, unopened

REFUSAL = Refusal(
    missing="no_plant_file",
    unfit="bad_plant_file",
    hint="a calibration.npz of speed_mps, accel_mps2, command_frac: `tunefree-hil map` learns one from logs",
    missing_key="plant.file",
)


class RuleBased(NamedTuple):
    """Constants of the car and its map."""

    wheel_radius_m: float
    half_track_m: float
    car: Carriage
    map: SpeedRows  # `at`: the command, `value`: acceleration on level ground in m/s2


@kernel
def step_rule_based(params: ChassisParams, state: Motion, x: ChassisInput, dt_s: float) -> tuple[Motion, Motion]:
    """One tick."""
    p = params.constants.car
    throttle, brake = over_rest(p, x.actuation)
    command = throttle + p.rest_frac if throttle >= brake else -(brake + p.rest_frac)
    accel = value_at(params.constants.map, state.speed_mps, command)
    angle = x.actuation.steer_rad * p.inverse_ratio
    reached = max(state.speed_mps + dt_s * accel, 0.0)
    yaw = reached * math.tan(angle) * p.inverse_wheelbase
    new = driven(p, state, accel, yaw, x, dt_s)
    return new, new


def init_rule_based(params: ChassisParams, dt_s: float) -> Motion:
    """Rolling straight at the start."""
    return rolling_motion(params.start, params.constants.wheel_radius_m)


@kernel
def observe_rule_based(state: Motion, measured: Motion) -> Motion:
    """The measured motion is the state."""
    return measured


def load_map(path: Path) -> SpeedRows:
    """The map of a calibration.npz, read forwards; of a repeated (speed, command) pair the last one is used.

    Raises InputError for a file that is not valid.
    """
    triples = read_triples(path, REFUSAL)
    return rows_by_speed(triples.speed_mps, triples.command_frac, triples.accel_mps2)


def plant_of(forward: SpeedRows) -> Plant:
    """The plant with this map."""

    def make(params: Mapping[str, float], change: BodyChange) -> Block:
        car = carriage_of("rule_based", DEFAULTS, params, change)
        constants = RuleBased(car.wheel_radius_m, car.half_track_m, car, forward)
        return Block(init_rule_based, step_rule_based, ChassisParams(constants))

    return PLANT._replace(make=make, open=None)


def open_rule_based(path: Path) -> Any:
    """The plant of a calibration.npz. Raises InputError where the file does not fit."""
    return plant_of(load_map(path))


PLANT = Plant(unopened("rule_based"), DEFAULTS, open=open_rule_based, file=MAP_FILE, observe=observe_rule_based)
