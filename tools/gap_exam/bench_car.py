"""A car of the exam on a bench: a whole vehicle with its own actuators, `kind = "path/to/bench_car.py:VEHICLE"`.

It answers to the contract of a plant by its attributes alone; nothing of the bench's package is imported. Which car it
is, and what is hidden in it, stands under seal in the model folder's `hidden.json`. Effects of sensing and of time act
behind the plant (bench_sensors.py).
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("GAP_EXAM_JIT", "0")  # a node has no compiler
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from tools.gap_exam import channels, chassis
from tools.gap_exam.car import Car, draw_vehicle
from tools.gap_exam.chassis import ACROSS, ALONG, HEADING, RATE, SIDE, SPEED, YAW, X, Y, chassis_of, step_body
from tools.gap_exam.files import read_json
from tools.gap_exam.hidden import NOTHING, Hidden, hidden_of
from tools.gap_exam.seal import unseal

STEPS, STEP_MS = 10, 1.0  # a tick
DRIVE = 4.0  # gear
REACH = 2000  # steps of the past that a delay may ask for
ROOM = 60_000


class Actuation(NamedTuple):
    """What the actuators put out: duty, duty, steering-wheel angle, gear."""

    throttle_frac: float
    brake_frac: float
    steer_rad: float
    gear: float


class Motion(NamedTuple):
    """True motion: pose of the rear axle's middle, velocities and specific force at the centre of mass."""

    x_m: float
    y_m: float
    heading_rad: float
    speed_mps: float
    side_speed_mps: float
    yaw_rate_radps: float
    accel_mps2: float
    lateral_accel_mps2: float
    speed_rate_mps2: float
    wheel_fl_radps: float
    wheel_fr_radps: float
    wheel_rl_radps: float
    wheel_rr_radps: float


class Start(NamedTuple):
    """Where an episode begins; the bench puts its own here."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    speed_mps: float = 0.0


class Constants(NamedTuple):
    """What the bench's sensors ask for."""

    wheel_radius_m: float
    half_track_m: float


class Params(NamedTuple):
    """constants and start, as every chassis has them."""

    constants: Constants
    start: Any = Start()


class Part(NamedTuple):
    """init(params, dt_s) -> state; step(params, state, x, dt_s) -> (state, y)."""

    init: Any
    step: Any
    params: Any
    tunables: tuple[Any, ...] = ()


class Plant(NamedTuple):
    """What a bench asks of a plant."""

    make: Any
    defaults: Mapping[str, float]
    substeps: int = STEPS
    actuators: Any = None
    dead_times: tuple[str, ...] = ()
    lags: tuple[str, ...] = ()
    open: Any = None
    file: str = "hidden.json"
    observe: Any = None


class Channels:
    """The three channels: commands of the past, and the channels' memory."""

    def __init__(self) -> None:
        self.step = 0  # of its tick
        self.obeyed = (0.0, 0.0, 0.0)
        self.told = np.zeros((3, ROOM))
        self.memory = np.zeros(channels.SIZE)
        self.i = 1  # before the first step everything was at rest

    def hear(self, over_rest: tuple[float, float, float]) -> None:
        """One more step of commands; the distant past is dropped."""
        if self.i == ROOM:
            self.told[:, :REACH] = self.told[:, -REACH:].copy()
            self.i = REACH
        self.told[:, self.i] = over_rest


def _actuators(car: Car, h: Hidden) -> Part:
    arrive = round(car.transport_s / (1e-3 * STEP_MS))

    def step(params: Any, state: Channels, x: Any, dt_s: float) -> tuple[Channels, Actuation]:
        rest = car.rest_frac
        if state.step == arrive:  # commands reach the unit so long after the tick, as in the exam's own logs
            state.obeyed = (x.throttle_frac - rest, x.brake_frac - rest, x.steer_rad)
        state.step = (state.step + 1) % STEPS
        state.hear(state.obeyed)
        i, m, told = state.i, state.memory, state.told
        throttle = channels.throttle_output(car, h, m, told[0], i)
        brake = channels.brake_output(car, h, m, told[1], i)
        steer = channels.steer_output(car, h, m, told[2], i)
        state.i += 1
        return state, Actuation(float(throttle) + rest, float(brake) + rest, float(steer), x.gear)

    return Part(lambda params, dt_s: Channels(), step, 0.0)


class Body:
    """The body's state and the memory of what lies between the reports and it."""

    def __init__(self, start: Any) -> None:
        self.memory = np.zeros(channels.SIZE)
        self.body = chassis.first_body(start.speed_mps)
        self.body[X], self.body[Y], self.body[HEADING] = start.x_m, start.y_m, start.heading_rad


def _chassis(car: Car, h: Hidden) -> Part:
    made: dict[Any, tuple[Hidden, chassis.Chassis]] = {}  # by the road under it

    def on_road(road: Any) -> tuple[Hidden, chassis.Chassis]:
        if road not in made:
            here = h._replace(
                grade=h.grade + road.grade_rad,
                friction=h.friction * road.friction_frac,
                road_bank=h.road_bank + road.bank_rad,
                side_wind=h.side_wind + (car.mass_kg + h.payload) * road.side_wind_mps2,
            )
            made.clear()
            made[road] = (here, chassis_of(car, here))
        return made[road]

    def step(params: Params, state: Body, x: Any, dt_s: float) -> tuple[Body, Motion]:
        here, c = on_road(x.road)
        m, body, rest = state.memory, state.body, car.rest_frac
        act = x.actuation
        m[channels.THROTTLE_OUT], m[channels.BRAKE_OUT] = act.throttle_frac - rest, act.brake_frac - rest
        m[channels.STEER_OUT] = act.steer_rad
        angle = channels.road_wheel(car, here, m, body[SPEED]) + channels.roll_steer(here, m, body[ACROSS])
        push = channels.drive_n(car, here, m, body[SPEED]) if act.gear >= DRIVE else 0.0
        hold = channels.brake_n(car, here, m, body[SPEED], c.mass_kg)
        step_body(c, body, angle, push, hold, car.wheelbase_m)
        return state, _motion(car, body, float(angle))

    params = Params(Constants(car.wheel_radius_m, car.half_track_m))
    return Part(lambda params, dt_s: Body(params.start), step, params)


def _motion(car: Car, body: Any, angle: float) -> Motion:
    u, v, r = float(body[SPEED]), float(body[SIDE]), float(body[YAW])
    across = (v + car.front_m * r) * math.sin(angle)
    left, right = u - car.half_track_m * r, u + car.half_track_m * r
    wheels = (left * math.cos(angle) + across, right * math.cos(angle) + across, left, right)
    place = (float(body[X]), float(body[Y]), float(body[HEADING]))
    forces = (float(body[ALONG]), float(body[ACROSS]), float(body[RATE]))
    return Motion(*place, u, v, r, *forces, *(one / car.wheel_radius_m for one in wheels))


def plant_of(seed: int, mismatch: float, effects: Mapping[str, Mapping[str, float]]) -> Plant:
    """The vehicle of a seed with what is hidden in it; ValueError for an effect that a bench has no place for."""
    if "frame_loss" in effects:
        raise ValueError("frame_loss: frames are the bench's own (its bench file has [[faults]])")
    car, h = draw_vehicle(seed, mismatch).car, hidden_of(effects) if effects else NOTHING

    def make(params: Mapping[str, float], change: Any) -> Part:
        if params:
            raise ValueError(f"this vehicle has no [plant.params], got {', '.join(params)}")
        return _chassis(car, h)

    return Plant(make, {}, actuators=lambda params: _actuators(car, h), open=opened)


def opened(path: Path) -> Plant:
    """The vehicle that a model folder's hidden.json holds under seal."""
    truth = unseal(read_json(Path(path)))
    return plant_of(truth["seed"], truth["mismatch"], truth["effects"])


VEHICLE = plant_of(0, 0.0, {})
