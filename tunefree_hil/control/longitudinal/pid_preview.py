"""Longitudinal control that knows its delay: preview, prediction, disturbance observer, hysteresis between the pedals.

The paper's plain form is pid.py (eq. 2); its gains, limits and stop rule are used here as they are. Four things are
added, each with a parameter of its own, 0 for off:

- `speed.preview_s`: the reference's acceleration is taken so much later, when the pedals and the driveline will have
  acted (the plain form: 0.2 s); 0 takes it now;
- `speed.predict`: feedback on the speed and station error that will be there after that time, from the feedback
  accelerations that are under way (Smith 1957);
- `speed.observer_radps`: bandwidth of an observer of what acts beside the commanded acceleration (grade, wind, drag,
  errors of the map), which is then commanded against (Ohnishi's disturbance observer; Luenberger form, double pole);
- `pedals.hysteresis_mps2`: the other pedal is taken only where the map asks for it by so much acceleration; between,
  the pedal in use goes to rest. The map, not the sign of the acceleration, says which pedal: coasting drag is used.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Block, Tunable
from tunefree_hil.base.course import Tracking
from tunefree_hil.base.kernel import buffer, kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import Measurement
from tunefree_hil.control.calibration_map import CalibrationMap, lookup
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
THROTTLE, BRAKE = 1.0, -1.0


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
    delay_ticks: int  # from a command to its acceleration, for the observer
    observer_radps: float
    hysteresis_mps2: float
    accel_low_mps2: float
    accel_high_mps2: float
    chassis_speed: float  # 0: the vehicle reports no speed, that of the INS is used


class PidPreviewState(NamedTuple):
    """Integral; feedback and total accelerations under way (rings) with the oldest one's place; observer; pedal in use.

    speed_mps, disturbance_mps2: of the observer; a negative speed is none yet.
    """

    integral_mps2: float
    feedback_mps2: Any
    feedback_place: int
    command_mps2: Any
    command_place: int
    speed_mps: float
    disturbance_mps2: float
    pedal: float


def make(setup: Setup) -> Block:
    """x = (Tracking, Measurement) -> Pedals."""
    values, delays, dt_s = setup.values, setup.delays, setup.dt_s
    delay_s = delays.drive_dead_time_s + delays.drive_lag_s + delays.bus_s
    ticks = round(values["speed.predict"] * delay_s / dt_s)
    params = PidPreviewParams(
        values["station.kp"],
        values["speed.kp_low"],
        values["speed.ki_low"],
        values["speed.kp_high"],
        values["speed.ki_high"],
        setup.calibration,
        setup.vehicle.rest_pedal_frac,
        ticks=ticks,
        reach_s=ticks * dt_s,
        delay_ticks=round(delay_s / dt_s),
        observer_radps=values["speed.observer_radps"],
        hysteresis_mps2=values["pedals.hysteresis_mps2"],
        accel_low_mps2=setup.vehicle.accel_low_mps2,
        accel_high_mps2=setup.vehicle.accel_high_mps2,
        chassis_speed=chassis_speed_of(setup.absent),
    )
    return Block(init, step, params, CONTROLLER.tunables)


def init(params: PidPreviewParams, dt_s: float) -> PidPreviewState:
    """Nothing under way, no disturbance, on the throttle."""
    feedback, command = buffer(max(params.ticks, 1)), buffer(max(params.delay_ticks, 1))
    return PidPreviewState(0.0, feedback, 0, command, 0, -1.0, 0.0, THROTTLE)


@kernel
def step(
    params: PidPreviewParams, state: PidPreviewState, x: tuple[Tracking, Measurement], dt_s: float
) -> tuple[PidPreviewState, Pedals]:
    """a_cmd = a_ref later + K_P (e_v + K_Px e_x) predicted + integral - disturbance; u = f_map(a_cmd, v)."""
    tracking, measurement = x
    v = speed_of(measurement, params.chassis_speed)
    speed_mps, disturbance_mps2 = observe(params, state, measurement.ins.speed_mps, dt_s)
    gained_mps = under_way_mps(params, state, dt_s)
    later_mps = tracking.speed_error_mps - gained_mps
    later_m = tracking.station_error_m + params.reach_s * 0.5 * (tracking.speed_error_mps + later_mps)
    station_m = clamp(later_m, -STATION_LIMIT_M, STATION_LIMIT_M)
    error_mps = clamp(later_mps + params.station_kp * station_m, -SPEED_LIMIT_MPS, SPEED_LIMIT_MPS)
    kp, ki = params.kp_high, params.ki_high
    if v <= SWITCH_MPS:
        kp, ki = params.kp_low, params.ki_low
    integral_mps2 = clamp(state.integral_mps2 + ki * error_mps * dt_s, -INTEGRAL_LIMIT_MPS2, INTEGRAL_LIMIT_MPS2)
    feedback_mps2 = kp * error_mps + integral_mps2
    accel_mps2 = feedback_mps2 + tracking.preview_accel_mps2 - disturbance_mps2
    stopping = is_full_stop(tracking)
    if stopping:
        integral_mps2, feedback_mps2 = 0.0, 0.0
        if accel_mps2 > STANDSTILL_MPS2:
            accel_mps2 = STANDSTILL_MPS2
    accel_mps2 = clamp(accel_mps2, params.accel_low_mps2, params.accel_high_mps2)
    pedal, pedals = choose_pedal(params, state.pedal, v, accel_mps2, stopping)
    feedback_place = put(state.feedback_mps2, state.feedback_place, feedback_mps2)
    command_place = put(state.command_mps2, state.command_place, accel_mps2)
    new_state = PidPreviewState(
        integral_mps2,
        state.feedback_mps2,
        feedback_place,
        state.command_mps2,
        command_place,
        speed_mps,
        disturbance_mps2,
        pedal,
    )
    return new_state, pedals


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
def observe(params: PidPreviewParams, state: PidPreviewState, measured_mps: float, dt_s: float) -> tuple[float, float]:
    """(speed, disturbance) of the observer: v' = command after its delay + d + 2 w (v - v^), d' = w^2 (v - v^)."""
    if params.observer_radps == 0.0 or state.speed_mps < 0.0 or measured_mps < OBSERVER_SPEED_MPS:
        return measured_mps, state.disturbance_mps2
    acting_mps2 = float(state.command_mps2[state.command_place])
    error_mps = measured_mps - state.speed_mps
    w = params.observer_radps
    disturbance_mps2 = clamp(
        state.disturbance_mps2 + dt_s * w * w * error_mps, -DISTURBANCE_LIMIT_MPS2, DISTURBANCE_LIMIT_MPS2
    )
    return state.speed_mps + dt_s * (acting_mps2 + disturbance_mps2 + 2.0 * w * error_mps), disturbance_mps2


@kernel
def choose_pedal(
    params: PidPreviewParams, pedal: float, speed_mps: float, accel_mps2: float, stopping: bool
) -> tuple[float, Pedals]:
    """(pedal in use, commands): the other one where the map asks for it by the hysteresis, else the same, or rest.

    Stopping takes the brake: no throttle holds a vehicle at its stop.
    """
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
        return pedal, Pedals(command_frac if command_frac > rest_frac else rest_frac, rest_frac, accel_mps2)
    return pedal, Pedals(rest_frac, -command_frac if -command_frac > rest_frac else rest_frac, accel_mps2)


OWN = (
    Tunable("speed.preview_s", "s", 0.0, 0.5, "linear"),
    Tunable("speed.predict", "1", 0.0, 2.0, "linear"),
    Tunable("speed.observer_radps", "rad/s", 0.0, 2.0, "linear"),
    Tunable("pedals.hysteresis_mps2", "m/s2", 0.0, 0.3, "linear"),
)
CONTROLLER = Recipe(make, tunables_of("station.") + tunables_of("speed.") + OWN)
