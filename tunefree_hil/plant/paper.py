"""Plant kind `paper`: the network of Table I as printed. The inputs of an LSTM of 8 units with ReLU are 20 samples over
time of throttle, brake and steering *command*, speed and acceleration; its linear layer gives acceleration and yaw rate
of the next sample.

The actuators are identities ([actuators] of model.toml is not used), so the report echoes the commands and the network
contains dead times and lags. Samples are sample_spacing_s apart, the newest at this tick; at every tick the cell starts
from 0 and runs over the window. Before the start the car rolled with the pedals at rest.

Where samples are further apart than ticks, a tick covers its share of the change to the next sample, so that the output
is not early (the published code uses a label 60 ms ahead for the next 10 ms: docs/reference/apollo.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block, buffer, kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import Actuation, Command, Motion
from tunefree_hil.plant.learned.kinematics import DEFAULTS as CAR
from tunefree_hil.plant.learned.kinematics import (
    Carriage,
    carriage_of,
    driven,
    measured_own_accel,
    over_rest,
    own_accel,
)
from tunefree_hil.plant.learned.lstm_cell import Cell, CellState, cell_out, clear_cell, init_cell, step_cell
from tunefree_hil.plant.learned.weights_file import cell_of, load_plant_file
from tunefree_hil.plant.types import ChassisInput, ChassisParams, Plant, filled, rolling_motion, unopened

SAMPLES = 20
SAMPLE_INPUTS = 5  # inputs of a sample
DEFAULTS = {**CAR, "sample_spacing_s": 0.01}


class Paper(NamedTuple):
    """Constants of the car and of the cell; samples are `spacing_s` apart."""

    wheel_radius_m: float
    half_track_m: float
    car: Carriage
    net: Cell
    spacing_s: float


class PaperState(NamedTuple):
    """The motion, its acceleration on level ground, the cell (used within a step), a ring of scaled samples, one a
    tick, the index of the newest, and the ticks between samples."""

    motion: Motion
    own_mps2: float
    cell: CellState
    past: Any
    place: int
    gap: int


@kernel
def keep_sample(net: Cell, past: Any, offset: int, sample: tuple[float, float, float, float, float]) -> None:
    """Write a sample into the ring, scaled."""
    for i in range(SAMPLE_INPUTS):
        past[offset + i] = (sample[i] - net.mean[i]) * net.inverse_scale[i]


@kernel
def run_window(net: Cell, state: PaperState, place: int) -> None:
    """The cell from 0 over the samples up to `place`, oldest first."""
    cell, past = state.cell, state.past
    length = len(past) // SAMPLE_INPUTS
    clear_cell(cell)
    next_place = place + 1 if place + 1 < length else 0
    for _ in range(SAMPLES):
        for i in range(SAMPLE_INPUTS):
            cell.inputs[i] = past[next_place * SAMPLE_INPUTS + i]
        step_cell(net, cell, True)
        next_place = next_place + state.gap
        if next_place >= length:
            next_place = next_place - length


@kernel
def toward(net: Cell, cell: CellState, row: int, value: float, share: float) -> float:
    """`value` moved by a share of the difference to output `row`, which is within its bound."""
    most = float(net.bound[row])
    return value + share * (clamp(cell_out(net, cell, row), -most, most) - value)


@kernel
def step_paper(params: ChassisParams, state: PaperState, x: ChassisInput, dt_s: float) -> tuple[PaperState, Motion]:
    """One tick."""
    p, net, motion = params.constants.car, params.constants.net, state.motion
    throttle, brake = over_rest(p, x.actuation)
    place = state.place + 1
    if place * SAMPLE_INPUTS >= len(state.past):
        place = 0
    sample = (throttle, brake, x.actuation.steer_rad, motion.speed_mps, state.own_mps2)
    keep_sample(net, state.past, place * SAMPLE_INPUTS, sample)
    run_window(net, state, place)
    share = 1.0 / max(float(state.gap), 1.0)
    accel = toward(net, state.cell, 0, state.own_mps2, share)
    yaw = toward(net, state.cell, 1, motion.yaw_rate_radps, share)
    new = driven(p, motion, accel, yaw, x, dt_s)
    return PaperState(new, own_accel(p, accel, new, x), state.cell, state.past, place, state.gap), new


def init_paper(params: ChassisParams, dt_s: float) -> PaperState:
    """Rolling straight at the start and before."""
    constants = params.constants
    gap = max(round(constants.spacing_s / dt_s), 1)
    length = (SAMPLES - 1) * gap + 1
    past = buffer(length * SAMPLE_INPUTS)
    for offset in range(0, length * SAMPLE_INPUTS, SAMPLE_INPUTS):
        keep_sample(constants.net, past, offset, (0.0, 0.0, 0.0, float(params.start.speed_mps), 0.0))
    motion = rolling_motion(params.start, constants.wheel_radius_m)
    return PaperState(motion, 0.0, init_cell(constants.net), past, length - 1, gap)


@kernel
def observe_paper(state: PaperState, measured: Motion) -> PaperState:
    """The state with the measured motion, which the next sample uses."""
    own_mps2 = measured_own_accel(state.own_mps2, state.motion, measured)
    return PaperState(measured, own_mps2, state.cell, state.past, state.place, state.gap)


@kernel
def pass_command(params: float, state: float, x: Command, dt_s: float) -> tuple[float, Actuation]:
    """Identity actuators."""
    return state, Actuation(x.throttle_frac, x.brake_frac, x.steer_rad, x.gear)


def no_actuators(params: Mapping[str, float]) -> Block:
    """Block Command -> Actuation: the command itself."""
    return Block(lambda params, dt_s: 0.0, pass_command, 0.0)


def plant_of(net: Cell) -> Plant:
    """The plant with these weights."""

    def make(params: Mapping[str, float], change: BodyChange) -> Block:
        own = filled(DEFAULTS, params, "paper")
        spacing_s = own.pop("sample_spacing_s")
        if not 0.0 < spacing_s <= 1.0:
            raise InputError(
                f"samples {spacing_s:g} s apart",
                code="bad_spacing",
                key="plant.params.sample_spacing_s",
                hint="above 0 and at most 1",
            )
        car = carriage_of("paper", CAR, own, change)
        constants = Paper(car.wheel_radius_m, car.half_track_m, car, net, spacing_s)
        return Block(init_paper, step_paper, ChassisParams(constants))

    return PLANT._replace(make=make, open=None)


def open_paper(path: Path) -> Any:
    """The plant of a plant.npz. Raises InputError where the file does not fit."""
    return plant_of(cell_of(load_plant_file(path, "paper")))


PLANT = Plant(
    unopened("paper"), DEFAULTS, actuators=no_actuators, open=open_paper, file="plant.npz", observe=observe_paper
)
