"""Plant kind `reference`: the stand-in for a measured car, with effects that the other plants leave out.

Two tracks with load transfer, unequal axles, relaxing tyres with combined slip, steering compliance, brake dead band,
step and hysteresis, creep, power-limited drive with gear steps. Ten steps of 1 ms a tick: RK4 for velocities and tyre
slips, Simpson's rule for the pose; pedals, gearbox and load transfer advance once a step. It has its own
actuators and shares only rigid-body kinematics with `physics`. It does not drive backwards; in reverse it coasts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from tunefree_hil.base.contracts import LEAST_BRAKE_GAIN, BodyChange
from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import GEAR_DRIVE, GEAR_PARK, Disturbance, Motion
from tunefree_hil.base.units import G_MPS2
from tunefree_hil.plant.reference_vehicle import actuators
from tunefree_hil.plant.reference_vehicle.car import DEFAULTS, constants_of
from tunefree_hil.plant.reference_vehicle.maps import (
    MAP_REST_FRAC,
    Gearbox,
    brake_force_n,
    drive_force_n,
    first_gearbox,
    gear_factor,
    idle_force_n,
    step_gearbox,
    table_duty,
)
from tunefree_hil.plant.reference_vehicle.tyres import Chassis, Loads, Tyre, four_tyres, side_n
from tunefree_hil.plant.types import ChassisInput, ChassisParams, Plant, rolling_motion

PARKED_N = 1.0e6  # holding force of a locked gearbox


class Slips(NamedTuple):
    """The seven states of RK4, or their rates."""

    speed: float
    side: float
    yaw: float
    front_left: float
    front_right: float
    rear_left: float
    rear_right: float


class RoadForces(NamedTuple):
    """What gravity and wind do on this road, changes by effects included."""

    slope_n: float  # against the motion
    side_n: float  # of wind and bank, to the left
    side_wind_mps2: float  # of the wind alone: it acts on the body, not through the tyres
    bank_mps2: float  # gravity to the right, measured by an accelerometer as specific force to the left


class Step(NamedTuple):
    """Forces that are constant during one step."""

    front_left: Tyre
    front_right: Tyre
    rear_left: Tyre
    rear_right: Tyre
    resist_n: float  # slope and rolling, against the motion
    side_n: float  # of wind and bank, to the left
    hold_s: float


class ReferenceState(NamedTuple):
    """Motion, tyre slips, sprung mass, engine, gearbox, brake duty after the hysteresis, and brake energy."""

    motion: Motion
    slips: Slips
    loads: Loads
    drive_n: float
    box: Gearbox
    brake_frac: float  # duty of the tables
    braked_j: float  # energy dissipated by the brakes


@kernel
def wheel(
    p: Chassis, tyre: Tyre, hold_s: float, along: float, across: float, slip: float
) -> tuple[float, float, float]:
    """Force of one wheel in the car's axes, and the rate of its slip; along, across: velocity of its hub."""
    rolls = along * tyre.cosine + across * tyre.sine
    slides = across * tyre.cosine - along * tyre.sine
    rate = -(slides + abs(rolls) * slip) * p.inverse_relaxation
    force_n = side_n(tyre, slip + hold_s * rate)
    return (
        tyre.along_n * tyre.cosine - force_n * tyre.sine,
        tyre.along_n * tyre.sine + force_n * tyre.cosine,
        rate,
    )


@kernel
def rates(p: Chassis, forces: Step, s: Slips) -> Slips:
    """Newton and Euler in the plane, four wheels."""
    left, right = s.speed - p.half_track_m * s.yaw, s.speed + p.half_track_m * s.yaw
    front, rear = s.side + p.front_axle_m * s.yaw, s.side - p.rear_axle_m * s.yaw
    fl_x, fl_y, fl_rate = wheel(p, forces.front_left, forces.hold_s, left, front, s.front_left)
    fr_x, fr_y, fr_rate = wheel(p, forces.front_right, forces.hold_s, right, front, s.front_right)
    rl_x, rl_y, rl_rate = wheel(p, forces.rear_left, forces.hold_s, left, rear, s.rear_left)
    rr_x, rr_y, rr_rate = wheel(p, forces.rear_right, forces.hold_s, right, rear, s.rear_right)
    if p.head_wind_mps != 0.0:
        air_mps = s.speed + p.head_wind_mps
        drag_n = p.drag_kgpm * air_mps * abs(air_mps)
    else:
        drag_n = p.drag_kgpm * s.speed * s.speed
    along_n = fl_x + fr_x + rl_x + rr_x - forces.resist_n - drag_n
    twist_nm = p.front_axle_m * (fl_y + fr_y) - p.rear_axle_m * (rl_y + rr_y)
    twist_nm = twist_nm + p.half_track_m * (fr_x + rr_x - fl_x - rl_x)
    return Slips(
        along_n * p.inverse_mass + s.side * s.yaw,
        (fl_y + fr_y + rl_y + rr_y + forces.side_n) * p.inverse_mass - s.speed * s.yaw,
        twist_nm * p.inverse_inertia,
        fl_rate,
        fr_rate,
        rl_rate,
        rr_rate,
    )


@kernel
def ahead(s: Slips, rate: Slips, by_s: float) -> Slips:
    """s + by_s * rate."""
    return Slips(
        s.speed + by_s * rate.speed,
        s.side + by_s * rate.side,
        s.yaw + by_s * rate.yaw,
        s.front_left + by_s * rate.front_left,
        s.front_right + by_s * rate.front_right,
        s.rear_left + by_s * rate.rear_left,
        s.rear_right + by_s * rate.rear_right,
    )


@kernel
def runge_kutta(p: Chassis, forces: Step, s: Slips, dt_s: float) -> tuple[Slips, Slips]:
    """Classical RK4: (state half-way, state after the step)."""
    a = rates(p, forces, s)
    b = rates(p, forces, ahead(s, a, 0.5 * dt_s))
    middle = ahead(s, b, 0.5 * dt_s)
    c = rates(p, forces, middle)
    d = rates(p, forces, ahead(s, c, dt_s))
    end = ahead(ahead(s, a, dt_s / 6.0), d, dt_s / 6.0)
    return middle, ahead(ahead(end, b, dt_s / 3.0), c, dt_s / 3.0)


@kernel
def pose(p: Chassis, motion: Motion, middle: Slips, new: Slips, dt_s: float) -> tuple[float, float, float]:
    """Rear axle's middle after the step, by Simpson's rule."""
    sixth = dt_s / 6.0
    half_turn = 0.25 * dt_s * (motion.yaw_rate_radps + middle.yaw)
    heading = motion.heading_rad + sixth * (motion.yaw_rate_radps + 4.0 * middle.yaw + new.yaw)
    c0, s0 = math.cos(motion.heading_rad), math.sin(motion.heading_rad)
    c1, s1 = math.cos(motion.heading_rad + half_turn), math.sin(motion.heading_rad + half_turn)
    c2, s2 = math.cos(heading), math.sin(heading)
    slide0 = motion.side_speed_mps - p.rear_axle_m * motion.yaw_rate_radps
    slide1, slide2 = middle.side - p.rear_axle_m * middle.yaw, new.side - p.rear_axle_m * new.yaw
    along = motion.speed_mps * c0 - slide0 * s0 + 4.0 * (middle.speed * c1 - slide1 * s1) + new.speed * c2 - slide2 * s2
    across = (
        motion.speed_mps * s0 + slide0 * c0 + 4.0 * (middle.speed * s1 + slide1 * c1) + new.speed * s2 + slide2 * c2
    )
    return motion.x_m + sixth * along, motion.y_m + sixth * across, heading


@kernel
def caught_up(value: float, target: float, lag_s: float, dt_s: float) -> float:
    """First-order lag, implicit Euler."""
    return value + (target - value) * dt_s / (dt_s + max(lag_s, 0.0))


@kernel
def road_forces(p: Chassis, road: Disturbance) -> RoadForces:
    """The road's own slope, bank and wind added to those of effects."""
    fall = math.sin(road.bank_rad + p.bank_rad)
    return RoadForces(
        p.mass_kg * G_MPS2 * math.sin(road.grade_rad + p.grade_rad),
        p.side_force_n + p.mass_kg * road.side_wind_mps2 - p.mass_kg * G_MPS2 * fall,
        p.side_wind_mps2 + road.side_wind_mps2,
        G_MPS2 * fall,
    )


@kernel
def step_reference(
    params: ChassisParams, state: ReferenceState, x: ChassisInput, dt_s: float
) -> tuple[ReferenceState, Motion]:
    """One step of 1 ms."""
    p = params.constants
    act, motion_before = x.actuation, state.motion
    throttle = table_duty(act.throttle_frac, p.rest_frac, p.throttle_scale)
    brake = table_duty(act.brake_frac, p.rest_frac, p.brake_scale)
    brake_frac = state.brake_frac
    if brake > brake_frac:
        brake_frac = brake
    elif brake < brake_frac - p.hysteresis_frac:
        brake_frac = brake + p.hysteresis_frac
    left = 1.0 - p.brake_loss_per_j * state.braked_j
    brake_n = brake_force_n(p.maps, brake_frac) * (left if left > LEAST_BRAKE_GAIN else LEAST_BRAKE_GAIN)
    rolling_n = p.rolling_n + p.brake_drag_n
    box = step_gearbox(p.maps, state.box, throttle, motion_before.speed_mps, dt_s)
    engine_n, drive_n = 0.0, 0.0
    if act.gear >= GEAR_DRIVE:
        asked_n = drive_force_n(p.maps, throttle, motion_before.speed_mps) * gear_factor(
            p.maps, box, motion_before.speed_mps
        )
        if asked_n * motion_before.speed_mps > p.power_w:
            asked_n = p.power_w / motion_before.speed_mps  # not 0: the power above is not 0
        drive_n = caught_up(state.drive_n, asked_n, p.drive_lag_s, dt_s)
        engine_n = drive_n + idle_force_n(p.maps, motion_before.speed_mps, brake, MAP_REST_FRAC)
    elif act.gear == GEAR_PARK:
        brake_n = brake_n + PARKED_N
    road = road_forces(p, x.road)
    if motion_before.speed_mps <= 0.0 and engine_n - road.slope_n - p.wind_n <= brake_n + rolling_n:
        return stand(p, state, drive_n, box, brake_frac, road, dt_s)

    front_n = state.slips.front_left * p.front_stiffness + state.slips.front_right * p.front_stiffness
    angle = act.steer_rad * p.inverse_ratio - p.compliance * front_n
    front_asked_n = 0.5 * (p.drive_front_frac * engine_n - p.brake_front_frac * brake_n)
    rear_asked_n = 0.5 * (1.0 - p.drive_front_frac) * engine_n - 0.5 * (1.0 - p.brake_front_frac) * brake_n
    fl, fr, rl, rr = four_tyres(p, state.loads, x.road.friction_frac, front_asked_n, rear_asked_n, angle)
    held_n = engine_n - (fl.along_n + fr.along_n + rl.along_n + rr.along_n)  # slip of a tyre does not heat the brake
    braked_j = state.braked_j + dt_s * motion_before.speed_mps * clamp(held_n, 0.0, brake_n)
    calm = 1.0 + motion_before.speed_mps * motion_before.speed_mps * 0.1
    forces = Step(fl, fr, rl, rr, road.slope_n + rolling_n, road.side_n, p.hold_s / calm)
    middle, slips = runge_kutta(p, forces, state.slips, dt_s)
    if slips.speed <= 0.0:
        return stand(p, state, drive_n, box, brake_frac, road, dt_s)
    motion = moved(p, motion_before, forces, middle, slips, road, dt_s)
    loads = Loads(
        caught_up(state.loads.along_mps2, motion.accel_mps2, p.body_lag_s, dt_s),
        caught_up(state.loads.left_mps2, motion.lateral_accel_mps2 - road.side_wind_mps2, p.body_lag_s, dt_s),
    )
    return ReferenceState(motion, slips, loads, drive_n, box, brake_frac, braked_j), motion


@kernel
def moved(p: Chassis, motion: Motion, forces: Step, middle: Slips, s: Slips, road: RoadForces, dt_s: float) -> Motion:
    """The motion after a step; wheels turn with the hub's speed and the slip that their force needs."""
    x_m, y_m, heading_rad = pose(p, motion, middle, s, dt_s)
    speed_rate = (s.speed - motion.speed_mps) / dt_s
    left, right = s.speed - p.half_track_m * s.yaw, s.speed + p.half_track_m * s.yaw
    front = s.side + p.front_axle_m * s.yaw
    fl, fr, rl, rr = forces.front_left, forces.front_right, forces.rear_left, forces.rear_right
    return Motion(
        x_m,
        y_m,
        heading_rad,
        s.speed,
        s.side,
        s.yaw,
        speed_rate - middle.side * middle.yaw + road.slope_n * p.inverse_mass,
        (s.side - motion.side_speed_mps) / dt_s + middle.speed * middle.yaw + road.bank_mps2,
        speed_rate,
        (left * fl.cosine + front * fl.sine) * (1.0 + fl.along_n * p.inverse_slip) * p.inverse_radius,
        (right * fr.cosine + front * fr.sine) * (1.0 + fr.along_n * p.inverse_slip) * p.inverse_radius,
        left * (1.0 + rl.along_n * p.inverse_slip) * p.inverse_radius,
        right * (1.0 + rr.along_n * p.inverse_slip) * p.inverse_radius,
    )


@kernel
def stand(
    p: Chassis, state: ReferenceState, drive_n: float, box: Gearbox, brake_frac: float, road: RoadForces, dt_s: float
) -> tuple[ReferenceState, Motion]:
    """Standing still: nothing moves, the tyres have no slip, the body settles."""
    motion_before, gravity_mps2 = state.motion, road.slope_n * p.inverse_mass
    motion = Motion(
        motion_before.x_m,
        motion_before.y_m,
        motion_before.heading_rad,
        0.0,
        0.0,
        0.0,
        gravity_mps2,
        road.bank_mps2,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    )
    loads = Loads(
        caught_up(state.loads.along_mps2, gravity_mps2, p.body_lag_s, dt_s),
        caught_up(state.loads.left_mps2, road.bank_mps2 - road.side_wind_mps2, p.body_lag_s, dt_s),
    )
    at_ease = Slips(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return ReferenceState(motion, at_ease, loads, drive_n, box, brake_frac, state.braked_j), motion


def init_reference(params: ChassisParams, dt_s: float) -> ReferenceState:
    """Rolling straight at the start, in the gear for it, pedals at rest."""
    p, speed_mps = params.constants, params.start.speed_mps
    slips = Slips(speed_mps, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    motion = rolling_motion(params.start, p.wheel_radius_m)
    box = first_gearbox(speed_mps, p.shift_gain)
    return ReferenceState(motion, slips, Loads(0.0, 0.0), 0.0, box, MAP_REST_FRAC, 0.0)


def make(params: Mapping[str, float], change: BodyChange) -> Block:
    """The chassis Block ChassisInput -> Motion; InputError for a key that is not in DEFAULTS."""
    return Block(init_reference, step_reference, ChassisParams(constants_of(params, change)))


PLANT = Plant(
    make,
    DEFAULTS,
    substeps=10,
    actuators=actuators.own_actuators,
    dead_times=actuators.DEAD_TIMES,
    lags=actuators.LAGS,
)
