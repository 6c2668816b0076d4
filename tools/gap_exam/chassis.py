"""A car on four tyres: forces and their integration in steps of 1 ms (Adams-Bashforth of order 2).

Axes ISO 8855 at the centre of mass. Below walking pace the car rolls without slip.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tools.gap_exam.car import AIR_KGPM3, G_MPS2, Car
from tools.gap_exam.fast import fast
from tools.gap_exam.hidden import Hidden
from tools.gap_exam.signals import STEP_S, STEPS_PER_S

SPEED, SIDE, YAW, X, Y, HEADING = range(6)  # a body's state; x, y of the rear axle's middle
OLD = 6  # rates of the first three, one step ago
TYRES = 9  # lateral forces of FL, FR, RL, RR
ALONG, ACROSS = 13, 14  # specific force at the centre of mass
RATE = 15  # of the speed
SIZE = 16
CRAWL_MPS, ROLL_MPS = 0.7, 1.7  # without slip below the first, with all of it above the second


class Chassis(NamedTuple):
    """The car as it is on that day: with its load, on that road, in that wind."""

    mass_kg: float
    front_m: float
    rear_m: float
    inertia_kgm2: float
    half_track_m: float
    front_n: float  # static load of a wheel
    rear_n: float
    front_stiffness: float
    rear_stiffness: float
    friction: float
    form: float
    brush: float
    transfer: float  # height over track: load moved across per N of side force
    load_slope: float
    relax_m: float
    rolling_n: float
    drag_kgpm: float
    extra_kgpm: float
    wind_mps: float
    side_n: float
    slope_mps2: float
    bank_mps2: float


def chassis_of(car: Car, h: Hidden) -> Chassis:
    """The car with what is hidden in it."""
    mass = car.mass_kg + h.payload
    shift = h.payload * h.payload_ahead_m / mass
    front = car.front_m - shift
    rear = car.wheelbase_m - front
    weight = mass * G_MPS2 * math.cos(h.grade) * math.cos(h.road_bank)
    return Chassis(
        mass_kg=mass,
        front_m=front,
        rear_m=rear,
        inertia_kgm2=car.inertia_kgm2 + h.payload * h.payload_ahead_m**2 - mass * shift**2,
        half_track_m=car.half_track_m,
        front_n=0.5 * weight * rear / car.wheelbase_m,
        rear_n=0.5 * weight * front / car.wheelbase_m,
        front_stiffness=car.front_stiffness * h.front_stiffness,
        rear_stiffness=car.rear_stiffness * h.rear_stiffness,
        friction=car.friction * h.friction,
        form=car.tyre_form,
        brush=car.brush_frac,
        transfer=car.height_m / (2.0 * car.half_track_m),
        load_slope=car.load_slope,
        relax_m=h.tyre_relaxation,
        rolling_n=car.rolling_frac * mass * G_MPS2 * (1.0 + h.rolling_resistance),
        drag_kgpm=0.5 * AIR_KGPM3 * car.drag_area_m2,
        extra_kgpm=0.5 * AIR_KGPM3 * h.aero_drag,
        wind_mps=h.head_wind,
        side_n=h.side_wind,
        slope_mps2=G_MPS2 * math.sin(h.grade),
        bank_mps2=G_MPS2 * math.sin(h.road_bank),
    )


def first_body(speed_mps: float) -> np.ndarray:
    """Rolling straight on at the origin."""
    body = np.zeros(SIZE)
    body[SPEED] = speed_mps
    return body


@fast
def curve(z, form, brush):
    """Side force over its limit against slip angle times stiffness over that limit."""
    smooth = math.sin(form * math.atan(z / form))
    if brush <= 0.0:
        return smooth
    size = abs(z)
    bristles = math.copysign(size - size * size / 3.0 + size**3 / 27.0 if size < 3.0 else 1.0, z)
    return smooth + brush * (bristles - smooth)


@fast
def tyre_n(c, slip_rad, stiffness, static_n, load_n, along_n):
    """Side force of a tyre: its stiffness falls with the square of the load's change, its limit with what it pulls."""
    load_n = max(load_n, 1.0)
    change = load_n / static_n - 1.0
    stiffness = stiffness * max(1.0 - c.load_slope * change * change, 0.2)
    limit_n = c.friction * load_n
    used = min(abs(along_n) / limit_n, 0.95)
    limit_n = limit_n * math.sqrt(1.0 - used * used)
    return limit_n * curve(stiffness * slip_rad / limit_n, c.form, c.brush)


@fast
def side_forces(c, body, angle, front_n, rear_n):
    """Lateral forces of the four tyres, into the body's state; front_n, rear_n: longitudinal force of a wheel there."""
    u, v, r = max(body[SPEED], 0.5), body[SIDE], body[YAW]
    moved_front = c.transfer * body[ACROSS] * c.mass_kg * c.rear_m / (c.front_m + c.rear_m)
    moved_rear = c.transfer * body[ACROSS] * c.mass_kg * c.front_m / (c.front_m + c.rear_m)
    share = 1.0
    if c.relax_m > 0.0:
        share = 1.0 - math.exp(-STEP_S * abs(body[SPEED]) / c.relax_m)
    for wheel in range(4):
        left = 1.0 if wheel % 2 == 0 else -1.0  # a turn to the left takes load off the left wheels
        hub = max(u - left * c.half_track_m * r, 0.3)
        if wheel < 2:
            slip = angle - math.atan((v + c.front_m * r) / hub)
            new = tyre_n(c, slip, c.front_stiffness, c.front_n, c.front_n - left * moved_front, front_n)
        else:
            slip = -math.atan((v - c.rear_m * r) / hub)
            new = tyre_n(c, slip, c.rear_stiffness, c.rear_n, c.rear_n - left * moved_rear, rear_n)
        body[TYRES + wheel] += share * (new - body[TYRES + wheel])


@fast
def resistance_n(c, speed):
    """Drag of the car's own body in the wind, and of what was added in still air's manner."""
    wind = speed + c.wind_mps
    return c.drag_kgpm * wind * abs(wind) + c.extra_kgpm * speed * abs(speed)


@fast
def step_body(c, body, angle, drive_n, brake_n, wheelbase):
    """One step. drive_n: all that pushes; brake_n: what only opposes; angle: of the front wheels."""
    u, v, r = body[SPEED], body[SIDE], body[YAW]
    hold_n = brake_n + c.rolling_n
    push_n = drive_n - resistance_n(c, u) - c.mass_kg * c.slope_mps2
    if u <= 0.0 and push_n <= hold_n:
        stand(c, body)
        return
    grip_n = c.friction * 2.0 * (c.front_n + c.rear_n)
    side_forces(c, body, angle, 0.5 * drive_n - 0.32 * brake_n, -0.18 * brake_n)
    cosine, sine = math.cos(angle), math.sin(angle)
    front, rear = body[TYRES] + body[TYRES + 1], body[TYRES + 2] + body[TYRES + 3]
    along = (push_n - min(hold_n, grip_n) - front * sine) / c.mass_kg
    across = (front * cosine + rear + c.side_n) / c.mass_kg
    twist = c.front_m * front * cosine - c.rear_m * rear
    twist += c.half_track_m * sine * (body[TYRES] - body[TYRES + 1])
    rates = (along + v * r, across - c.bank_mps2 - u * r, twist / c.inertia_kgm2)
    was_u, was_v, was_r = u, v, r
    u = max(u + STEP_S * (1.5 * rates[0] - 0.5 * body[OLD]), 0.0)
    v = v + STEP_S * (1.5 * rates[1] - 0.5 * body[OLD + 1])
    r = r + STEP_S * (1.5 * rates[2] - 0.5 * body[OLD + 2])
    for place in range(3):
        body[OLD + place] = rates[place]
    if u < ROLL_MPS:
        share = max((u - CRAWL_MPS) / (ROLL_MPS - CRAWL_MPS), 0.0)
        rolled = u * math.tan(angle) / wheelbase
        r = share * r + (1.0 - share) * rolled
        v = share * v + (1.0 - share) * rolled * c.rear_m
    body[SPEED], body[SIDE], body[YAW] = u, v, r
    body[RATE] = (u - was_u) * STEPS_PER_S
    body[ALONG] = body[RATE] - v * r + c.slope_mps2
    body[ACROSS] = (v - was_v) * STEPS_PER_S + u * r + c.bank_mps2
    go_on(c, body, 0.5 * (was_u + u), 0.5 * (was_v + v), 0.5 * (was_r + r))


@fast
def go_on(c, body, u, v, r):
    """The pose after a step with these mean velocities (midpoint rule)."""
    middle = body[HEADING] + 0.5 * STEP_S * r
    slide = v - c.rear_m * r
    body[X] += STEP_S * (u * math.cos(middle) - slide * math.sin(middle))
    body[Y] += STEP_S * (u * math.sin(middle) + slide * math.cos(middle))
    body[HEADING] += STEP_S * r


@fast
def stand(c, body):
    """Standing: nothing moves, tyres at ease, and gravity is felt."""
    for place in (SPEED, SIDE, YAW, RATE):
        body[place] = 0.0
    body[OLD : OLD + 3] = 0.0
    body[TYRES : TYRES + 4] = 0.0
    body[ALONG], body[ACROSS] = c.slope_mps2, c.bank_mps2
