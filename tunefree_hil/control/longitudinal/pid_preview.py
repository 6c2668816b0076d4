"""Longitudinal control that knows its delay: preview, prediction, disturbance observer, hysteresis between the pedals.

The paper's plain form is pid.py (eq. 2); its gains, limits and stop rule are used here as they are. Five things are
added, each with a parameter of its own, 0 for off:

- `speed.preview_s`: the reference's acceleration is taken so much later, when the pedals and the driveline will have
  acted (the plain form: 0.2 s); 0 takes it now;
- `speed.predict`: feedback on the speed and station error that will be there after that time, from the feedback
  accelerations that are under way (Smith 1957);
- `speed.observer_radps`: bandwidth of an observer of what acts beside the commanded acceleration (grade, wind, drag,
  errors of the map), which is then commanded against (Ohnishi's disturbance observer). A command acts after the pedals'
  dead time and a lag, `speed.preview_s` together: that is what the whole driveline shows. Without preview: the pedals'
  own lag;
- `speed.filter_s`: time constant of an estimator of speed and station that carries both on with the acceleration of
  the INS and finds that one's bias (the slope, which an accelerometer also sees): feedback without the sensors' noise,
  and without the delay of a low-pass filter. Where the INS reports no acceleration, the commanded one is used;
- `pedals.hysteresis_mps2`: the other pedal is taken only where the map asks for it by so much acceleration; between,
  the throttle goes to rest, and the brake to the duty from which it acts: noise does not lift and press it in turns.
  The map, not the sign of the acceleration, says which pedal: coasting drag is used.

Feedback and observer move the throttle, for each m/s2, by at most SLOPE_FACTOR times the mean slope of the map at that
speed. Where a learned map is flat, beyond its data, its inverse would multiply the gain of the loop. Where the vehicle
is that weak, at its power limit, the observer finds what is missing and asks for more.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Block, Tunable
from tunefree_hil.base.course import Tracking
from tunefree_hil.base.kernel import buffer, kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import Measurement
from tunefree_hil.control.calibration_map import CalibrationMap, from_triples, lookup
from tunefree_hil.control.contract import Pedals, Recipe, Setup, chassis_speed_of, speed_of
from tunefree_hil.control.longitudinal.pid import (
    INTEGRAL_LIMIT_MPS2,
    SPEED_LIMIT_MPS,
    STANDSTILL_MPS2,
    STATION_LIMIT_M,
    SWITCH_MPS,
    is_full_stop,
)
from tunefree_hil.control.parameters import tunables_of

DISTURBANCE_LIMIT_MPS2 = 1.5  # a grade of 15 %
OBSERVER_SPEED_MPS = 0.5  # slower, brake and creep hold the vehicle and the observer would learn that
OBSERVER_FILTER_S = 0.2  # of the estimator where the feedback does without it: the observer takes its acceleration
LEAST_FILTER_S = 0.05  # a shorter time constant of the estimator is taken for this one: it stays stable at 0.01 s ticks
STATION_JUMP_M = 0.3  # a larger difference is a re-plan, not noise
SLOPE_FACTOR = 1.5  # the gain of the loop is at most so much larger: less than a usual gain margin, 2
UNBOUNDED = 1e6  # duty per m/s2; finite, as rows of a map are interpolated
THROTTLE, BRAKE = 1.0, -1.0


class PedalEdges(NamedTuple):
    """Ends of a map by speed: least and most acceleration; duty from which the brake acts, rest where it never does.

    slope_frac_s2pm: duty of the throttle per acceleration, from rest to the end. Each has one value per speed.
    """

    low_mps2: CalibrationMap
    high_mps2: CalibrationMap
    first_brake_frac: CalibrationMap
    slope_frac_s2pm: CalibrationMap


class PidPreviewParams(NamedTuple):
    """Gains, map and pedals. ticks: number of feedback accelerations under way; reach_s: the time that they cover."""

    station_kp: float
    kp_low: float
    ki_low: float
    kp_high: float
    ki_high: float
    calibration: CalibrationMap
    rest_pedal_frac: float
    ticks: int
    reach_s: float
    dead_ticks: int  # from a command to its acceleration, for the observer; then a lag
    lag_s: float
    observer_radps: float
    filter_s: float
    estimator_radps: float
    hysteresis_mps2: float
    accel_low_mps2: float
    accel_high_mps2: float
    chassis_speed: float  # 0: the vehicle reports no speed, that of the INS is used
    measured_accel: float  # 0: the INS reports no acceleration, the commanded one is used
    edges: PedalEdges


class PidPreviewState(NamedTuple):
    """Integral; feedback and total accelerations under way (rings) and the oldest one's place; estimates; pedal in use.

    speed_mps, station_m (the station error): estimated; a negative speed is none yet. bias_mps2: of the acceleration.
    acting_mps2: the commanded acceleration that acts by now.
    """

    integral_mps2: float
    feedback_mps2: Any
    feedback_place: int
    command_mps2: Any
    command_place: int
    speed_mps: float
    bias_mps2: float
    acting_mps2: float
    station_m: float
    disturbance_mps2: float
    pedal: float


def make(setup: Setup) -> Block:
    """x = (Tracking, Measurement) -> Pedals."""
    values, delays, dt_s = setup.values, setup.delays, setup.dt_s
    dead_s = delays.drive_dead_time_s + delays.bus_s
    delay_s = dead_s + delays.drive_lag_s
    ticks = round(values["speed.predict"] * delay_s / dt_s)
    rest_frac, filter_s = setup.vehicle.rest_pedal_frac, values["speed.filter_s"]
    params = PidPreviewParams(
        values["station.kp"],
        values["speed.kp_low"],
        values["speed.ki_low"],
        values["speed.kp_high"],
        values["speed.ki_high"],
        setup.calibration,
        rest_frac,
        ticks=ticks,
        reach_s=ticks * dt_s,
        dead_ticks=round(dead_s / dt_s),
        lag_s=max((values["speed.preview_s"] or delay_s) - dead_s, 0.0),
        observer_radps=values["speed.observer_radps"],
        filter_s=filter_s,
        estimator_radps=1.0 / max(filter_s or OBSERVER_FILTER_S, LEAST_FILTER_S),
        hysteresis_mps2=values["pedals.hysteresis_mps2"],
        accel_low_mps2=setup.vehicle.accel_low_mps2,
        accel_high_mps2=setup.vehicle.accel_high_mps2,
        chassis_speed=chassis_speed_of(setup.absent),
        measured_accel=0.0 if "ins.accel_mps2" in setup.absent else 1.0,
        edges=find_edges(setup.calibration, rest_frac),
    )
    return Block(init, step, params, CONTROLLER.tunables)


def find_edges(calibration: CalibrationMap, rest_frac: float) -> PedalEdges:
    """The edges of a map in the rows of its speeds."""
    speeds = [float(speed_mps) for speed_mps in calibration.speed_mps]
    zeros = [0.0] * len(speeds)
    lows, highs, brakes, slopes = [], [], [], []
    for first, end in itertools.pairwise(int(place) for place in calibration.first):
        lows.append(float(calibration.at[first]))
        highs.append(float(calibration.at[end - 1]))
        braking = [-float(frac) for frac in calibration.value[first:end] if -frac > rest_frac]
        brakes.append(min(braking, default=rest_frac))
        slopes.append(throttle_slope(calibration.at[first:end], calibration.value[first:end], rest_frac))
    return PedalEdges(*(from_triples(speeds, zeros, column) for column in (lows, highs, brakes, slopes)))


def throttle_slope(accels_mps2: Sequence[float], commands_frac: Sequence[float], rest_frac: float) -> float:
    """Mean slope of a row of a map, ascending: duty of the throttle per acceleration; UNBOUNDED without a throttle."""
    pressed = [(float(a), float(u)) for a, u in zip(accels_mps2, commands_frac, strict=True) if u >= rest_frac]
    if len(pressed) < 2 or pressed[-1][0] <= pressed[0][0] or pressed[-1][1] <= pressed[0][1]:
        return UNBOUNDED
    return (pressed[-1][1] - pressed[0][1]) / (pressed[-1][0] - pressed[0][0])


def init(params: PidPreviewParams, dt_s: float) -> PidPreviewState:
    """Nothing under way, no disturbance, on the throttle."""
    feedback, command = buffer(max(params.ticks, 1)), buffer(max(params.dead_ticks, 1))
    return PidPreviewState(0.0, feedback, 0, command, 0, -1.0, 0.0, 0.0, 0.0, 0.0, THROTTLE)


@kernel
def step(
    params: PidPreviewParams, state: PidPreviewState, x: tuple[Tracking, Measurement], dt_s: float
) -> tuple[PidPreviewState, Pedals]:
    """a_cmd = a_ref later + K_P (e_v + K_Px e_x) predicted + integral - disturbance; u = f_map(a_cmd, v)."""
    tracking, measurement = x
    v = speed_of(measurement, params.chassis_speed)
    share = dt_s / (params.lag_s + dt_s)  # not 0: dt_s is above 0
    acting_mps2 = state.acting_mps2 + share * (float(state.command_mps2[state.command_place]) - state.acting_mps2)
    speed_mps, bias_mps2, seen_mps2 = estimate(params, state, measurement, acting_mps2, dt_s)
    disturbance_mps2 = observe(params, state, measurement.ins.speed_mps, seen_mps2 - acting_mps2, dt_s)
    now_mps, now_m = feedback_errors(params, state, tracking, measurement.ins.speed_mps - speed_mps, dt_s)
    error_mps = demanded_mps(params, state, now_mps, now_m, dt_s)
    kp, ki = (params.kp_low, params.ki_low) if v <= SWITCH_MPS else (params.kp_high, params.ki_high)
    integral_mps2 = clamp(state.integral_mps2 + ki * error_mps * dt_s, -INTEGRAL_LIMIT_MPS2, INTEGRAL_LIMIT_MPS2)
    feedback_mps2 = kp * error_mps + integral_mps2
    accel_mps2 = feedback_mps2 + tracking.preview_accel_mps2 - disturbance_mps2
    stopping = is_full_stop(tracking)
    if stopping:
        integral_mps2, feedback_mps2 = 0.0, 0.0
        accel_mps2 = min(accel_mps2, STANDSTILL_MPS2)
    accel_mps2 = clamp(accel_mps2, params.accel_low_mps2, params.accel_high_mps2)
    planned_mps2 = clamp(tracking.preview_accel_mps2, params.accel_low_mps2, params.accel_high_mps2)
    pedal, pedals = choose_pedal(params, state.pedal, v, (accel_mps2, planned_mps2), stopping)
    feedback_place = put(state.feedback_mps2, state.feedback_place, feedback_mps2)
    possible_mps2 = clamp(accel_mps2, lookup(params.edges.low_mps2, v, 0.0), lookup(params.edges.high_mps2, v, 0.0))
    command_place = put(state.command_mps2, state.command_place, possible_mps2)
    new_state = PidPreviewState(
        integral_mps2,
        state.feedback_mps2,
        feedback_place,
        state.command_mps2,
        command_place,
        speed_mps,
        bias_mps2,
        acting_mps2,
        now_m,
        disturbance_mps2,
        pedal,
    )
    return new_state, pedals


@kernel
def demanded_mps(params: PidPreviewParams, state: PidPreviewState, now_mps: float, now_m: float, dt_s: float) -> float:
    """The speed that is demanded for speed and station error, as they will be when what is under way has acted."""
    later_mps = now_mps - under_way_mps(params, state, dt_s)
    later_m = now_m + params.reach_s * 0.5 * (now_mps + later_mps)
    station_m = clamp(later_m, -STATION_LIMIT_M, STATION_LIMIT_M)
    return clamp(later_mps + params.station_kp * station_m, -SPEED_LIMIT_MPS, SPEED_LIMIT_MPS)


@kernel
def put(ring: Any, place: int, value: float) -> int:
    """Overwrite the oldest value of a ring; the place of the next oldest."""
    ring[place] = value
    place += 1
    return 0 if place == len(ring) else place


@kernel
def under_way_mps(params: PidPreviewParams, state: PidPreviewState, dt_s: float) -> float:
    """Speed that the vehicle will gain on the reference by the feedback accelerations which have not acted yet."""
    if params.ticks == 0:
        return 0.0
    total = 0.0
    for i in range(params.ticks):
        total += state.feedback_mps2[i]
    return total * dt_s


@kernel
def estimate(
    params: PidPreviewParams, state: PidPreviewState, measurement: Measurement, acting_mps2: float, dt_s: float
) -> tuple[float, float, float]:
    """(speed, bias of the acceleration, acceleration without it): v' = a + b + 2 w (v - v^), b' = w^2 (v - v^)."""
    measured_mps = measurement.ins.speed_mps
    accel_mps2 = acting_mps2 + state.disturbance_mps2
    if params.measured_accel != 0.0:
        accel_mps2 = measurement.ins.accel_mps2
    elif measured_mps < OBSERVER_SPEED_MPS:
        accel_mps2 = 0.0
    accel_mps2 += state.bias_mps2
    if state.speed_mps < 0.0:
        return (measured_mps if measured_mps > 0.0 else 0.0), 0.0, accel_mps2
    speed_mps = state.speed_mps + dt_s * accel_mps2
    error_mps = measured_mps - speed_mps
    w = params.estimator_radps
    speed_mps += dt_s * 2.0 * w * error_mps
    return (speed_mps if speed_mps > 0.0 else 0.0), state.bias_mps2 + dt_s * w * w * error_mps, accel_mps2


@kernel
def observe(
    params: PidPreviewParams, state: PidPreviewState, measured_mps: float, unexplained_mps2: float, dt_s: float
) -> float:
    """The disturbance: d' = w (acceleration that is seen - command of that time ago - d)."""
    if params.observer_radps == 0.0 or state.speed_mps < 0.0 or measured_mps < OBSERVER_SPEED_MPS:
        return state.disturbance_mps2
    change_mps2 = dt_s * params.observer_radps * (unexplained_mps2 - state.disturbance_mps2)
    return clamp(state.disturbance_mps2 + change_mps2, -DISTURBANCE_LIMIT_MPS2, DISTURBANCE_LIMIT_MPS2)


@kernel
def feedback_errors(
    params: PidPreviewParams, state: PidPreviewState, tracking: Tracking, noise_mps: float, dt_s: float
) -> tuple[float, float]:
    """(speed error, station error) by the estimates; noise_mps: measured less estimated speed."""
    if params.filter_s == 0.0:
        return tracking.speed_error_mps, tracking.station_error_m
    speed_error_mps = tracking.speed_error_mps + noise_mps
    station_m = state.station_m + dt_s * speed_error_mps
    apart_m = tracking.station_error_m - station_m
    if state.speed_mps < 0.0 or abs(apart_m) > STATION_JUMP_M:
        return speed_error_mps, tracking.station_error_m
    return speed_error_mps, station_m + dt_s * params.estimator_radps * apart_m


@kernel
def choose_pedal(
    params: PidPreviewParams, pedal: float, speed_mps: float, accels: tuple[float, float], stopping: bool
) -> tuple[float, Pedals]:
    """(pedal in use, commands): the other one where the map asks for it by the hysteresis, else the same, or its edge.

    Stopping takes the brake: no throttle holds a vehicle at its stop. accels: demanded in all, and by the plan alone.
    """
    accel_mps2, planned_mps2 = accels
    rest_frac = params.rest_pedal_frac
    if stopping:
        pedal = BRAKE
    elif pedal == THROTTLE:
        if lookup(params.calibration, speed_mps, accel_mps2 + params.hysteresis_mps2) < -rest_frac:
            pedal = BRAKE
    elif lookup(params.calibration, speed_mps, accel_mps2 - params.hysteresis_mps2) > rest_frac:
        pedal = THROTTLE
    command_frac = lookup(params.calibration, speed_mps, accel_mps2)
    if pedal == THROTTLE:
        planned_frac = max(lookup(params.calibration, speed_mps, planned_mps2), rest_frac)
        slope = SLOPE_FACTOR * lookup(params.edges.slope_frac_s2pm, speed_mps, 0.0)
        reach_frac = slope * abs(accel_mps2 - planned_mps2)
        command_frac = clamp(command_frac, planned_frac - reach_frac, planned_frac + reach_frac)
        return pedal, Pedals(command_frac if command_frac > rest_frac else rest_frac, rest_frac, accel_mps2)
    least_frac = rest_frac
    if params.hysteresis_mps2 > 0.0:
        least_frac = lookup(params.edges.first_brake_frac, speed_mps, 0.0)
    return pedal, Pedals(rest_frac, -command_frac if -command_frac > least_frac else least_frac, accel_mps2)


OWN = (
    Tunable("speed.preview_s", "s", 0.0, 0.5, "linear"),
    Tunable("speed.predict", "1", 0.0, 2.0, "linear"),
    Tunable("speed.observer_radps", "rad/s", 0.0, 2.0, "linear"),
    Tunable("pedals.hysteresis_mps2", "m/s2", 0.0, 0.4, "linear"),
    Tunable("speed.filter_s", "s", 0.0, 0.4, "linear"),
)
CONTROLLER = Recipe(make, tunables_of("station.") + tunables_of("speed.") + OWN)
