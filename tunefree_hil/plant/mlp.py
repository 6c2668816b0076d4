"""Plant kind `mlp`: one hidden layer of tanh gives acceleration and yaw rate, without memory; inputs of kind lstm."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.records import Motion
from tunefree_hil.plant.learned.kinematics import DEFAULTS, driven, measured_own_accel, own_accel
from tunefree_hil.plant.learned.lstm_cell import Layer, LayerState, bounded, init_layer, layer_out, step_layer
from tunefree_hil.plant.learned.weights_file import layer_of, load_plant_file
from tunefree_hil.plant.lstm import maker, put_car_inputs
from tunefree_hil.plant.types import ChassisInput, ChassisParams, Plant, rolling_motion, unopened


class MlpState(NamedTuple):
    """The motion, its acceleration on level ground, and the buffers of the layer."""

    motion: Motion
    own_mps2: float
    layer: LayerState


@kernel
def step_mlp(params: ChassisParams, state: MlpState, x: ChassisInput, dt_s: float) -> tuple[MlpState, Motion]:
    """One tick."""
    p, net, layer = params.constants.car, params.constants.net, state.layer
    put_car_inputs(net, layer.inputs, p, state.motion, state.own_mps2, x)
    step_layer(net, layer)
    accel, yaw = bounded(net, 0, layer_out(net, layer, 0)), bounded(net, 1, layer_out(net, layer, 1))
    new = driven(p, state.motion, accel, yaw, x, dt_s)
    return MlpState(new, own_accel(p, accel, new, x), layer), new


def init_mlp(params: ChassisParams, dt_s: float) -> MlpState:
    """Rolling straight at the start."""
    constants = params.constants
    return MlpState(rolling_motion(params.start, constants.wheel_radius_m), 0.0, init_layer(constants.net))


@kernel
def observe_mlp(state: MlpState, measured: Motion) -> MlpState:
    """The state with the measured motion."""
    return MlpState(measured, measured_own_accel(state.own_mps2, state.motion, measured), state.layer)


def plant_of(net: Layer) -> Plant:
    """The plant with these weights."""
    return PLANT._replace(make=maker("mlp", init_mlp, step_mlp, net), open=None)


def open_mlp(path: Path) -> Any:
    """The plant of a plant.npz. Raises InputError where the file does not fit."""
    return plant_of(layer_of(load_plant_file(path, "mlp")))


PLANT = Plant(unopened("mlp"), DEFAULTS, open=open_mlp, file="plant.npz", observe=observe_mlp)
