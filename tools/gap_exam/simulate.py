"""One drive: the car in steps of 1 ms, reports and driver in ticks of 10 ms.

The same loop drives a car by a plan (person or controller) and by recorded commands (REPLAY), where the body may be put
to given states at given ticks: that is how detectability is decided.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tools.gap_exam import channels, chassis, driver
from tools.gap_exam.car import G_MPS2, Car
from tools.gap_exam.chassis import HEADING, SPEED, YAW, Chassis, X, Y, chassis_of, first_body, step_body
from tools.gap_exam.driver import Driver, as_commands, ask_pedal, ask_steer
from tools.gap_exam.fast import fast
from tools.gap_exam.hidden import Hidden
from tools.gap_exam.signals import lagged, late

STEPS = 10  # of 1 ms, a tick
# What can be reported, in the order of `seen` and of `reports`
(THROTTLE_ECHO, THROTTLE_OUT, BRAKE_ECHO, BRAKE_OUT, STEER_ECHO, STEER_OUT, REPORT_SPEED, WHEEL_FL, WHEEL_FR, WHEEL_RL,
 WHEEL_RR, ACCEL, LATERAL, REPORT_YAW) = range(14)  # fmt: skip
INS_X, INS_Y, INS_HEADING, INS_SPEED, INS_ACCEL, INS_YAW = range(14, 20)
ROWS = 20


class Plan(NamedTuple):
    """What the driver wants, a row a tick: speed, curvature, what is added to the steering; pedal NaN: by the speed."""

    speed_mps: np.ndarray
    curvature_1pm: np.ndarray
    steer_rad: np.ndarray
    opened: np.ndarray  # 1 where nobody feeds the yaw rate back
    pedal_frac: np.ndarray
    tremor: np.ndarray
    start_mps: float


class Drive(NamedTuple):
    """A drive that was made. commands [K, 3] above rest; reports [K, 20]; body [K, SIZE] true, at each tick."""

    commands: np.ndarray
    reports: np.ndarray
    body: np.ndarray


class Given(NamedTuple):
    """What comes from outside of the loop: noise [K, 20], lost command frames [K], recorded commands, restarts [K]."""

    noise: np.ndarray
    lost: np.ndarray
    commands: np.ndarray
    restart: np.ndarray
    body: np.ndarray


def drive(car: Car, h: Hidden, plan: Plan, who: Driver, noise: np.ndarray, lost: np.ndarray) -> Drive:
    """Drive by a plan. noise [K, 20]: added to the reports; lost [K]: ticks whose command frames nobody obeys."""
    ticks = len(plan.speed_mps)
    given = Given(noise, lost, np.zeros((ticks, 3)), np.zeros(ticks, np.bool_), np.zeros((ticks, chassis.SIZE)))
    return Drive(*_run(car, chassis_of(car, h), h, plan, who, given, first_body(plan.start_mps)))


def replay(
    car: Car, h: Hidden, who: Driver, commands: np.ndarray, body: np.ndarray, restart: np.ndarray, lost: np.ndarray
) -> Drive:
    """Drive by commands [K, 3], without noise, the body put to `body` at the ticks that `restart` marks."""
    ticks, none = len(commands), np.zeros(len(commands))
    plan = Plan(none, none, none, none, none, none, 0.0)
    given = Given(np.zeros((ticks, ROWS)), lost, commands, restart, body)
    return Drive(*_run(car, chassis_of(car, h), h, plan, who._replace(who=driver.REPLAY), given, body[0].copy()))


@fast
def _run(car: Car, c: Chassis, h: Hidden, plan: Plan, who: Driver, given: Given, body):
    ticks = len(plan.speed_mps)
    told = np.zeros((3, ticks * STEPS))  # commands as they stand at the by-wire unit, above rest
    seen = np.zeros((ROWS, ticks * STEPS))
    commands, reports = np.zeros((ticks, 3)), np.zeros((ticks, ROWS))
    bodies = np.zeros((ticks, chassis.SIZE))
    m, mind = np.zeros(channels.SIZE), np.zeros(driver.SIZE)
    arrive = round(car.transport_s * 1000.0)
    obeyed = np.zeros(3)
    yaw_soft = 0.0
    for k in range(ticks):
        if given.restart[k]:
            body[:] = given.body[k]
        for step in range(STEPS):
            i = k * STEPS + step
            if step == 0:
                yaw_soft = sense(car, h, m, body, seen, i, yaw_soft, obeyed)
                bodies[k] = body
                report(car, h, seen, i, given.noise[k], reports[k])
                command(who, plan, given, mind, reports, seen, k, i, commands[k])
            if step == arrive and not given.lost[k]:
                obeyed[:] = commands[k]
            told[:, i] = obeyed
            channels.throttle_output(car, h, m, told[0], i)
            channels.brake_output(car, h, m, told[1], i)
            channels.steer_output(car, h, m, told[2], i)
            angle = channels.road_wheel(car, h, m, body[SPEED])
            angle += channels.roll_steer(h, m, body[chassis.ACROSS])
            push = channels.drive_n(car, h, m, body[SPEED])
            hold = channels.brake_n(car, h, m, body[SPEED], c.mass_kg)
            step_body(c, body, angle, push, hold, car.wheelbase_m)
            if step < STEPS - 1:
                yaw_soft = sense(car, h, m, body, seen, i + 1, yaw_soft, obeyed)
    return commands, reports, bodies


@fast
def sense(car, h, m, body, seen, i, yaw_soft, obeyed):
    """What there is to measure at step i, into column i of `seen`; the filtered yaw rate."""
    u, r = body[SPEED], body[YAW]
    angle = m[channels.ANGLE]
    seen[THROTTLE_ECHO, i], seen[BRAKE_ECHO, i], seen[STEER_ECHO, i] = obeyed[0], obeyed[1], obeyed[2]
    seen[THROTTLE_OUT, i], seen[BRAKE_OUT, i] = m[channels.THROTTLE_OUT], m[channels.BRAKE_OUT]
    seen[STEER_OUT, i] = m[channels.STEER_OUT]
    seen[REPORT_SPEED, i] = u
    across = body[chassis.SIDE] + (car.front_m) * r
    left, right = u - car.half_track_m * r, u + car.half_track_m * r
    pull = car.slip_per_n * body[chassis.ALONG] * car.mass_kg
    seen[WHEEL_FL, i] = (left * np.cos(angle) + across * np.sin(angle)) * (1.0 + pull) / car.wheel_radius_m
    seen[WHEEL_FR, i] = (right * np.cos(angle) + across * np.sin(angle)) * (1.0 + pull) / car.wheel_radius_m
    seen[WHEEL_RL, i] = left / car.wheel_radius_m
    seen[WHEEL_RR, i] = right / car.wheel_radius_m
    lean = G_MPS2 * np.sin(m[channels.ROLL]) if h.body_roll > 0.0 else 0.0
    seen[ACCEL, i], seen[LATERAL, i] = body[chassis.ALONG], body[chassis.ACROSS] + lean
    yaw_soft = lagged(yaw_soft, r, h.yaw_rate_filter)
    seen[REPORT_YAW, i] = yaw_soft
    seen[INS_X, i], seen[INS_Y, i], seen[INS_HEADING, i] = body[X], body[Y], body[HEADING]
    seen[INS_SPEED, i], seen[INS_ACCEL, i], seen[INS_YAW, i] = u, body[chassis.RATE], r
    return yaw_soft


@fast
def report(car, h, seen, i, noise, row):
    """What the frames of this tick say, with noise; effects of sensing act here."""
    for place in range(ROWS):
        delay_s = h.report_latency if place < INS_X else car.ins_latency_s + h.ins_latency
        row[place] = late(seen[place], i, delay_s)
    for place in range(REPORT_SPEED, WHEEL_RR + 1):
        row[place] *= h.speed_scale
    row[REPORT_YAW] = h.yaw_rate_scale * row[REPORT_YAW] + h.yaw_rate_bias
    row[ACCEL] += h.accel_bias
    row[STEER_OUT] += h.steer_report_offset
    for place in range(ROWS):
        row[place] += noise[place]


@fast
def command(who, plan, given, mind, reports, seen, k, i, row):
    """This tick's commands: recorded ones, a person's by what is felt, a controller's by what the last frames said."""
    if who.who == driver.REPLAY:
        row[:] = given.commands[k]
        return
    if who.who == driver.PERSON:
        speed, yaw = late(seen[INS_SPEED], i, who.reaction_s), late(seen[INS_YAW], i, who.reaction_s)
    else:
        speed, yaw = reports[max(k - 1, 0), REPORT_SPEED], reports[max(k - 1, 0), REPORT_YAW]
    pedal = ask_pedal(who, mind, plan.speed_mps[k], plan.pedal_frac[k], speed)
    steer = ask_steer(
        who, mind, plan.curvature_1pm[k], plan.steer_rad[k], plan.opened[k] > 0.5, plan.tremor[k], speed, yaw
    )
    as_commands(who, pedal, steer, row)
