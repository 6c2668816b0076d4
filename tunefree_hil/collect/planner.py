"""The planner: a Block that drives whatever coverage still lacks, in the place of a controller that follows a path.

    START ─> GENTLE ─> APPROACH ─> HOLD ─> (next cell) ... STOP ─> STAND, and the drive has ended
               └──────────┴── no room ahead ──> TURN ──┘

A drive begins with the gentle stretches that it is given (gentle.py), then goes for cells.

step(params, state, Sight, dt_s) -> (state, Answer). It is a pure function of tick, measurement and state, and drives by
what it measures only. It stays inside the envelope by planning with shares of it, and inside the area by turning back
while braking, turning and reacting still fit into the way ahead.
"""

from __future__ import annotations

from tunefree_hil.base.kernel import Block
from tunefree_hil.base.maths import clamp
from tunefree_hil.base.records import GEAR_DRIVE, NAN, Command, Ins
from tunefree_hil.collect import gentle_driving, steering
from tunefree_hil.collect.area import Ground, Pose, circle_fits, far_corner, room_m
from tunefree_hil.collect.cells import FIRST_THROTTLE, NONE, STRAIGHT, Counter, Place, Seen, cell_of, number_of
from tunefree_hil.collect.envelope import HARD_SHARE, curvature_1pm, room_to_turn_m, turn_room_m, turn_speed_mps
from tunefree_hil.collect.excitation_signals import KINDS, wave
from tunefree_hil.collect.features import (
    APPROACH,
    GENTLE,
    HOLD,
    STAND,
    START,
    STOP,
    TURN,
    Answer,
    Now,
    Params,
    State,
    look,
)
from tunefree_hil.collect.next_cell import entry_mps, pick
from tunefree_hil.collect.pedals import BRAKE_HARD, HOLD_PUSH, Pedal, duties, ends, felt, learned_cap, level, push_for
from tunefree_hil.control.cascade import Sight

ENDED = 11.0  # bench_channel.ErrorCode.STOPPED: standing, nothing more to drive
BRAKED_S, CREEP_S = 1.0, 2.5  # a drive begins on the brake, then with both pedals at rest
STAND_S = 1.0
STANDING_MPS = 0.05
HOLD_MOST_S = 12.0
APPROACH_MOST_S = 25.0
STOP_MPS2 = 1.5
FACING_RAD = 0.12  # a turn is over when it looks at its aim
EARLY_MPS = 2.0  # above the turning speed: a turn only brakes
NARROW_MPS = 3.0  # turning with the border near
APPROACH_SHARE = 0.95  # of its acceleration
UNHEARD_S = 0.2


def make_planner(params: Params) -> Block:
    """The Block."""
    return Block(init, step, params)


def init(params: Params, dt_s: float) -> State:
    rest = params.envelope.rest_frac
    command = Command(rest, rest, 0.0, GEAR_DRIVE, 0.0, NAN)
    return State(Counter(params.need, params.have), params.ground, command, hold=params.first_hold)


def step(p: Params, s: State, x: Sight, dt_s: float) -> tuple[State, Answer]:
    """One tick."""
    ins = x.measurement.ins
    seen = look(p.eyes, x.measurement, s.command)
    total = ins.x_m + ins.y_m + ins.heading_rad + seen.speed_mps + seen.steer_rad
    if total - total != 0.0:
        return _unheard(p, s, x.tick * dt_s >= UNHEARD_S)
    s.counter.see(cell_of(p.bands, seen))
    pose = Pose(ins.x_m, ins.y_m, ins.heading_rad)
    ground = s.ground or Ground(pose.x_m, pose.y_m, p.half_m)
    now = Now(x.tick, dt_s, seen, pose, room_m(ground, pose))
    s = s._replace(ground=ground, pedal=felt(s.pedal, seen.speed_mps, dt_s))
    s = think(p, s, now)
    wheel = steering.turned(p.envelope, s.wheel, _wish_rad(p, s, now), seen.speed_mps, _lateral(ins, seen), dt_s)
    pedal, push = _push(p, s, now)
    if s.mode not in (START, STOP, STAND):  # it stands and comes to a stand whatever a model's data covered
        push = clamp(push, *ends(p.envelope, pedal))
    throttle, brake = duties(p.envelope, push)
    command = Command(throttle, brake, wheel.steer_rad, GEAR_DRIVE, 0.0, NAN)
    s = s._replace(wheel=wheel, pedal=learned_cap(pedal, p.envelope, push, dt_s), command=command)
    ended = s.mode == STAND and now.since_s(s.since) >= STAND_S
    return s, Answer(command, ENDED if ended else 0.0, s.mode, s.cell)


def think(p: Params, s: State, now: Now) -> State:
    """The mode of this tick."""
    speed = now.seen.speed_mps
    if s.mode == STAND:
        return s
    if s.mode == STOP:
        return _into(s, STAND, now) if speed < STANDING_MPS else s
    if s.mode == START and now.since_s(s.since) < BRAKED_S + CREEP_S:
        return s
    if s.mode == TURN:
        faces = abs(steering.error_rad(now.pose, s.aim)) < FACING_RAD
        return _next(p, s, now) if faces and not _must_turn(p, s, now) else s
    if _must_turn(p, s, now):
        return _turn(p, s, now)
    if s.mode == START or _is_over(p, s, now):
        return _next(p, s, now)
    if s.mode == GENTLE:
        return _gentle(p, s, now)
    if s.mode == APPROACH:
        return _approach(p, s, now)
    target = p.targets[s.cell]
    over = not target.low_mps <= speed <= target.high_mps or now.since_s(s.since) >= HOLD_MOST_S
    return _next(p, s, now) if over or not s.counter.lacks(s.cell) else s


def _gentle(p: Params, s: State, now: Now) -> State:
    """A tick of gentle driving; on to the cells after the last stretch."""
    assert s.ground is not None
    speed = now.seen.speed_mps
    gait = gentle_driving.gone_on(s.gait, p.stretches[s.gait.number], p.envelope, speed, now.dt_s)
    gait = gentle_driving.bent_back(gait, p.envelope, s.ground, now.pose, speed, now.room_m)
    s = s._replace(gait=gentle_driving.pushed(gait, s.pedal, p.envelope, now.dt_s))
    return s if _is_gentle_left(p, s) else _next(p, s, now)


def _is_gentle_left(p: Params, s: State) -> bool:
    return s.gait.number < len(p.stretches)


def _approach(p: Params, s: State, now: Now) -> State:
    """HOLD once the cell can be driven; another cell where this one stays out of reach, or has become full."""
    if not s.counter.lacks(s.cell):
        return _next(p, s, now)
    if now.since_s(s.since) >= APPROACH_MOST_S:
        return _next(p, s._replace(tired=s.cell), now)
    target = p.targets[s.cell]
    low, high = entry_mps(target)
    if low <= now.seen.speed_mps <= high and _has_place(p, s, now):
        return _into(s, HOLD, now)._replace(hold=s.hold + 1)
    return s


def _has_place(p: Params, s: State, now: Now) -> bool:
    return steering.has_place(p.envelope, p.bands, p.targets[s.cell], s.ground, now.pose, now.seen.speed_mps)


def _next(p: Params, s: State, now: Now) -> State:
    """On with what is left of gentle driving, else to the nearest missing cell; to where it has room first."""
    speed = now.seen.speed_mps
    if _is_over(p, s, now):
        return _into(s, STOP, now)
    if _is_gentle_left(p, s):
        return _into(s, GENTLE, now)._replace(cell=NONE, gait=gentle_driving.taken_up(s.gait, speed))
    cell = pick(p.targets, s.counter, p.envelope, speed, steering.band_of(p.bands, now.seen), now.room_m, s.tired)
    if cell == NONE:
        return _into(s, STOP, now)
    assert s.ground is not None
    s = _into(s, APPROACH, now)._replace(cell=cell, aim=far_corner(s.ground, now.pose))
    return _approach(p, s, now) if cell != s.tired else s


def _is_over(p: Params, s: State, now: Now) -> bool:
    return now.tick >= p.stop_tick or (s.counter.missing == 0 and not _is_gentle_left(p, s))


def _turn(p: Params, s: State, now: Now) -> State:
    assert s.ground is not None
    aim = far_corner(s.ground, now.pose)
    side = 1.0 if steering.error_rad(now.pose, aim) >= 0.0 else -1.0
    return _into(s, TURN, now)._replace(aim=aim, wheel=s.wheel._replace(side=side), cell=NONE)


def _into(s: State, mode: int, now: Now) -> State:
    return s._replace(mode=mode, since=now.tick)


def _must_turn(p: Params, s: State, now: Now) -> bool:
    """Whether the way ahead is all needed for turning back."""
    if now.room_m > room_to_turn_m(p.envelope, now.seen.speed_mps):
        return False
    assert s.ground is not None
    return not circle_fits(s.ground, now.pose, curvature_1pm(p.envelope, now.seen.steer_rad))


def _wish_rad(p: Params, s: State, now: Now) -> float:
    """The steering-wheel angle wished for."""
    if s.mode in (START, STOP, STAND):
        return 0.0
    if s.mode == TURN:
        braked = _braked(p, s, now)
        if braked != NONE:  # straight on while it is fast: the way ahead was reckoned for that
            return steering.in_band(p.envelope, p.bands, p.targets[braked], now.seen.speed_mps, 0.0)
        return steering.turn_back(p.envelope, now.pose, s.aim, now.seen.speed_mps, s.wheel.side)
    if s.mode == GENTLE:
        angle = gentle_driving.angle_rad(
            s.gait, p.stretches[s.gait.number], p.envelope, now.seen.speed_mps, now.since_s(0)
        )
        return gentle_driving.calm_rad(angle, s.wheel.steer_rad, p.envelope, now.dt_s)
    target = p.targets[s.cell]
    if s.mode == HOLD:
        sway = wave((s.hold // 2) % KINDS, now.since_s(s.since))
        return steering.in_band(p.envelope, p.bands, target, now.seen.speed_mps, sway)
    return steering.approach(p.envelope, p.bands, target, s.ground, now.pose, s.aim, now.seen.speed_mps)


def _push(p: Params, s: State, now: Now) -> tuple[Pedal, float]:
    """The push of the pedals."""
    speed = now.seen.speed_mps
    if s.mode == START:
        return s.pedal, HOLD_PUSH if now.since_s(s.since) < BRAKED_S else 0.0
    if s.mode == STAND:
        return s.pedal, HOLD_PUSH
    if s.mode == GENTLE:
        return s.pedal._replace(trim=0.0), s.gait.push
    if s.mode == HOLD:
        sway = wave(s.hold % KINDS, now.since_s(s.since))
        place, (least, most) = p.targets[s.cell].place, ends(p.envelope, s.pedal)
        most = most if place.pedal >= FIRST_THROTTLE else -least
        return s.pedal._replace(trim=0.0), level(place, s.hold, s.pedal.cap, sway, most)
    wish = clamp(_accel(p, s, now, speed), -_hardest(p), _liveliest(p))
    pedal, push = push_for(s.pedal, p.envelope, wish, now.dt_s)
    if s.mode == TURN and wish < 0.0 and _braked(p, s, now) != NONE:
        return pedal, min(push, -BRAKE_HARD - 0.01)
    return pedal, push


def _accel(p: Params, s: State, now: Now, speed: float) -> float:
    """The acceleration wished for while no pedal level is held."""
    if s.mode == STOP:
        way = max(now.room_m - turn_room_m(p.envelope, 0.0), 1.0)  # the next drive begins with turning away
        return -max(STOP_MPS2, 0.5 * speed * speed / way)
    if s.mode == TURN:
        slow = turn_speed_mps(p.envelope)
        if now.room_m < turn_room_m(p.envelope, slow):
            slow = min(slow, NARROW_MPS)
        if speed <= slow + 0.5:
            return 0.8 * (slow - speed)
        way = max(now.room_m - turn_room_m(p.envelope, slow), 2.0)
        return -max(0.5 * (speed * speed - slow * slow) / way, 0.5)
    low, high = entry_mps(p.targets[s.cell])
    if speed <= high and not _has_place(p, s, now):
        low = high = turn_speed_mps(p.envelope)  # on to where it has place
    if speed < low:
        return 1.0 + 0.8 * (low - speed)
    return -1.0 - 0.8 * (speed - high) if speed > high else 0.0


def _braked(p: Params, s: State, now: Now) -> int:
    """The cell of hard braking that a turn fills on its way down from a high speed: straight, or to the aim's side."""
    speed = now.seen.speed_mps
    if speed < turn_speed_mps(p.envelope) + EARLY_MPS:
        return NONE
    band = sum(speed >= edge for edge in p.bands.speed_mps) - 1
    for steer in (STRAIGHT, STRAIGHT + round(s.wheel.side)):
        number = number_of(Place(False, steer, band, 0))
        if s.counter.lacks(number):
            return number
    return NONE


def _hardest(p: Params) -> float:
    return -HARD_SHARE * p.envelope.accel_low_mps2


def _liveliest(p: Params) -> float:
    return APPROACH_SHARE * p.envelope.accel_high_mps2


def _lateral(ins: Ins, seen: Seen) -> float:
    """Lateral acceleration, or 0 where nobody tells the yaw rate."""
    felt_mps2 = seen.speed_mps * ins.yaw_rate_radps
    return felt_mps2 if felt_mps2 - felt_mps2 == 0.0 else 0.0


def _unheard(p: Params, s: State, late: bool) -> tuple[State, Answer]:
    """A value that is needed is not there: wait at first, then brake with the wheel held."""
    throttle, brake = duties(p.envelope, HOLD_PUSH if late else 0.0)
    command = Command(throttle, brake, s.command.steer_rad, GEAR_DRIVE, 0.0, NAN)
    return s._replace(command=command), Answer(command, 0.0, s.mode, s.cell)
