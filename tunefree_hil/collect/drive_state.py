"""What a drive of the planner is given, where it stands, and what it answers: plain data, no decisions."""

from __future__ import annotations

from typing import NamedTuple

from tunefree_hil.base.records import Command
from tunefree_hil.collect import steering
from tunefree_hil.collect.cells import NONE, Bands, Counter, Seen, Target
from tunefree_hil.collect.envelope import Envelope
from tunefree_hil.collect.gentle import Gait, Stretch
from tunefree_hil.collect.ground import Ground, Pose
from tunefree_hil.collect.pedals import Pedal
from tunefree_hil.collect.seen import Eyes

START, APPROACH, HOLD, TURN, STOP, STAND, GENTLE = range(7)


class Params(NamedTuple):
    """What a drive is given. have, need: frames by cell. stop_tick: the tick at which it begins to stop.

    ground: None where the place of the first tick is the middle of the area. first_hold: number of the first hold, so
    that drives differ in their excitation. stretches: driven gently before the cells.
    """

    envelope: Envelope
    bands: Bands
    targets: tuple[Target, ...]
    eyes: Eyes
    have: tuple[int, ...]
    need: tuple[int, ...]
    half_m: float
    ground: Ground | None
    stop_tick: int
    first_hold: int
    stretches: tuple[Stretch, ...] = ()


class State(NamedTuple):
    """Where it stands. `since`: tick at which the mode began. `counter` is the state's own and is counted in place."""

    counter: Counter
    ground: Ground | None
    command: Command
    mode: int = START
    since: int = 0
    cell: int = NONE
    tired: int = NONE
    hold: int = 0
    pedal: Pedal = Pedal()
    wheel: steering.Wheel = steering.Wheel()
    aim: tuple[float, float] = (0.0, 0.0)
    gait: Gait = Gait()


class Answer(NamedTuple):
    """command, and error_code ENDED when the drive has ended; mode and cell for whoever looks on."""

    command: Command
    error_code: float
    mode: int
    cell: int


class Now(NamedTuple):
    """What is known at a tick."""

    tick: int
    dt_s: float
    seen: Seen
    pose: Pose
    room_m: float

    def since_s(self, tick: int) -> float:
        """Time since a tick."""
        return (self.tick - tick) * self.dt_s
