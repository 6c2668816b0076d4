"""Where the numbers that cells are told by come from: the reports, and what stands in where a vehicle lacks one.

What a drive of the planner is given, where it stands, and what it answers: plain data, no decisions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.records import GROUPS, Command, Measurement
from tunefree_hil.collect import steering
from tunefree_hil.collect.area import Ground, Pose
from tunefree_hil.collect.cells import NONE, Bands, Counter, Seen, Target, cell_of
from tunefree_hil.collect.envelope import Envelope
from tunefree_hil.collect.gentle_driving import Gait, Stretch
from tunefree_hil.collect.pedals import Pedal
from tunefree_hil.config.schema import VehicleSpec

Array = np.ndarray

# field of Seen -> record fields, the best first
SOURCES: dict[str, tuple[str, ...]] = {
    "gear": ("report.gear",),
    "speed_mps": ("report.speed_mps", "ins.speed_mps"),
    "steer_rad": ("report.steer_rad", "report.steer_command_rad", "command.steer_rad"),
    "throttle_frac": ("report.throttle_frac", "report.throttle_command_frac", "command.throttle_frac"),
    "brake_frac": ("report.brake_frac", "report.brake_command_frac", "command.brake_frac"),
}
WITHOUT = {
    "report.throttle_frac": "the throttle's dead time and lag show in the motion only; `calibrate` gives them wider",
    "report.brake_frac": "the brake's dead time and lag show in the motion only; `calibrate` gives them wider",
    "report.steer_rad": "the steering's dead time and lag show in the yaw rate only; `calibrate` gives them wider",
    "report.speed_mps": "cells are counted by the INS's speed",
    "report.gear": "every frame counts as driven forwards",
}


class Eyes(NamedTuple):
    """For each field of Seen (group, index in its record); group '' where nothing tells."""

    gear: tuple[str, int]
    speed_mps: tuple[str, int]
    steer_rad: tuple[str, int]
    throttle_frac: tuple[str, int]
    brake_frac: tuple[str, int]


def sources_of(known: Collection[str]) -> dict[str, str]:
    """field of Seen -> the record field that tells it, '' where none of `known` does."""
    return {name: next((one for one in choices if one in known), "") for name, choices in SOURCES.items()}


def fields_of(vehicle: VehicleSpec) -> list[str]:
    """The record fields that a vehicle folder maps: 'report.speed_mps', ..."""
    return [f"{group}.{name}" for group in GROUPS for name in getattr(vehicle, group)]


def eyes_of(vehicle: VehicleSpec) -> Eyes:
    """Where to look in a vehicle's records."""
    return Eyes(*(_place(source) for source in sources_of(fields_of(vehicle)).values()))


def lacking(vehicle: VehicleSpec) -> list[str]:
    """What cannot be done with this vehicle for want of a report, a sentence each."""
    known = fields_of(vehicle)
    said = [f"no [{name}]: {words}" for name, words in WITHOUT.items() if name not in known]
    return said if sources_of(known)["speed_mps"] else [*said, "no speed is reported: no gentle stretch can be driven"]


def look(eyes: Eyes, measurement: Measurement, command: Command) -> Seen:
    """What is seen at a tick; command: the last one that was sent."""
    records = {"report": measurement.report, "ins": measurement.ins, "command": command}
    return Seen(*(records[group][index] if group else math.nan for group, index in eyes))


def count(get: Callable[[str], Array | None], bands: Bands, counter: Counter) -> Counter:
    """Count a whole recording, whose fields `get` gives by name, into `counter`.

    The same as seeing it tick by tick. A recording without speed, steering or pedals adds nothing.
    """
    columns = []
    for name, choices in SOURCES.items():
        column = next((found for one in choices if (found := get(one)) is not None), None)
        if column is None and name != "gear":
            return counter
        columns.append(column)
    rows = max(len(column) for column in columns if column is not None)
    filled = [np.full(rows, math.nan) if column is None else column for column in columns]
    counter.pause()
    _see_all(zip(*(column.tolist() for column in filled), strict=True), bands, counter)
    counter.pause()
    return counter


def _see_all(rows: Iterable[tuple[float, ...]], bands: Bands, counter: Counter) -> None:
    for row in rows:
        counter.see(cell_of(bands, Seen._make(row)))


def _place(source: str) -> tuple[str, int]:
    group, _, name = source.partition(".")
    return (group, GROUPS[group]._fields.index(name)) if source else ("", 0)


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
