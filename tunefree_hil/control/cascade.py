"""The controller as one Block: follower, outer loops, inner loop, limits, supervision (paper, Fig. 5).

`controller.step(params, state, ControllerInput(tick, measurement), dt_s) -> (state, Decision)`; the parts: contract.py.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from tunefree_hil.base.course import Tracking
from tunefree_hil.base.kernel import Block, kernel
from tunefree_hil.base.maths import clamp, is_finite
from tunefree_hil.base.records import GEAR_DRIVE, NAN, Command, Ins, Measurement
from tunefree_hil.control.contract import Pedals, Settings, VehicleConstants, chassis_speed_of, speed_of

ERROR_DIVERGED = 1.0  # a number is not finite, or |heading error to the path| exceeds its bound
ERROR_LEFT_LANE = 2.0  # |lateral error to the original path| exceeds half the lane
ERROR_NO_SOLUTION = 14.0  # a part that optimises was without a solution for too long
FIRST_FRAMES_S = 0.2  # longest time without a needed value (Apollo: 20 missed periods of 10 ms)
STOP_BRAKE_FRAC = 0.5  # brake duty of an emergency stop, as Apollo ships it


class ControllerInput(NamedTuple):
    """Input of the controller at a tick."""

    tick: int
    measurement: Measurement


class Decision(NamedTuple):
    """Output of the controller at a tick."""

    command: Command
    tracking: Tracking
    steer_demand_rad: float  # of the lateral part, before inner loop and limits
    accel_cmd_mps2: float
    inner_status: float
    error_code: float  # 0, ERROR_DIVERGED, ERROR_LEFT_LANE, ERROR_NO_SOLUTION


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
    chassis_speed: float  # 1, or 0 where the vehicle reports no speed and that of the INS is used


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


class CascadeParams(NamedTuple):
    """Parameters of each part, and the bounds of the drive. The types depend on the bench."""

    follower: Any
    lateral: Any
    longitudinal: Any
    inner: Any
    limits: Any
    guard: Guard


class CascadeState(NamedTuple):
    """State of each part, and values of the last complete tick."""

    follower: Any
    lateral: Any
    longitudinal: Any
    inner: Any
    limits: Any
    last_steer_rad: float
    has_completed_tick: bool


def assemble(follower: Block, lateral: Block, longitudinal: Block, inner: Block, limits: Block, guard: Guard) -> Block:
    """Connect the parts to one Block.

    Returns:
        The Block with x = ControllerInput, y = Decision, params CascadeParams, state CascadeState.
    """
    follower_step, lateral_step, longitudinal_step = follower.step, lateral.step, longitudinal.step
    inner_step, limit_step = inner.step, limits.step

    def init(params: CascadeParams, dt_s: float) -> CascadeState:
        return CascadeState(
            follower.init(params.follower, dt_s),
            lateral.init(params.lateral, dt_s),
            longitudinal.init(params.longitudinal, dt_s),
            inner.init(params.inner, dt_s),
            limits.init(params.limits, dt_s),
            last_steer_rad=0.0,
            has_completed_tick=False,
        )

    @kernel
    def step(
        params: CascadeParams, state: CascadeState, x: ControllerInput, dt_s: float
    ) -> tuple[CascadeState, Decision]:
        measurement, guard = x.measurement, params.guard
        is_start = not state.has_completed_tick and x.tick * dt_s < FIRST_FRAMES_S
        speed_mps = speed_of(measurement, guard.chassis_speed)
        follower_state, tracking = follower_step(params.follower, state.follower, (x.tick, measurement.ins), dt_s)
        if not is_finite(tracking.path_lateral_error_m + speed_mps):
            total = pose_sum(measurement.ins) + speed_mps
            return state, incomplete_decision(guard, tracking, state.last_steer_rad, is_start, total)
        lateral_state, demand_rad = lateral_step(params.lateral, state.lateral, (tracking, measurement), dt_s)
        longitudinal_state, pedals = longitudinal_step(
            params.longitudinal, state.longitudinal, (tracking, measurement), dt_s
        )
        inner_input = (demand_rad, measurement.report.steer_rad, speed_mps)
        inner_state, answer = inner_step(params.inner, state.inner, inner_input, dt_s)
        limit_state, steer_rad = limit_step(params.limits, state.limits, (answer.steer_rad, speed_mps), dt_s)
        total = steer_rad + pedals.throttle_frac + pedals.brake_frac + pedals.accel_mps2
        if not is_finite(total):
            return state, incomplete_decision(guard, tracking, state.last_steer_rad, is_start, total)
        command = limit_command(guard, pedals, steer_rad)
        code = supervise(guard, tracking)
        decision = Decision(command, tracking, demand_rad, pedals.accel_mps2, answer.status, code)
        new_state = CascadeState(
            follower_state, lateral_state, longitudinal_state, inner_state, limit_state, command.steer_rad, True
        )
        return new_state, decision

    params = CascadeParams(follower.params, lateral.params, longitudinal.params, inner.params, limits.params, guard)
    return Block(init, step, params, lateral.tunables + longitudinal.tunables + inner.tunables)


def with_failure_stop(block: Block, has_failed: Callable[[CascadeParams, CascadeState], bool]) -> Block:
    """The controller that also stops the vehicle, with ERROR_NO_SOLUTION, when a part of it has failed.

    Not a kernel: parts that can fail are not compiled.
    """

    def step(
        params: CascadeParams, state: CascadeState, x: ControllerInput, dt_s: float
    ) -> tuple[CascadeState, Decision]:
        new_state, decision = block.step(params, state, x, dt_s)
        if decision.error_code == 0.0 and has_failed(params, new_state):
            stopped = stop(params.guard, decision.tracking, state.last_steer_rad)
            return new_state, stopped._replace(error_code=ERROR_NO_SOLUTION)
        return new_state, decision

    return block._replace(step=step)


@kernel
def limit_command(guard: Guard, pedals: Pedals, steer_rad: float) -> Command:
    """The command within the vehicle's limits."""
    return Command(
        clamp(pedals.throttle_frac, 0.0, guard.throttle_limit_frac),
        clamp(pedals.brake_frac, 0.0, guard.brake_limit_frac),
        clamp(steer_rad, -guard.steer_limit_rad, guard.steer_limit_rad),
        GEAR_DRIVE,
        clamp(pedals.accel_mps2, guard.accel_low_mps2, guard.accel_high_mps2),
        NAN,
    )


@kernel
def supervise(guard: Guard, tracking: Tracking) -> float:
    """The error code of a finite tick: 0, ERROR_DIVERGED or ERROR_LEFT_LANE (docs/reference/grading.md)."""
    if abs(tracking.path_heading_error_rad) > guard.divergence_heading_rad:
        return ERROR_DIVERGED
    if abs(tracking.path_lateral_error_m) > guard.lane_half_width_m:
        return ERROR_LEFT_LANE
    return 0.0


@kernel
def pose_sum(ins: Ins) -> float:
    """The sum of the pose and the speed: NaN where one was not received yet."""
    return ins.x_m + ins.y_m + ins.heading_rad + ins.speed_mps


@kernel
def incomplete_decision(guard: Guard, tracking: Tracking, steer_rad: float, is_start: bool, total: float) -> Decision:
    """The decision where a needed number is not finite.

    Before the first complete tick a NaN is a message that was not yet due (periods and phases differ): the vehicle
    rolls on. Otherwise it is divergence, and the vehicle is stopped.

    Args:
        steer_rad: the last steering command.
        is_start: no tick has been complete yet, and the first frames may still be missing.
        total: the sum of the needed numbers, which is not finite.
    """
    if is_start and total != total:
        rest = guard.rest_pedal_frac
        return Decision(Command(rest, rest, steer_rad, GEAR_DRIVE, 0.0, NAN), tracking, NAN, NAN, 0.0, 0.0)
    return stop(guard, tracking, steer_rad)


@kernel
def stop(guard: Guard, tracking: Tracking, steer_rad: float) -> Decision:
    """Brake with the steering wheel held."""
    brake_frac = clamp(STOP_BRAKE_FRAC, 0.0, guard.brake_limit_frac)
    command = Command(guard.rest_pedal_frac, brake_frac, steer_rad, GEAR_DRIVE, guard.accel_low_mps2, NAN)
    return Decision(command, tracking, NAN, NAN, 0.0, ERROR_DIVERGED)
