"""A driver model that works the pedals: anticipation, delayed compensation, a slow foot that changes pedals seldom.

The structure is that of the steering (steering.py): the planned acceleration as it is seen ahead, a correction of speed
and distance after a reaction time, and the lag of the foot (MacAdam, "Understanding and modeling the human driver",
Vehicle System Dynamics 40 (2003) 101-134, doi:10.1076/vesd.40.1.101.15875, reviews both). The foot leaves a pedal for
the other one only for a demand beyond a threshold, and needs a transfer time.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Block, Tunable
from tunefree_hil.base.course import Tracking
from tunefree_hil.base.kernel import buffer, kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import Measurement
from tunefree_hil.control.calibration_map import CalibrationMap, lookup
from tunefree_hil.control.contract import Pedals, Recipe, Setup, chassis_speed_of, speed_of
from tunefree_hil.control.longitudinal.pid import STANDSTILL_MPS2, is_full_stop

SPEED_LIMIT_MPS = 2.0  # of the speed error, the station error's part in it included
INTEGRAL_LIMIT_MPS2 = 0.5  # what a driver learns of slope and load on one road
TRANSFER_S = 0.2  # foot from one pedal to the other
CHANGE_MPS2 = 0.25  # demand beyond coasting for which a driver changes the pedal
THROTTLE, BRAKE = 1.0, -1.0


class DriverPedalsParams(NamedTuple):
    """Numbers of the driver, and the vehicle as the driver knows it."""

    ticks: int  # reaction time
    speed_1ps: float
    station_1ps: float
    integral_1ps2: float
    foot_share: float  # of the way to the wanted acceleration in one tick, twice in series
    calibration: CalibrationMap
    rest_pedal_frac: float
    chassis_speed: float  # 0: the vehicle reports no speed, that of the INS is used


class DriverPedalsState(NamedTuple):
    """Speed errors that were seen and not answered yet (a ring), its oldest place, foot, pedal in use, transfer."""

    error_mps: Any
    oldest: int
    integral_mps2: float
    first_mps2: float
    second_mps2: float
    pedal: float
    transfer_s: float


class Foot(NamedTuple):
    """The pedal in use and how long the foot still is on its way to it."""

    pedal: float
    transfer_s: float


def make(setup: Setup) -> Block:
    """x = (Tracking, Measurement) -> Pedals."""
    values = setup.values
    params = DriverPedalsParams(
        ticks=max(1, round(values["driver.reaction_s"] / setup.dt_s)),
        speed_1ps=values["driver.speed_1ps"],
        station_1ps=values["driver.station_1ps"],
        integral_1ps2=values["driver.integral_1ps2"],
        foot_share=1.0 - math.exp(-setup.dt_s / values["driver.foot_lag_s"]),
        calibration=setup.calibration,
        rest_pedal_frac=setup.vehicle.rest_pedal_frac,
        chassis_speed=chassis_speed_of(setup.absent),
    )
    return Block(init, step, params, CONTROLLER.tunables)


def init(params: DriverPedalsParams, dt_s: float) -> DriverPedalsState:
    return DriverPedalsState(buffer(params.ticks), 0, 0.0, 0.0, 0.0, THROTTLE, 0.0)


@kernel
def step(
    params: DriverPedalsParams, state: DriverPedalsState, x: tuple[Tracking, Measurement], dt_s: float
) -> tuple[DriverPedalsState, Pedals]:
    """Acceleration ahead plus the correction of the error a reaction time ago, through the foot and the map."""
    tracking, measurement = x
    v = speed_of(measurement, params.chassis_speed)
    error_mps = float(state.error_mps[state.oldest])
    state.error_mps[state.oldest] = clamp(
        tracking.speed_error_mps + params.station_1ps * tracking.station_error_m, -SPEED_LIMIT_MPS, SPEED_LIMIT_MPS
    )
    oldest = state.oldest + 1
    if oldest >= params.ticks:
        oldest = 0
    integral_mps2 = clamp(
        state.integral_mps2 + params.integral_1ps2 * error_mps * dt_s, -INTEGRAL_LIMIT_MPS2, INTEGRAL_LIMIT_MPS2
    )
    wanted_mps2 = tracking.preview_accel_mps2 + params.speed_1ps * error_mps + integral_mps2
    if is_full_stop(tracking):
        integral_mps2 = 0.0
        if wanted_mps2 > STANDSTILL_MPS2:
            wanted_mps2 = STANDSTILL_MPS2
    first_mps2 = state.first_mps2 + params.foot_share * (wanted_mps2 - state.first_mps2)
    second_mps2 = state.second_mps2 + params.foot_share * (first_mps2 - state.second_mps2)
    foot = move_foot(params, state, v, second_mps2, dt_s)
    new_state = DriverPedalsState(
        state.error_mps, oldest, integral_mps2, first_mps2, second_mps2, foot.pedal, foot.transfer_s
    )
    return new_state, press(params, foot, v, second_mps2)


@kernel
def move_foot(
    params: DriverPedalsParams, state: DriverPedalsState, speed_mps: float, accel_mps2: float, dt_s: float
) -> Foot:
    """Change the pedal where the map wants the other one even for a demand that is CHANGE_MPS2 nearer to this one."""
    nearer_mps2 = accel_mps2 + state.pedal * CHANGE_MPS2
    command_frac = lookup(params.calibration, speed_mps, nearer_mps2)
    if state.pedal * command_frac < 0.0:
        return Foot(-state.pedal, TRANSFER_S)
    return Foot(state.pedal, state.transfer_s - dt_s if state.transfer_s > dt_s else 0.0)


@kernel
def press(params: DriverPedalsParams, foot: Foot, speed_mps: float, accel_mps2: float) -> Pedals:
    """The pedals: the one in use as the map says, both at rest while the foot changes over."""
    rest_frac = params.rest_pedal_frac
    command_frac = foot.pedal * lookup(params.calibration, speed_mps, accel_mps2)
    pressed_frac = command_frac if command_frac > rest_frac and foot.transfer_s <= 0.0 else rest_frac
    if foot.pedal > 0.0:
        return Pedals(pressed_frac, rest_frac, accel_mps2)
    return Pedals(rest_frac, pressed_frac, accel_mps2)


CONTROLLER = Recipe(
    make,
    (
        Tunable("driver.reaction_s", "s", 0.05, 0.5),
        Tunable("driver.speed_1ps", "1/s", 0.1, 2.0),
        Tunable("driver.station_1ps", "1/s", 0.01, 0.5),
        Tunable("driver.integral_1ps2", "1/s2", 0.001, 0.5),
        Tunable("driver.foot_lag_s", "s", 0.02, 0.3),
        Tunable("speed.preview_s", "s", 0.0, 1.5, "linear"),
    ),
)
