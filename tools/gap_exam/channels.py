"""The by-wire channels and what lies behind them: command -> reported output -> what the car feels, steps of 1 ms.

Place A of an effect is before the reported output, place B behind it (docs/reference/effects.md). Pedals count above
their rest.
"""

from __future__ import annotations

from tools.gap_exam.fast import fast
from tools.gap_exam.signals import (
    STEP_S,
    held_rate,
    lagged,
    late,
    oscillator,
    stuck,
    with_play,
    within,
    without_band,
)

# Memory of the channels
STEER_FREE, STEER_PLACE, STEER_RATE, STEER_SOFT, STEER_OUT, STEER_PLAY = range(6)
THROTTLE_PLACE, THROTTLE_SOFT, THROTTLE_OUT, DRIVE_SOFT, SHUFFLE, SHUFFLE_RATE, DRIVEN_J, HOLE_LEFT_S, GEAR = range(
    6, 15
)
BRAKE_PLACE, BRAKE_OUT, BRAKE_SOFT, BRAKED_J, ANGLE, ABS_S = range(15, 21)
ROLL, ROLL_RATE = 21, 22
SIZE = 23
LEAST_FADED = 0.3
GEARS = (1.0, 1.9, 3.1, 4.6)  # upper ends of the gears, in those of the first


@fast
def steer_output(car, h, m, told, i):
    """The steering wheel's angle as the actuator puts it out."""
    extra_s = min(h.command_delay * abs(told[i]), 0.6)
    asked = without_band(late(told, i, car.steer_dead_s + h.steer_dead_time + extra_s), h.steer_dead_band)
    m[STEER_FREE] = stuck(m[STEER_FREE], asked, h.steer_friction)
    place, rate = oscillator(m[STEER_PLACE], m[STEER_RATE], m[STEER_FREE], car.steer_hz, car.steer_damping)
    most = car.steer_rate_radps
    if abs(rate) > most:
        rate = within(rate, most)
        place = m[STEER_PLACE] + STEP_S * rate
    m[STEER_PLACE], m[STEER_RATE] = place, rate
    m[STEER_SOFT] = lagged(m[STEER_SOFT], place, h.steer_lag)
    m[STEER_OUT] = held_rate(m[STEER_OUT], within(m[STEER_SOFT], h.steer_saturation), h.steer_rate_limit)
    return m[STEER_OUT]


@fast
def road_wheel(car, h, m, speed):
    """The front wheels' angle that the reported steering angle makes."""
    m[STEER_PLAY] = with_play(m[STEER_PLAY], m[STEER_OUT], 0.5 * h.steer_backlash)
    felt = h.steer_gain * m[STEER_PLAY] + h.steer_offset
    if h.speed_ratio != 0.0:
        felt = felt * (1.0 + h.speed_ratio * (speed - 8.0))
    m[ANGLE] = felt / car.steer_ratio
    return m[ANGLE]


@fast
def throttle_output(car, h, m, told, i):
    """The throttle's duty above rest as the actuator puts it out."""
    asked = late(told, i, car.throttle_dead_s + h.throttle_dead_time)
    m[THROTTLE_PLACE] = lagged(m[THROTTLE_PLACE], asked, car.throttle_lag_s)
    m[THROTTLE_SOFT] = lagged(m[THROTTLE_SOFT], m[THROTTLE_PLACE], h.throttle_lag)
    m[THROTTLE_OUT] = held_rate(m[THROTTLE_OUT], m[THROTTLE_SOFT], h.throttle_rate_limit)
    return m[THROTTLE_OUT]


@fast
def brake_output(car, h, m, told, i):
    """The brake's duty above rest as the actuator puts it out."""
    asked = late(told, i, car.brake_dead_s + h.brake_dead_time)
    m[BRAKE_PLACE] = lagged(m[BRAKE_PLACE], asked, car.brake_lag_s)
    m[BRAKE_OUT] = lagged(m[BRAKE_OUT], m[BRAKE_PLACE], h.brake_lag)
    return m[BRAKE_OUT]


@fast
def drive_law_n(car, over_rest, speed):
    """Driving force of a throttle duty above rest: bends, is limited by the power, and steps with the gears."""
    share = (over_rest - car.throttle_zero) / (car.throttle_full - car.throttle_zero)
    if share <= 0.0:
        return 0.0
    share = min(share, 1.0)
    force_n = car.drive_n * (1.0 + car.drive_bend) * share / (share + car.drive_bend)
    power_w = car.drive_w * share**car.power_bend
    force_n = force_n / (1.0 + (force_n * speed / power_w) ** car.power_edge) ** (1.0 / car.power_edge)
    if car.gear_ripple > 0.0:
        lower = 0.0
        for end in GEARS:
            upper = end * car.gear_mps
            if speed < upper:
                force_n = force_n * (1.0 + car.gear_ripple * (1.0 - 2.0 * (speed - lower) / (upper - lower)))
                break
            lower = upper
    return force_n


@fast
def drive_n(car, h, m, speed):
    """All that pushes the car: engine behind its effects, and creep."""
    over = h.throttle_gain * max(without_band(m[THROTTLE_OUT], h.throttle_dead_band), 0.0)
    m[DRIVE_SOFT] = lagged(m[DRIVE_SOFT], drive_law_n(car, over, speed), h.powertrain_lag)
    force_n = m[DRIVE_SOFT]
    if h.driveline_shuffle > 0.0:
        m[SHUFFLE], m[SHUFFLE_RATE] = oscillator(
            m[SHUFFLE], m[SHUFFLE_RATE], force_n, h.driveline_shuffle_natural_hz, 0.05
        )
        force_n = force_n + h.driveline_shuffle * (m[SHUFFLE] - force_n)
    if h.shift_hole > 0.0:
        force_n = force_n * (1.0 - h.shift_hole * in_hole(car, h, m, speed, over))
    if h.heat_derating > 0.0:
        hot_mj = max(1e-6 * m[DRIVEN_J] - h.heat_derating_free_mj, 0.0)
        force_n = force_n * max(1.0 - h.heat_derating * hot_mj, LEAST_FADED)
    if force_n * speed > h.power_limit:
        force_n = h.power_limit / speed
    m[DRIVEN_J] += max(force_n, 0.0) * speed * STEP_S
    return force_n + car.creep_n * max(1.0 - speed / car.creep_mps, 0.0)


@fast
def in_hole(car, h, m, speed, over):
    """1 while a gear is being changed under load, else 0."""
    gear = 0.0
    for end in GEARS:
        if speed > end * car.gear_mps * (0.85 if gear < m[GEAR] else 1.0):
            gear += 1.0
    if gear != m[GEAR]:
        m[GEAR] = gear
        m[HOLE_LEFT_S] = h.shift_hole_hole_s
    m[HOLE_LEFT_S] = max(m[HOLE_LEFT_S] - STEP_S, 0.0)
    return 1.0 if m[HOLE_LEFT_S] > 0.0 and over > 0.01 else 0.0


@fast
def brake_n(car, h, m, speed, mass_kg):
    """What the brakes hold against the motion; their heat counts without what drags."""
    over = max(without_band(max(m[BRAKE_OUT], 0.0), h.brake_dead_band), 0.0)
    m[BRAKE_SOFT] = lagged(m[BRAKE_SOFT], h.brake_gain * over, h.brake_pressure_lag)
    pressed = m[BRAKE_SOFT]
    force_n = car.brake_n * pressed * (1.0 + car.brake_rise * pressed)
    force_n = force_n * max(1.0 - h.brake_fade * 1e-6 * m[BRAKED_J], LEAST_FADED)
    if h.abs_cycling > 0.0 and force_n > 1.6 * mass_kg and speed > 2.0:
        m[ABS_S] += STEP_S
        if (m[ABS_S] * h.abs_cycling_cycle_hz) % 1.0 < 0.5:
            force_n = force_n * (1.0 - h.abs_cycling)
    m[BRAKED_J] += force_n * speed * STEP_S
    return force_n + h.brake_drag


@fast
def roll_steer(h, m, across_mps2):
    """The front wheels' angle by the body's lean out of a turn; the accelerometer feels the lean, too (`sense`)."""
    if h.body_roll <= 0.0:
        return 0.0
    m[ROLL], m[ROLL_RATE] = oscillator(m[ROLL], m[ROLL_RATE], h.body_roll * across_mps2, h.body_roll_natural_hz, 0.12)
    return -0.12 * m[ROLL]
