"""Windows of a drive run free through the single track: what a car with these constants would have done in them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.contracts import BodyChange
from tunefree_hil.base.kernel import kept, kernel
from tunefree_hil.base.records import Actuation, Disturbance, Motion
from tunefree_hil.effects._signals import SoftState, soft, step_soft
from tunefree_hil.learn.windows import TARGETS, Window
from tunefree_hil.plant.body import ChassisInput, ChassisParams
from tunefree_hil.plant.data_sheet import constants_of
from tunefree_hil.plant.single_track import SingleTrackState, step_single_track

Array = np.ndarray

WIDTH = len(TARGETS)


class Off(NamedTuple):
    """What lies between a reported output and the car: added to the steering wheel (rad), taken off the brake (duty),
    lag of the throttle (s). road_share: of what the accelerometer says throughout (Window.standing) the part that is a
    slope of the road.
    """

    steer_rad: float = 0.0
    brake_frac: float = 0.0
    road_share: float = 0.0
    throttle_lag_s: float = 0.0


@kernel
def run_free(
    params: ChassisParams,
    state: SingleTrackState,
    push: SoftState,
    before: Any,
    inputs: Any,
    off: Off,
    grade_rad: float,
    outputs: Any,
    dt_s: float,
) -> int:
    """Drive the car with rows of (throttle, brake, steer, gear) from row 1 on; rows of TARGETS go into `outputs`. push:
    the lag of the throttle as it was ahead of `before`, the throttle up to row 0.
    """
    road = Disturbance(grade_rad, 1.0)
    for i in range(len(before)):
        push, _ = step_soft(0.0, push, float(before[i]), dt_s)
    rows = len(inputs) // 4
    idle = params.constants.rest_frac
    for i in range(1, rows):
        brake = float(inputs[4 * i + 1]) - off.brake_frac
        if brake < idle:
            brake = idle
        steer = float(inputs[4 * i + 2]) + off.steer_rad
        push, throttle = step_soft(0.0, push, float(inputs[4 * i]), dt_s)
        act = Actuation(throttle, brake, steer, float(inputs[4 * i + 3]))
        state, motion = step_single_track(params, state, ChassisInput(act, road), dt_s)
        outputs[6 * i] = motion.speed_mps
        outputs[6 * i + 1] = motion.yaw_rate_radps
        outputs[6 * i + 2] = motion.heading_rad
        outputs[6 * i + 3] = motion.lateral_accel_mps2
        outputs[6 * i + 4] = motion.x_m
        outputs[6 * i + 5] = motion.y_m
    return rows


kept(run_free)


def simulated(params: ChassisParams, window: Window, off: Off) -> Array:
    """TARGETS [m, 6] of a free run at the window's rows."""
    x_m, y_m, heading, speed, yaw = window.start
    p = params.constants
    grip = p.rear_stiffness * (p.front_axle_m + p.rear_axle_m)
    mass_kg = p.mass_kg * p.front_axle_m
    side = p.rear_axle_m * yaw - mass_kg * speed * speed * yaw / grip  # as it is in a steady turn
    first = Motion(x_m, y_m, heading, speed, side, yaw, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    outputs = np.zeros(len(window.inputs) * WIDTH)
    flat = np.ascontiguousarray(window.inputs).ravel()
    grade_rad = math.asin(max(-1.0, min(off.road_share * window.standing, 1.0)))
    lag = soft(off.throttle_lag_s, float(window.before[0]))  # held for ever at the first throttle that is known
    push, before = lag.init(lag.params, window.dt_s), np.ascontiguousarray(window.before)
    run_free(params, SingleTrackState(first, 0.0), push, before, flat, off, grade_rad, outputs, window.dt_s)
    return outputs.reshape(-1, WIDTH)[window.at]


def errors(params: Mapping[str, float], off: Off, some: Sequence[Window]) -> Array:
    """Simulated minus measured TARGETS [windows, m, 6]; NaN where nothing was measured."""
    chassis = ChassisParams(constants_of(params, BodyChange()))
    return np.stack([simulated(chassis, window, off) - window.targets for window in some])


def rms_of(misses: Array) -> dict[str, float]:
    """Root mean square of each target that was measured."""
    found = {}
    for i, name in enumerate(TARGETS):
        some = misses[:, :, i][np.isfinite(misses[:, :, i])]
        if len(some):
            found[name] = float(np.sqrt(np.mean(some * some)))
    return found
