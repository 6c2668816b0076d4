"""Plant kind `lstm`: an LSTM with state gives acceleration and yaw rate; plant/learned/kinematics.py the motion.

Inputs at the start of a tick: speed, throttle and brake duty over rest, steering-wheel angle (the actuators' outputs of
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
from tunefree_hil.plant.learned.kinematics import (
    DEFAULTS,
    Carriage,
    carriage_of,
    driven,
    measured_own_accel,
    over_rest,
    own_accel,
)
from tunefree_hil.plant.learned.lstm_cell import Cell, CellState, bounded, cell_out, init_cell, put_input, step_cell
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
    """The motion, its acceleration on level ground, and the cell."""

    motion: Motion
    own_mps2: float
    cell: CellState


@kernel
def put_car_inputs(net: Any, inputs: Any, p: Carriage, motion: Motion, own_mps2: float, x: ChassisInput) -> None:
    """The inputs of kinds lstm and mlp."""
    throttle, brake = over_rest(p, x.actuation)
    put_input(net, inputs, 0, motion.speed_mps)
    put_input(net, inputs, 1, throttle)
    put_input(net, inputs, 2, brake)
    put_input(net, inputs, 3, x.actuation.steer_rad)
    put_input(net, inputs, 4, own_mps2)
    put_input(net, inputs, 5, motion.yaw_rate_radps)


@kernel
def step_lstm(params: ChassisParams, state: LstmState, x: ChassisInput, dt_s: float) -> tuple[LstmState, Motion]:
    """One tick."""
    p, net, cell = params.constants.car, params.constants.net, state.cell
    put_car_inputs(net, cell.inputs, p, state.motion, state.own_mps2, x)
    step_cell(net, cell, False)
    accel, yaw = bounded(net, 0, cell_out(net, cell, 0)), bounded(net, 1, cell_out(net, cell, 1))
    new = driven(p, state.motion, accel, yaw, x, dt_s)
    return LstmState(new, own_accel(p, accel, new, x), cell), new


def init_lstm(params: ChassisParams, dt_s: float) -> LstmState:
    """Rolling straight at the start, the cell at 0."""
    constants = params.constants
    return LstmState(rolling_motion(params.start, constants.wheel_radius_m), 0.0, init_cell(constants.net))


@kernel
def observe_lstm(state: LstmState, measured: Motion) -> LstmState:
    """The state with the measured motion."""
    return LstmState(measured, measured_own_accel(state.own_mps2, state.motion, measured), state.cell)


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
