"""Longitudinal control (eq. 2, docs/reference/apollo.md): station and speed PID in cascade, preview, open-loop map.

Deliberate differences from Apollo's controller: a pedal at rest is the vehicle's rest duty, not 0, which is also the
least duty (Apollo: 15.4 % and 14.5 %, for one car); the plan is interpolated between its rows; forward gear only, so no
neutral and no mirrored rules; no condition on the steering. The slope term is off, as in Apollo.
"""

from __future__ import annotations

from typing import NamedTuple

from tunefree_hil.base.contracts import Block
from tunefree_hil.base.course import Tracking
from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import Measurement
from tunefree_hil.control.calibration_map import CalibrationMap, lookup
from tunefree_hil.control.contract import Pedals, Recipe, Setup, chassis_speed_of, speed_of
from tunefree_hil.control.parameters import tunables_of

STATION_LIMIT_M = 2.0
SPEED_LIMIT_MPS = 2.0
SWITCH_MPS = 3.0  # low-speed gains up to here
INTEGRAL_LIMIT_MPS2 = 0.3
STANDSTILL_MPS2 = -0.3
STOPPED_ACCEL_MPS2 = 0.01  # a plan with less acceleration ...
STOPPED_SPEED_MPS = 0.2  # ... and less speed is a stop,
STOPPED_REST_M = 0.3  # and so is less remaining distance


class PidParams(NamedTuple):
    """Gains, map and pedals."""

    station_kp: float
    kp_low: float
    ki_low: float
    kp_high: float
    ki_high: float
    calibration: CalibrationMap
    rest_pedal_frac: float
    chassis_speed: float  # 0: the vehicle reports no speed, that of the INS is used


class PidState(NamedTuple):
    """The integral, already times Ki: a change of the gain set causes no jump."""

    integral_mps2: float


def make(setup: Setup) -> Block:
    """x = (Tracking, Measurement) -> Pedals."""
    values = setup.values
    params = PidParams(
        values["station.kp"],
        values["speed.kp_low"],
        values["speed.ki_low"],
        values["speed.kp_high"],
        values["speed.ki_high"],
        setup.calibration,
        setup.vehicle.rest_pedal_frac,
        chassis_speed_of(setup.absent),
    )
    return Block(init, step, params, CONTROLLER.tunables)


def init(params: PidParams, dt_s: float) -> PidState:
    return PidState(0.0)


@kernel
def step(params: PidParams, state: PidState, x: tuple[Tracking, Measurement], dt_s: float) -> tuple[PidState, Pedals]:
    """a_cmd = a_ref + K_P (e_v + K_Px e_x) + K_I integral of the same (eq. 2); u = f_map(a_cmd, v)."""
    tracking, measurement = x
    v = speed_of(measurement, params.chassis_speed)
    station_m = clamp(tracking.station_error_m, -STATION_LIMIT_M, STATION_LIMIT_M)
    error_mps = clamp(tracking.speed_error_mps + params.station_kp * station_m, -SPEED_LIMIT_MPS, SPEED_LIMIT_MPS)
    kp, ki = params.kp_high, params.ki_high
    if v <= SWITCH_MPS:
        kp, ki = params.kp_low, params.ki_low
    integral_mps2 = clamp(state.integral_mps2 + ki * error_mps * dt_s, -INTEGRAL_LIMIT_MPS2, INTEGRAL_LIMIT_MPS2)
    accel_mps2 = kp * error_mps + integral_mps2 + tracking.preview_accel_mps2
    if is_full_stop(tracking):
        integral_mps2 = 0.0
        if accel_mps2 > STANDSTILL_MPS2:
            accel_mps2 = STANDSTILL_MPS2
    return PidState(integral_mps2), actuate(params, v, accel_mps2)


@kernel
def is_full_stop(tracking: Tracking) -> bool:
    """Whether the plan is about to stop, or no distance remains (docs/reference/apollo.md)."""
    flat = abs(tracking.preview_accel_mps2) <= STOPPED_ACCEL_MPS2
    return (flat and abs(tracking.preview_speed_mps) <= STOPPED_SPEED_MPS) or (
        abs(tracking.path_remaining_m) < STOPPED_REST_M
    )


@kernel
def actuate(params: PidParams, speed_mps: float, accel_mps2: float) -> Pedals:
    """Throttle or brake by the sign of the *acceleration* (docs/reference/apollo.md): coasting drag is not used.

    An unused pedal is at rest; no pedal is below rest.
    """
    rest_frac = params.rest_pedal_frac
    command_frac = lookup(params.calibration, speed_mps, accel_mps2)
    if accel_mps2 >= 0.0:
        return Pedals(command_frac if command_frac > rest_frac else rest_frac, rest_frac, accel_mps2)
    return Pedals(rest_frac, -command_frac if -command_frac > rest_frac else rest_frac, accel_mps2)


CONTROLLER = Recipe(make, tunables_of("station.") + tunables_of("speed."))
