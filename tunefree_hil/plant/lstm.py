"""Plant kind `lstm`: a state-carrying LSTM says acceleration and yaw rate, kinematics do the rest
(plant/learned/kinematics.py).

Inputs at a tick's beginning: speed, throttle and brake duty over rest, steering-wheel angle (the actuators' outputs of
this tick), its own acceleration (the rate of speed on level ground) and the yaw rate of the tick before. Outputs:
bound * tanh(linear), for this tick.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.records import Motion
from tunefree_hil.plant.learned.kinematics import DEFAULTS, Carriage, carriage_of, driven, over_rest, said_of, seen_of
from tunefree_hil.plant.learned.lstm_cell import Cell, CellState, bounded, cell_out, init_cell, step_cell, take_in
from tunefree_hil.plant.learned.weights_file import cell_of, load_plant_file
from tunefree_hil.plant.types import ChassisInput, ChassisParams, Plant, rolling_motion, unopened

Maker = Callable[[Mapping[str, float], BodyChange], Block]


class CarAndNet(NamedTuple):
    """Constants of the car, and the weights: a Cell for kind lstm, a Layer for kind mlp."""

    wheel_radius_m: float
    half_track_m: float
    car: Carriage
    net: Any


class LstmState(NamedTuple):
    """The motion, the acceleration on level ground behind it, and the cell."""

    motion: Motion
    own_mps2: float
    cell: CellState


@kernel
def take_in_car(net: Any, seen: Any, p: Carriage, motion: Motion, own_mps2: float, x: ChassisInput) -> None:
    """The inputs of kinds lstm and mlp."""
    throttle, brake = over_rest(p, x.actuation)
    take_in(net, seen, 0, motion.speed_mps)
    take_in(net, seen, 1, throttle)
    take_in(net, seen, 2, brake)
    take_in(net, seen, 3, x.actuation.steer_rad)
    take_in(net, seen, 4, own_mps2)
    take_in(net, seen, 5, motion.yaw_rate_radps)


@kernel
def step_lstm(params: ChassisParams, state: LstmState, x: ChassisInput, dt_s: float) -> tuple[LstmState, Motion]:
    """One tick."""
    p, net, cell = params.constants.car, params.constants.net, state.cell
    take_in_car(net, cell.seen, p, state.motion, state.own_mps2, x)
    step_cell(net, cell, False)
    accel, yaw = bounded(net, 0, cell_out(net, cell, 0)), bounded(net, 1, cell_out(net, cell, 1))
    new = driven(p, state.motion, accel, yaw, x, dt_s)
    return LstmState(new, said_of(p, accel, new, x), cell), new


def init_lstm(params: ChassisParams, dt_s: float) -> LstmState:
    """Rolling straight at the start, the cell at 0."""
    constants = params.constants
    return LstmState(rolling_motion(params.start, constants.wheel_radius_m), 0.0, init_cell(constants.net))


@kernel
def observe_lstm(state: LstmState, seen: Motion) -> LstmState:
    """The state with a measured motion in it."""
    return LstmState(seen, seen_of(state.own_mps2, state.motion, seen), state.cell)


def maker(kind: str, init: Callable[..., Any], step: Callable[..., Any], net: Any) -> Maker:
    """`Plant.make` of kinds lstm and mlp with these weights."""

    def make(params: Mapping[str, float], change: BodyChange) -> Block:
        car = carriage_of(kind, DEFAULTS, params, change)
        return Block(init, step, ChassisParams(CarAndNet(car.wheel_radius_m, car.half_track_m, car, net)))

    return make


def plant_of(net: Cell) -> Plant:
    """The plant with these weights."""
    return PLANT._replace(make=maker("lstm", init_lstm, step_lstm, net), open=None)


def open_lstm(path: Path) -> Any:
    """The plant of a plant.npz. Raises InputError where the file does not fit."""
    return plant_of(cell_of(load_plant_file(path, "lstm")))


PLANT = Plant(unopened("lstm"), DEFAULTS, open=open_lstm, file="plant.npz", observe=observe_lstm)
