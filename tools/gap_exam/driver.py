"""Who drives: a person (late, unsteady, satisfied with nearly) or a controller on the reports; both feed back.

The driver knows the car by its data sheet and some practice. Called once a tick of 10 ms.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tools.gap_exam.car import Vehicle
from tools.gap_exam.fast import fast

TICK_S = 0.01
REPLAY, PERSON, CONTROLLER = 0, 1, 2
PEDAL_STEP, STEER_STEP_RAD = 1.0 / 20000.0, math.radians(0.05)  # resolution of the command frames
# Memory
SUM_SPEED, SUM_YAW, HELD_PEDAL, PEDAL, STEER = range(5)
SIZE = 5


class Driver(NamedTuple):
    """Practice and habits. Accelerations per duty; times in s; limits are the folder's, pedals above rest."""

    who: int
    reaction_s: float
    speed_gain: float
    speed_sum: float
    yaw_gain: float
    yaw_sum: float
    hold_frac: float  # a person leaves the pedal where it is, this far from what would be right
    pedal_lag_s: float
    hand_lag_s: float
    tremor: float
    most_up_mps2: float
    most_down_mps2: float
    lateral_mps2: float
    ratio: float
    wheelbase_m: float
    bend_s2pm: float
    full_mps2: float  # of the throttle, standing
    drive_bend: float
    power_wpkg: float
    throttle_zero: float
    throttle_span: float
    brake_mps2: float  # per duty
    rest_mps2: float
    creep_mps2: float
    creep_mps: float
    throttle_limit: float
    brake_limit: float
    steer_limit: float
    steer_rate: float
    top_mps: float


def driver_of(vehicle: Vehicle, who: int, rng: np.random.Generator) -> Driver:
    """Somebody who has driven this car before: what is known is up to some percent wrong."""
    car, limits, sheet = vehicle.car, vehicle.limits, vehicle.sheet
    rear = car.wheelbase_m - car.front_m
    bend = car.mass_kg / car.wheelbase_m * (rear / (2 * car.front_stiffness) - car.front_m / (2 * car.rear_stiffness))
    human = who == PERSON

    def about(value: float) -> float:
        return value * rng.uniform(0.94, 1.06)

    return Driver(
        who=who,
        reaction_s=rng.uniform(0.16, 0.28) if human else 0.0,
        speed_gain=rng.uniform(0.35, 0.6) if human else rng.uniform(0.6, 1.0),
        speed_sum=0.03 if human else 0.12,
        yaw_gain=rng.uniform(0.15, 0.35) if human else rng.uniform(0.3, 0.6),
        yaw_sum=rng.uniform(0.2, 0.5) if human else rng.uniform(0.4, 0.9),
        hold_frac=rng.uniform(0.006, 0.014) if human else 0.0,
        pedal_lag_s=rng.uniform(0.12, 0.22) if human else 0.03,
        hand_lag_s=rng.uniform(0.08, 0.16) if human else 0.02,
        tremor=rng.uniform(0.004, 0.012) if human else 0.0,
        most_up_mps2=rng.uniform(1.2, 1.9),
        most_down_mps2=rng.uniform(1.6, 2.8),
        lateral_mps2=rng.uniform(2.6, 3.4),
        ratio=sheet["steer_ratio"],
        wheelbase_m=sheet["wheelbase_m"],
        bend_s2pm=about(bend),
        full_mps2=about(car.drive_n / car.mass_kg),
        drive_bend=car.drive_bend,
        power_wpkg=about(car.drive_w / car.mass_kg),
        throttle_zero=car.throttle_zero,
        throttle_span=car.throttle_full - car.throttle_zero,
        brake_mps2=about(car.brake_n / car.mass_kg),
        rest_mps2=about(car.rolling_frac * 9.81 + 0.05),
        creep_mps2=car.creep_n / car.mass_kg,
        creep_mps=car.creep_mps,
        throttle_limit=limits.throttle_frac - car.rest_frac,
        brake_limit=limits.brake_frac - car.rest_frac,
        steer_limit=limits.steer_rad,
        steer_rate=min(limits.steer_rate_radps, 6.0) if human else limits.steer_rate_radps,
        top_mps=limits.speed_mps - 2.0,
    )


@fast
def pedal_for(d, accel, speed):
    """Duty above rest for an acceleration: throttle positive, brake negative; 0 between what rolling and creep do."""
    free = -d.rest_mps2 + d.creep_mps2 * max(1.0 - speed / d.creep_mps, 0.0)
    if accel > free + 0.04:
        share = (accel - free) / d.full_mps2
        share = share * math.sqrt(1.0 + (accel * speed / d.power_wpkg) ** 2)
        share = min(d.drive_bend * share / max(1.0 + d.drive_bend - share, 0.1), 1.0)
        return d.throttle_zero + d.throttle_span * share
    if accel < free - 0.08:
        return (accel - free) / d.brake_mps2
    return 0.0


@fast
def ask_pedal(d, m, wish_mps, open_pedal, speed):
    """One signed pedal: throttle positive, brake negative; open_pedal: what to press instead of steering the speed."""
    if not math.isnan(open_pedal) and not (open_pedal > 0.0 and speed > d.top_mps):
        m[SUM_SPEED] = 0.0
        wanted = open_pedal
        m[HELD_PEDAL] = wanted
    else:
        off = wish_mps - speed
        accel = min(max(d.speed_gain * off + m[SUM_SPEED], -d.most_down_mps2), d.most_up_mps2)
        if abs(off) < 2.0:
            m[SUM_SPEED] = min(max(m[SUM_SPEED] + TICK_S * d.speed_sum * off, -1.5), 1.5)
        if wish_mps < 0.3 and speed < 0.8:
            accel, m[SUM_SPEED] = -1.2, 0.0
        wanted = pedal_for(d, accel, speed)
        if abs(wanted - m[HELD_PEDAL]) > d.hold_frac or wanted * m[HELD_PEDAL] < 0.0:
            m[HELD_PEDAL] = wanted
        wanted = m[HELD_PEDAL]
    share = 1.0 if not math.isnan(open_pedal) else TICK_S / (TICK_S + d.pedal_lag_s)
    m[PEDAL] += share * (wanted - m[PEDAL])
    return m[PEDAL]


@fast
def ask_steer(d, m, curvature, extra_rad, opened, tremor, speed, yaw):
    """The steering wheel's angle for a curvature; opened: no feedback, only what the plan adds."""
    length = d.wheelbase_m + d.bend_s2pm * speed * speed
    wanted = d.ratio * length * curvature
    if opened:
        m[SUM_YAW] *= 0.995
    elif speed > 2.0:
        off = (curvature * speed - yaw) / max(speed, 4.0)
        m[SUM_YAW] = min(max(m[SUM_YAW] + TICK_S * d.yaw_sum * off, -0.05), 0.05)
        wanted += d.ratio * length * d.yaw_gain * off
    wanted += d.ratio * length * m[SUM_YAW] + d.tremor * tremor
    lag_s = 0.0 if opened else d.hand_lag_s
    target = m[STEER] + TICK_S / (TICK_S + lag_s) * (wanted + extra_rad - m[STEER])
    most = min(d.steer_limit, d.ratio * length * d.lateral_mps2 / max(speed * speed, 4.0))
    target = min(max(target, -most), most)
    m[STEER] = min(max(target, m[STEER] - d.steer_rate * TICK_S), m[STEER] + d.steer_rate * TICK_S)
    return m[STEER]


@fast
def as_commands(d, pedal, steer, row):
    """Throttle and brake above rest and steering, in whole steps of the command frames, into `row`."""
    throttle = min(max(pedal, 0.0), d.throttle_limit)
    brake = min(max(-pedal, 0.0), d.brake_limit)
    row[0] = round(throttle / PEDAL_STEP) * PEDAL_STEP
    row[1] = round(brake / PEDAL_STEP) * PEDAL_STEP
    row[2] = round(steer / STEER_STEP_RAD) * STEER_STEP_RAD
