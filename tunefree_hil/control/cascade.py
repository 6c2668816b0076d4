"""The controller as one Block: follower, outer loops, inner loop, limits, supervision (Fig. 5 of the paper).

controller.step(params, state, Sight(tick, measurement), dt_s) -> (state, Decision); parts: contract.py.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from tunefree_hil.base.course import Tracking
from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.maths import clamp, is_finite
from tunefree_hil.base.records import GEAR_DRIVE, NAN, Command, Ins, Measurement
from tunefree_hil.control.contract import Settings, VehicleConstants, chassis_speed_of, speed_of

ERROR_DIVERGED = 1.0  # a number that is not finite, or |heading error to the path| beyond the bound
ERROR_LEFT_LANE = 2.0  # |lateral error to the original path| beyond half the lane
FIRST_FRAMES_S = 0.2  # so long a needed value may still be unheard (20 missed periods, apollo_facts 1.2)
STOP_BRAKE_FRAC = 0.5  # the shipped emergency stop (apollo_facts 1.2)


class Sight(NamedTuple):
    """What the controller gets at a tick."""

    tick: int
    measurement: Measurement


class Decision(NamedTuple):
    """What it makes of it."""

    command: Command
    tracking: Tracking
    steer_wish_rad: float  # of the lateral part, before inner loop and limits
    accel_cmd_mps2: float
    inner_status: float
    error_code: float  # 0, ERROR_DIVERGED, ERROR_LEFT_LANE


class Guard(NamedTuple):
    """Bounds of the command and of the drive."""

    throttle_limit_frac: float
    brake_limit_frac: float
    rest_pedal_frac: float
    steer_limit_rad: float
    accel_low_mps2: float
    accel_high_mps2: float
    lane_half_width_m: float
    divergence_heading_rad: float
    chassis_speed: float  # 0: the vehicle reports no speed, the INS's is used


def make_guard(vehicle: VehicleConstants, settings: Settings, absent: frozenset[str] = frozenset()) -> Guard:
    """The bounds of a vehicle and its lane."""
    return Guard(
        vehicle.throttle_limit_frac,
        vehicle.brake_limit_frac,
        vehicle.rest_pedal_frac,
        vehicle.steer_limit_rad,
        vehicle.accel_low_mps2,
        vehicle.accel_high_mps2,
        settings.lane_half_width_m,
        settings.divergence_heading_rad,
        chassis_speed_of(absent),
    )


def assemble(follower: Block, lateral: Block, longitudinal: Block, inner: Block, limits: Block, guard: Guard) -> Block:
    """One Block of the parts; x = Sight -> Decision."""
    parts = (follower, lateral, longitudinal, inner, limits)
    follow, steer, pedal, tame, limit = (part.step for part in parts)

    def init(params: Any, dt_s: float) -> Any:
        states = tuple(part.init(own, dt_s) for part, own in zip(parts, params, strict=False))
        return (*states, 0.0, 0.0)

    @kernel
    def step(params: Any, state: Any, x: Sight, dt_s: float) -> tuple[Any, Decision]:
        measurement = x.measurement
        bounds = params[5]
        early = state[6] == 0.0 and x.tick * dt_s < FIRST_FRAMES_S
        speed_mps = speed_of(measurement, bounds.chassis_speed)
        follower_state, tracking = follow(params[0], state[0], (x.tick, measurement.ins), dt_s)
        if not is_finite(tracking.path_lateral_error_m + speed_mps):
            return state, without(bounds, tracking, state[5], early, pose_sum(measurement.ins) + speed_mps)
        lateral_state, wish_rad = steer(params[1], state[1], (tracking, measurement), dt_s)
        longitudinal_state, pedals = pedal(params[2], state[2], (tracking, measurement), dt_s)
        inner_state, answer = tame(params[3], state[3], (wish_rad, measurement.report.steer_rad, speed_mps), dt_s)
        limit_state, steer_rad = limit(params[4], state[4], (answer.steer_rad, speed_mps), dt_s)
        total = steer_rad + pedals.throttle_frac + pedals.brake_frac + pedals.accel_mps2
        if not is_finite(total):
            return state, without(bounds, tracking, state[5], early, total)
        steer_rad = clamp(steer_rad, -bounds.steer_limit_rad, bounds.steer_limit_rad)
        command = Command(
            clamp(pedals.throttle_frac, 0.0, bounds.throttle_limit_frac),
            clamp(pedals.brake_frac, 0.0, bounds.brake_limit_frac),
            steer_rad,
            GEAR_DRIVE,
            clamp(pedals.accel_mps2, bounds.accel_low_mps2, bounds.accel_high_mps2),
            NAN,
        )
        code = supervise(bounds, tracking)
        decision = Decision(command, tracking, wish_rad, pedals.accel_mps2, answer.status, code)
        states = (follower_state, lateral_state, longitudinal_state, inner_state, limit_state, steer_rad, 1.0)
        return states, decision

    tunables = lateral.tunables + longitudinal.tunables + inner.tunables
    return Block(init, step, (*(part.params for part in parts), guard), tunables)


@kernel
def supervise(guard: Guard, tracking: Tracking) -> float:
    """The error code of a finite tick (design D11)."""
    if abs(tracking.path_heading_error_rad) > guard.divergence_heading_rad:
        return ERROR_DIVERGED
    if abs(tracking.path_lateral_error_m) > guard.lane_half_width_m:
        return ERROR_LEFT_LANE
    return 0.0


@kernel
def pose_sum(ins: Ins) -> float:
    """NaN where a part of the pose has not been heard, infinite where one is."""
    return ins.x_m + ins.y_m + ins.heading_rad + ins.speed_mps


@kernel
def without(guard: Guard, tracking: Tracking, steer_rad: float, early: bool, total: float) -> Decision:
    """The answer to a sum of needed numbers that is not finite. early: no tick has been complete yet.

    NaN is then a message that has not had its turn (periods and phases differ): roll on. Else it is divergence.
    """
    if early and total != total:
        rest = guard.rest_pedal_frac
        return Decision(Command(rest, rest, steer_rad, GEAR_DRIVE, 0.0, NAN), tracking, NAN, NAN, 0.0, 0.0)
    return stop(guard, tracking, steer_rad)


@kernel
def stop(guard: Guard, tracking: Tracking, steer_rad: float) -> Decision:
    """Brake, wheel held: the answer to numbers that are not finite."""
    brake_frac = clamp(STOP_BRAKE_FRAC, 0.0, guard.brake_limit_frac)
    command = Command(guard.rest_pedal_frac, brake_frac, steer_rad, GEAR_DRIVE, guard.accel_low_mps2, NAN)
    return Decision(command, tracking, NAN, NAN, 0.0, ERROR_DIVERGED)
