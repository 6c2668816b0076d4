"""Plant kind `rule_based`: the open-loop map read forwards, and a kinematic bicycle (paper Fig. 3b's comparison).

Its file is a calibration.npz (interfaces 3: speed, acceleration, command, brake negative). Of the two pedals the one
that is further from rest counts; acceleration is linear in the command within a speed and linear between speeds, held
at the ends. Yaw rate = speed * tan(road-wheel angle) / wheelbase.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block, kernel, table
from tunefree_hil.base.maths import find_cell
from tunefree_hil.base.records import Motion
from tunefree_hil.plant.body import ChassisInput, ChassisParams, Plant, rolling_motion, unopened
from tunefree_hil.plant.carriage import DEFAULTS, Carriage, carriage_of, driven, over_rest

TRIPLE = ("speed_mps", "accel_mps2", "command_frac")
HINT = "a calibration.npz of speed_mps, accel_mps2, command_frac: `tunefree-hil map` learns one from logs"


class ForwardMap(NamedTuple):
    """Speeds ascending; the points of row i are first[i] <= k < first[i + 1], their commands strictly ascending."""

    speed_mps: Any
    first: Any
    command_frac: Any
    accel_mps2: Any


class RuleBased(NamedTuple):
    """Constants of the car and its map."""

    wheel_radius_m: float
    half_track_m: float
    car: Carriage
    map: ForwardMap


@kernel
def accel_in_row(forward: ForwardMap, row: int, command_frac: float) -> float:
    """Linear in the command within one speed, held at the ends."""
    commands, accels = forward.command_frac, forward.accel_mps2
    low, high = int(forward.first[row]), int(forward.first[row + 1]) - 1
    if command_frac <= commands[low]:
        return float(accels[low])
    if command_frac >= commands[high]:
        return float(accels[high])
    while high - low > 1:
        middle = (low + high) // 2
        if commands[middle] <= command_frac:
            low = middle
        else:
            high = middle
    share = (command_frac - commands[low]) / (commands[high] - commands[low])  # not 0: strictly ascending
    return float(accels[low] + share * (accels[high] - accels[low]))


@kernel
def accel_of(forward: ForwardMap, speed_mps: float, command_frac: float) -> float:
    """Acceleration on level ground for a command at a speed."""
    speeds = forward.speed_mps
    last = len(speeds) - 1
    if speed_mps <= speeds[0]:
        return accel_in_row(forward, 0, command_frac)
    if speed_mps >= speeds[last]:
        return accel_in_row(forward, last, command_frac)
    i = find_cell(speeds, speed_mps)
    share = (speed_mps - speeds[i]) / (speeds[i + 1] - speeds[i])  # not 0: strictly ascending
    below = accel_in_row(forward, i, command_frac)
    return below + share * (accel_in_row(forward, i + 1, command_frac) - below)


@kernel
def step_rule_based(params: ChassisParams, state: Motion, x: ChassisInput, dt_s: float) -> tuple[Motion, Motion]:
    """One tick."""
    p = params.constants.car
    throttle, brake = over_rest(p, x.actuation)
    command = throttle + p.rest_frac if throttle >= brake else -(brake + p.rest_frac)
    accel = accel_of(params.constants.map, state.speed_mps, command)
    angle = x.actuation.steer_rad * p.inverse_ratio
    reached = max(state.speed_mps + dt_s * accel, 0.0)
    yaw = reached * math.tan(angle) * p.inverse_wheelbase
    new = driven(p, state, accel, yaw, x, dt_s)
    return new, new


def init_rule_based(params: ChassisParams, dt_s: float) -> Motion:
    """Rolling straight at the start."""
    return rolling_motion(params.start, params.constants.wheel_radius_m)


@kernel
def observe_rule_based(state: Motion, seen: Motion) -> Motion:
    """The measured motion is the state."""
    return seen


def load_map(path: Path) -> ForwardMap:
    """The map of a calibration.npz, read forwards; of a repeated (speed, command) pair the last one counts.

    Raises InputError that says what is wrong with the file.
    """
    if not path.is_file():
        raise InputError("no such file", code="no_plant_file", file=str(path), key="plant.file", hint=HINT)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            speeds, accels, commands = (np.asarray(archive[key], dtype=np.float64) for key in TRIPLE)
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(f"cannot be read: {error}", code="bad_plant_file", file=str(path), hint=HINT) from error
    columns = (speeds, accels, commands)
    whole = all(column.ndim == 1 and column.size == speeds.size > 0 and np.isfinite(column).all() for column in columns)
    if not whole:
        words = "holds no three equally long rows of finite numbers"
        raise InputError(words, code="bad_plant_file", file=str(path), hint=HINT)
    return forward_map(speeds.tolist(), accels.tolist(), commands.tolist())


def forward_map(speeds: list[float], accels: list[float], commands: list[float]) -> ForwardMap:
    """The map of triples."""
    rows: dict[float, dict[float, float]] = {}
    for speed, accel, command in zip(speeds, accels, commands, strict=True):
        rows.setdefault(speed, {})[command] = accel
    first, row_commands, row_accels = [0], [], []
    for speed in sorted(rows):
        pairs = sorted(rows[speed].items())
        row_commands += [command for command, _ in pairs]
        row_accels += [accel for _, accel in pairs]
        first.append(len(row_commands))
    return ForwardMap(table(sorted(rows)), table(first), table(row_commands), table(row_accels))


def plant_of(forward: ForwardMap) -> Plant:
    """The plant with this map."""

    def make(params: Mapping[str, float], change: BodyChange) -> Block:
        car = carriage_of("rule_based", DEFAULTS, params, change)
        constants = RuleBased(car.wheel_radius_m, car.half_track_m, car, forward)
        return Block(init_rule_based, step_rule_based, ChassisParams(constants))

    return PLANT._replace(make=make, open=None)


def open_rule_based(path: Path) -> Any:
    """The plant of a calibration.npz. Raises InputError where the file does not fit."""
    return plant_of(load_map(path))


PLANT = Plant(
    unopened("rule_based"), DEFAULTS, open=open_rule_based, file="calibration.npz", observe=observe_rule_based
)
