"""The planner: a Block that drives the missing cells, in the place of a path-following controller.

    START ─> GENTLE ─> APPROACH ─> HOLD ─> (next cell) ... STOP ─> STAND, end of the drive
               └──────────┴── no room ahead ──> TURN ──┘

A drive begins with its gentle stretches (gentle_driving.py), then drives cells.

step(params, state, ControllerInput, dt_s) -> (state, PlannerOutput) is a pure function of tick, measurement and state.
The planner stays inside the envelope by using shares of it, and inside the area by turning back while reaction, braking
and turning still fit into the distance ahead.
"""

from __future__ import annotations

from tunefree_hil.base.kernel import Block
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import GEAR_DRIVE, NAN, Command, Ins
from tunefree_hil.collect import gentle_driving, steering
from tunefree_hil.collect.area import DrivingArea, Pose, farthest_corner, is_circle_inside, room_m
from tunefree_hil.collect.cells import (
    FIRST_THROTTLE,
    NO_CELL,
    STRAIGHT,
    CellCounter,
    CellIndex,
    CellSignals,
    cell_number,
    classify_cell,
)
from tunefree_hil.collect.envelope import HARD_SHARE, curvature_1pm, turn_advance_m, turn_back_room_m, turning_speed_mps
from tunefree_hil.collect.excitation_signals import WAVE_KINDS, excitation_wave
from tunefree_hil.collect.features import (
    APPROACH,
    GENTLE,
    HOLD,
    STAND,
    START,
    STOP,
    TURN,
    PlannerOutput,
    PlannerParams,
    PlannerState,
    PlannerTick,
    read_signals,
)
from tunefree_hil.collect.next_cell import choose_cell, entry_speeds_mps
from tunefree_hil.collect.pedals import (
    BRAKE_HARD,
    HOLD_PUSH,
    PedalState,
    cell_push,
    pedal_duties,
    push_for_acceleration,
    push_limits,
    update_acceleration,
    update_push_caps,
)
from tunefree_hil.control.cascade import ControllerInput

ENDED = 11.0  # bench_channel.ErrorCode.STOPPED: at standstill, nothing more to drive
INITIAL_BRAKE_S, INITIAL_COAST_S = 1.0, 2.5  # a drive begins with the brake, then with both pedals released
STAND_S = 1.0
STANDING_MPS = 0.05
MAX_HOLD_S = 12.0
MAX_APPROACH_S = 25.0
STOP_MPS2 = 1.5
FACING_RAD = 0.12  # heading error at which a turn ends
EARLY_MPS = 2.0  # excess over the turning speed at which a turn only brakes
NARROW_MPS = 3.0  # turning speed near the border
APPROACH_SHARE = 0.95  # share of the acceleration limit
MAX_MISSING_S = 0.2  # time after the start until a missing signal leads to braking


def make_planner(params: PlannerParams) -> Block:
    """Block of the planner."""
    return Block(init, step, params)


def init(params: PlannerParams, dt_s: float) -> PlannerState:
    rest = params.envelope.rest_frac
    command = Command(rest, rest, 0.0, GEAR_DRIVE, 0.0, NAN)
    return PlannerState(CellCounter(params.need, params.have), params.area, command, hold_count=params.first_hold)


def step(p: PlannerParams, s: PlannerState, x: ControllerInput, dt_s: float) -> tuple[PlannerState, PlannerOutput]:
    """One tick."""
    ins = x.measurement.ins
    signals = read_signals(p.sources, x.measurement, s.command)
    total = ins.x_m + ins.y_m + ins.heading_rad + signals.speed_mps + signals.steer_rad
    if total - total != 0.0:
        return _command_without_signals(p, s, x.tick * dt_s >= MAX_MISSING_S)
    s.counter.count_frame(classify_cell(p.bands, signals))
    pose = Pose(ins.x_m, ins.y_m, ins.heading_rad)
    area = s.area or DrivingArea(pose.x_m, pose.y_m, p.half_m)
    tick = PlannerTick(x.tick, dt_s, signals, pose, room_m(area, pose))
    s = s._replace(area=area, pedals=update_acceleration(s.pedals, signals.speed_mps, dt_s))
    s = decide_mode(p, s, tick)
    eased = steering.ease_wheel(p.envelope, s.wheel, _lateral_accel(ins, signals), dt_s)
    wheel = steering.turn_wheel(p.envelope, eased, _target_angle_rad(p, s, tick), signals.speed_mps, dt_s)
    pedal, push = _target_push(p, s, tick)
    if s.mode not in (START, STOP, STAND):  # standing and stopping are allowed outside the bounds
        push = clamp(push, *push_limits(p.envelope, pedal))
    throttle, brake = pedal_duties(p.envelope, push)
    command = Command(throttle, brake, wheel.steer_rad, GEAR_DRIVE, 0.0, NAN)
    s = s._replace(wheel=wheel, pedals=update_push_caps(pedal, p.envelope, push, dt_s), command=command)
    ended = s.mode == STAND and tick.since_s(s.mode_tick) >= STAND_S
    return s, PlannerOutput(command, ENDED if ended else 0.0, s.mode, s.cell)


def decide_mode(p: PlannerParams, s: PlannerState, tick: PlannerTick) -> PlannerState:
    """Mode of this tick."""
    speed = tick.signals.speed_mps
    if s.mode == STAND:
        return s
    if s.mode == STOP:
        return _enter_mode(s, STAND, tick) if speed < STANDING_MPS else s
    if s.mode == START and tick.since_s(s.mode_tick) < INITIAL_BRAKE_S + INITIAL_COAST_S:
        return s
    if s.mode == TURN:
        is_facing = abs(steering.error_rad(tick.pose, s.aim)) < FACING_RAD
        return _choose_next(p, s, tick) if is_facing and not _must_turn(p, s, tick) else s
    if _must_turn(p, s, tick):
        return _begin_turn(s, tick)
    if s.mode == START or _is_over(p, s, tick):
        return _choose_next(p, s, tick)
    if s.mode == GENTLE:
        return _drive_gently(p, s, tick)
    if s.mode == APPROACH:
        return _approach_cell(p, s, tick)
    target = p.targets[s.cell]
    over = not target.low_mps <= speed <= target.high_mps or tick.since_s(s.mode_tick) >= MAX_HOLD_S
    return _choose_next(p, s, tick) if over or not s.counter.lacks(s.cell) else s


def _drive_gently(p: PlannerParams, s: PlannerState, tick: PlannerTick) -> PlannerState:
    """One tick of gentle driving; after the last stretch the cells follow."""
    assert s.area is not None
    speed = tick.signals.speed_mps
    gentle = gentle_driving.advance_stage(s.gentle, p.stretches[s.gentle.number], p.envelope, speed, tick.dt_s)
    error_rad = steering.error_rad(tick.pose, (s.area.x_m, s.area.y_m))
    gentle = gentle_driving.update_return_side(gentle, p.envelope, speed, error_rad, tick.room_m)
    s = s._replace(gentle=gentle_driving.update_push(gentle, s.pedals, p.envelope, tick.dt_s))
    return s if _is_gentle_left(p, s) else _choose_next(p, s, tick)


def _is_gentle_left(p: PlannerParams, s: PlannerState) -> bool:
    return s.gentle.number < len(p.stretches)


def _approach_cell(p: PlannerParams, s: PlannerState, tick: PlannerTick) -> PlannerState:
    """Go to HOLD when the cell can be driven; choose another cell if it cannot be reached or is full."""
    if not s.counter.lacks(s.cell):
        return _choose_next(p, s, tick)
    if tick.since_s(s.mode_tick) >= MAX_APPROACH_S:
        return _choose_next(p, s._replace(skipped_cell=s.cell), tick)
    target = p.targets[s.cell]
    low, high = entry_speeds_mps(target)
    if low <= tick.signals.speed_mps <= high and _has_room(p, s, tick):
        return _enter_mode(s, HOLD, tick)._replace(hold_count=s.hold_count + 1)
    return s


def _has_room(p: PlannerParams, s: PlannerState, tick: PlannerTick) -> bool:
    """Whether the cell can be driven from here: a tight one needs its full circle inside the area, or free distance."""
    assert s.area is not None
    curvature, speed = steering.cell_curvature_1pm(p.envelope, p.bands, p.targets[s.cell]), tick.signals.speed_mps
    if not steering.is_tight(curvature) or is_circle_inside(s.area, tick.pose, curvature):
        return True
    return tick.room_m > turn_back_room_m(p.envelope, speed) + steering.TIGHT_CELL_S * speed


def _choose_next(p: PlannerParams, s: PlannerState, tick: PlannerTick) -> PlannerState:
    """Continue gentle driving, else choose the next missing cell."""
    speed = tick.signals.speed_mps
    if _is_over(p, s, tick):
        return _enter_mode(s, STOP, tick)
    if _is_gentle_left(p, s):
        return _enter_mode(s, GENTLE, tick)._replace(cell=NO_CELL, gentle=gentle_driving.begin_gentle(s.gentle, speed))
    cell = choose_cell(p, s, tick)
    if cell == NO_CELL:
        return _enter_mode(s, STOP, tick)
    assert s.area is not None
    s = _enter_mode(s, APPROACH, tick)._replace(cell=cell, aim=farthest_corner(s.area, tick.pose))
    return _approach_cell(p, s, tick) if cell != s.skipped_cell else s


def _is_over(p: PlannerParams, s: PlannerState, tick: PlannerTick) -> bool:
    return tick.number >= p.stop_tick or (s.counter.missing == 0 and not _is_gentle_left(p, s))


def _begin_turn(s: PlannerState, tick: PlannerTick) -> PlannerState:
    assert s.area is not None
    aim = farthest_corner(s.area, tick.pose)
    side = 1.0 if steering.error_rad(tick.pose, aim) >= 0.0 else -1.0
    return _enter_mode(s, TURN, tick)._replace(aim=aim, wheel=s.wheel._replace(side=side), cell=NO_CELL)


def _enter_mode(s: PlannerState, mode: int, tick: PlannerTick) -> PlannerState:
    return s._replace(mode=mode, mode_tick=tick.number)


def _must_turn(p: PlannerParams, s: PlannerState, tick: PlannerTick) -> bool:
    """Whether the distance ahead is needed for turning back."""
    if tick.room_m > turn_back_room_m(p.envelope, tick.signals.speed_mps):
        return False
    assert s.area is not None
    return not is_circle_inside(s.area, tick.pose, curvature_1pm(p.envelope, tick.signals.steer_rad))


def _target_angle_rad(p: PlannerParams, s: PlannerState, tick: PlannerTick) -> float:
    """Target steering-wheel angle."""
    if s.mode in (START, STOP, STAND):
        return 0.0
    if s.mode == TURN:
        braked = _braking_cell(p, s, tick)
        if braked != NO_CELL:  # straight while it is fast, as the distance ahead was computed for that
            return steering.angle_in_band_rad(p.envelope, p.bands, p.targets[braked], tick.signals.speed_mps, 0.0)
        return steering.turn_back_angle_rad(p.envelope, tick.pose, s.aim, tick.signals.speed_mps, s.wheel.side)
    if s.mode == GENTLE:
        angle = gentle_driving.target_angle_rad(
            s.gentle, p.stretches[s.gentle.number], p.envelope, tick.signals.speed_mps, tick.since_s(0)
        )
        return gentle_driving.limit_wheel_rate_rad(angle, s.wheel.steer_rad, p.envelope, tick.dt_s)
    target = p.targets[s.cell]
    if s.mode == HOLD:
        sway = excitation_wave((s.hold_count // 2) % WAVE_KINDS, tick.since_s(s.mode_tick))
        return steering.angle_in_band_rad(p.envelope, p.bands, target, tick.signals.speed_mps, sway)
    return _approach_angle_rad(p, s, tick)


def _approach_angle_rad(p: PlannerParams, s: PlannerState, tick: PlannerTick) -> float:
    """Angle while a cell's speed is being reached: circle of a tight cell, else to the aim, or the middle if narrow."""
    target, speed, aim = p.targets[s.cell], tick.signals.speed_mps, s.aim
    if steering.is_tight(steering.cell_curvature_1pm(p.envelope, p.bands, target)):
        if _has_room(p, s, tick):
            return steering.angle_in_band_rad(p.envelope, p.bands, target, speed, 0.0)
        assert s.area is not None
        aim = (s.area.x_m, s.area.y_m)
    return steering.angle_towards_rad(p.envelope, steering.error_rad(tick.pose, aim), speed)


def _target_push(p: PlannerParams, s: PlannerState, tick: PlannerTick) -> tuple[PedalState, float]:
    """Push of the pedals."""
    speed = tick.signals.speed_mps
    if s.mode == START:
        return s.pedals, HOLD_PUSH if tick.since_s(s.mode_tick) < INITIAL_BRAKE_S else 0.0
    if s.mode == STAND:
        return s.pedals, HOLD_PUSH
    if s.mode == GENTLE:
        return s.pedals._replace(trim=0.0), s.gentle.push
    if s.mode == HOLD:
        sway = excitation_wave(s.hold_count % WAVE_KINDS, tick.since_s(s.mode_tick))
        place, (least, most) = p.targets[s.cell].index, push_limits(p.envelope, s.pedals)
        most = most if place.pedal >= FIRST_THROTTLE else -least
        return s.pedals._replace(trim=0.0), cell_push(place, s.hold_count, s.pedals.brake_cap, sway, most)
    target_mps2 = clamp(_target_accel(p, s, tick, speed), -_max_decel_mps2(p), _max_accel_mps2(p))
    pedal, push = push_for_acceleration(s.pedals, p.envelope, target_mps2, tick.dt_s)
    if s.mode == TURN and target_mps2 < 0.0 and _braking_cell(p, s, tick) != NO_CELL:
        return pedal, min(push, -BRAKE_HARD - 0.01)
    return pedal, push


def _target_accel(p: PlannerParams, s: PlannerState, tick: PlannerTick, speed: float) -> float:
    """Target acceleration while no pedal band is held."""
    if s.mode == STOP:
        free_m = max(tick.room_m - turn_advance_m(p.envelope, 0.0), 1.0)  # the next drive begins with a turn
        return -max(STOP_MPS2, 0.5 * speed * speed / free_m)
    if s.mode == TURN:
        slow = turning_speed_mps(p.envelope)
        if tick.room_m < turn_advance_m(p.envelope, slow):
            slow = min(slow, NARROW_MPS)
        if speed <= slow + 0.5:
            return 0.8 * (slow - speed)
        free_m = max(tick.room_m - turn_advance_m(p.envelope, slow), 2.0)
        return -max(0.5 * (speed * speed - slow * slow) / free_m, 0.5)
    low, high = entry_speeds_mps(p.targets[s.cell])
    if speed <= high and not _has_room(p, s, tick):
        low = high = turning_speed_mps(p.envelope)  # drive on to where there is room
    if speed < low:
        return 1.0 + 0.8 * (low - speed)
    return -1.0 - 0.8 * (speed - high) if speed > high else 0.0


def _braking_cell(p: PlannerParams, s: PlannerState, tick: PlannerTick) -> int:
    """Cell of hard braking that is filled while a turn slows down: straight, or to the side of the turn."""
    speed = tick.signals.speed_mps
    if speed < turning_speed_mps(p.envelope) + EARLY_MPS:
        return NO_CELL
    band = sum(speed >= edge for edge in p.bands.speed_mps) - 1
    for steer in (STRAIGHT, STRAIGHT + round(s.wheel.side)):
        number = cell_number(CellIndex(False, steer, band, 0))
        if s.counter.lacks(number):
            return number
    return NO_CELL


def _max_decel_mps2(p: PlannerParams) -> float:
    return -HARD_SHARE * p.envelope.accel_low_mps2


def _max_accel_mps2(p: PlannerParams) -> float:
    return APPROACH_SHARE * p.envelope.accel_high_mps2


def _lateral_accel(ins: Ins, signals: CellSignals) -> float:
    """Lateral acceleration, 0 where the yaw rate is not reported."""
    lateral_mps2 = signals.speed_mps * ins.yaw_rate_radps
    return lateral_mps2 if lateral_mps2 - lateral_mps2 == 0.0 else 0.0


def _command_without_signals(p: PlannerParams, s: PlannerState, late: bool) -> tuple[PlannerState, PlannerOutput]:
    """Command while a needed signal is missing: wait at first, then brake with constant steering."""
    throttle, brake = pedal_duties(p.envelope, HOLD_PUSH if late else 0.0)
    command = Command(throttle, brake, s.command.steer_rad, GEAR_DRIVE, 0.0, NAN)
    return s._replace(command=command), PlannerOutput(command, 0.0, s.mode, s.cell)
