"""Plant kind `hybrid`: the single-track car with an LSTM that corrects its acceleration and yaw rate.

A tick of dt from motion (v, yaw rate r) with the physics' own lateral state (side speed, yaw rate):

    1. physics:  v', side', r' = the single-track tick from v and the physics' own side speed and yaw rate
    2. inputs:   v, r, throttle and brake duty over rest, steer (wheel, the actuator's output), (v' - v) / dt, r'
    3. residual: (a, w) = fade * bound * tanh(linear(cell(inputs))), fade = v' / 0.3 m/s within 0 and 1
    4. motion:   speed = max(v' + a dt, 0), yaw rate = r' + w, side speed = side' + rear_axle_m * w: the residual turns
                 the car about its rear axle and leaves that axle's slip unchanged; pose by mean velocities
    5. physics keeps speed, its own side' and r': the residual never drives the tyres' lateral state

With all weights 0 it is the single-track car, bit for bit. Where the physics stops the car, it stands.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import Motion
from tunefree_hil.plant.data_sheet import DEFAULTS, SingleTrack, constants_of
from tunefree_hil.plant.forces.tyre_relaxation import AT_EASE, Axles
from tunefree_hil.plant.kinematics import Velocity, moved, with_velocity
from tunefree_hil.plant.learned.lstm_cell import Cell, CellState, bounded, cell_out, init_cell, put_input, step_cell
from tunefree_hil.plant.learned.weights_file import cell_of, load_plant_file
from tunefree_hil.plant.single_track import pushed
from tunefree_hil.plant.types import ChassisInput, ChassisParams, Plant, rolling_motion, unopened

FADE_MPS = 0.3


class Hybrid(NamedTuple):
    """Constants of the car and of the cell."""

    wheel_radius_m: float
    half_track_m: float
    car: SingleTrack
    net: Cell


class HybridState(NamedTuple):
    """The corrected motion; side speed and yaw rate of the physics; brake energy; the cell; side forces of relaxing
    tyres.
    """

    motion: Motion
    side_speed_mps: float
    yaw_rate_radps: float
    braked_j: float
    cell: CellState
    axles: Axles


@kernel
def step_hybrid(params: ChassisParams, state: HybridState, x: ChassisInput, dt_s: float) -> tuple[HybridState, Motion]:
    """One tick."""
    p, net = params.constants.car, params.constants.net
    motion, cell, act = state.motion, state.cell, x.actuation
    velocity = Velocity(motion.speed_mps, state.side_speed_mps, state.yaw_rate_radps)
    after = pushed(p, velocity, state.braked_j, x, dt_s, state.axles)
    physics = after.velocity
    put_input(net, cell.inputs, 0, motion.speed_mps)
    put_input(net, cell.inputs, 1, motion.yaw_rate_radps)
    put_input(net, cell.inputs, 2, act.throttle_frac - p.rest_frac)
    put_input(net, cell.inputs, 3, act.brake_frac - p.rest_frac)
    put_input(net, cell.inputs, 4, act.steer_rad)
    put_input(net, cell.inputs, 5, (physics.speed_mps - motion.speed_mps) / dt_s)
    put_input(net, cell.inputs, 6, physics.yaw_rate_radps)
    step_cell(net, cell, False)
    fade = clamp(physics.speed_mps / FADE_MPS, 0.0, 1.0)
    speed = physics.speed_mps + dt_s * fade * bounded(net, 0, cell_out(net, cell, 0))
    turn = fade * bounded(net, 1, cell_out(net, cell, 1))
    if speed > 0.0:
        velocity_new = Velocity(speed, physics.side_speed_mps + p.rear_axle_m * turn, physics.yaw_rate_radps + turn)
    else:
        velocity_new = Velocity(0.0, 0.0, 0.0)
    new = moved(p, motion, velocity_new, after.gravity_mps2, after.wheel, dt_s)
    braked_j = state.braked_j + dt_s * (0.5 * (motion.speed_mps + new.speed_mps)) * after.brake_n
    return HybridState(new, physics.side_speed_mps, physics.yaw_rate_radps, braked_j, cell, after.axles), new


def init_hybrid(params: ChassisParams, dt_s: float) -> HybridState:
    """Rolling straight at the start, brakes cold, the cell at 0."""
    constants = params.constants
    motion = rolling_motion(params.start, constants.wheel_radius_m)
    return HybridState(motion, 0.0, 0.0, 0.0, init_cell(constants.net), AT_EASE)


@kernel
def observe_hybrid(state: HybridState, measured: Motion) -> HybridState:
    """The state with the measured pose, speed and yaw rate as the motion; the physics' lateral state is kept."""
    motion = with_velocity(measured, Velocity(measured.speed_mps, state.motion.side_speed_mps, measured.yaw_rate_radps))
    return HybridState(motion, state.side_speed_mps, state.yaw_rate_radps, state.braked_j, state.cell, state.axles)


def plant_of(net: Cell) -> Plant:
    """The plant with these weights."""

    def make(params: Mapping[str, float], change: BodyChange) -> Block:
        car = constants_of(params, change)
        constants = Hybrid(car.wheel_radius_m, car.half_track_m, car, net)
        return Block(init_hybrid, step_hybrid, ChassisParams(constants))

    return PLANT._replace(make=make, open=None)


def open_hybrid(path: Path) -> Any:
    """The plant of a plant.npz. Raises InputError where the file does not fit."""
    return plant_of(cell_of(load_plant_file(path, "hybrid")))


PLANT = Plant(unopened("hybrid"), DEFAULTS, open=open_hybrid, file="plant.npz", observe=observe_hybrid)
