"""What learning works on: recordings of a vehicle on its tick grid, one Drive a log.

Which field says a thing where both the INS and the chassis do: the first of a list that says anything.

Learning takes the INS first, which has no wheel that slips and no radius. What is checked, and what a bench's
controller hears, is the chassis: there it comes first.

What the checks of drives share: which field says a thing where several do, and drives as csv_drive's columns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np

from tunefree_hil.base.records import GEAR_REVERSE
from tunefree_hil.config.import_schema import UNITS, ColumnSpec, Unit, si_unit
from tunefree_hil.episode.csv_drive import Column, CsvDrive

Array = np.ndarray
NO_AGES: Mapping[str, Array] = {}


class Reading(NamedTuple):
    """What a log said beside its values; for learn/checks/drive_checks.py, and for people.

    heard, short, broken: frames by message of the folder: all of them (0: never came), too short to decode, with a CRC
    or data id that does not fit. foreign: frames by id that the folder does not know. back_s, ahead_s: the furthest
    step of the clock back and ahead between one frame of the vehicle and the next, and the stamps where they are.
    times: how stamps became ticks, in words. cut: the last line was cut off and left out.
    """

    file: str
    frames: int
    heard: Mapping[str, int]
    short: Mapping[str, int]
    broken: Mapping[str, int]
    foreign: Mapping[int, int]
    span_s: float
    back_s: float
    back_at_s: float
    ahead_s: float
    ahead_at_s: float
    times: str
    cut: bool


class Drive(NamedTuple):
    """One recording on the vehicle's tick grid.

    fields: record field by its name in vehicle.toml ('command.steer_rad', 'report.steer_command_rad',
    'report.throttle_frac', 'ins.x_m', ...; a list of wheels as 'report.wheel_fl_radps' ...) -> float64 [n]: the value
    of the newest frame stamped before the end of the tick, NaN before the first. A field that the log or the vehicle
    does not have is absent. fresh: the same keys -> bool [n]: ticks in which a frame brought a value.
    enabled: bool [n], whether the by-wire channels obeyed as far as reports say (all True where none can say it).
    command_ages: by the field of an echo, seconds [m] from a command to the report that echoes it first
    (command_age.py); absent where commands come with the ticks, or nothing tells it.
    reading: what the log said beside its values; None for a drive that came out of no log.
    """

    name: str
    log_hash: str  # 'sha256:...' of the log's bytes
    dt_s: float
    fields: Mapping[str, Array]
    fresh: Mapping[str, Array]
    enabled: Array
    reading: Reading | None = None
    command_ages: Mapping[str, Array] = NO_AGES

    @property
    def ticks(self) -> int:
        """Rows."""
        return len(self.enabled)

    @property
    def path(self) -> str:
        """The log as it was given, which people look for; the name where it came out of none."""
        return self.reading.file if self.reading is not None else self.name

    def get(self, name: str) -> Array | None:
        """A field, or None where it could not be had."""
        return self.fields.get(name)


class Part(NamedTuple):
    """Rows [begin, end) of a drive, without a gap in what the user of it needs."""

    drive: Drive
    begin: int
    end: int


class Split(NamedTuple):
    """Training and held-out parts: whole drives held out, or guarded blocks where there is one drive only.

    words: how it was split, for people.
    """

    training: tuple[Part, ...]
    held_out: tuple[Part, ...]
    words: str


INS_FIRST_SPEEDS = ("ins.speed_mps", "report.speed_mps")
INS_FIRST_YAW_RATES = ("ins.yaw_rate_radps", "report.yaw_rate_radps")
CHASSIS_FIRST_SPEEDS = ("report.speed_mps", "ins.speed_mps")
CHASSIS_FIRST_YAW_RATES = ("report.yaw_rate_radps", "ins.yaw_rate_radps")


def first_told(drive: Drive, names: Sequence[str]) -> str | None:
    """The first of these fields that says a number anywhere in a drive."""
    for name in names:
        values = drive.get(name)
        if values is not None and np.isfinite(values).any():
            return name
    return None


# Best first: what the actuator did, what it was told as it says, what it was told.
THROTTLES = ("report.throttle_frac", "report.throttle_command_frac", "command.throttle_frac")
BRAKES = ("report.brake_frac", "report.brake_command_frac", "command.brake_frac")
TURNS = ("report.steer_rad", "report.steer_command_rad", "command.steer_rad")
MOVING_MPS = 0.3  # slower than a scale model drives, faster than a speed sensor's noise


def first_of(drive: Drive, names: Sequence[str]) -> Array | None:
    """The first of these fields that the drive has."""
    name = name_of(drive, names)
    return None if name is None else drive.fields[name]


def name_of(drive: Drive, names: Sequence[str]) -> str | None:
    """Which one that is."""
    return next((name for name in names if name in drive.fields), None)


def moving(drive: Drive) -> Array:
    """bool [n]: the vehicle moves; all False where no speed is known."""
    speed = first_of(drive, CHASSIS_FIRST_SPEEDS)
    return np.zeros(drive.ticks, dtype=bool) if speed is None else np.abs(speed) > MOVING_MPS


def backwards(drive: Drive) -> Array:
    """bool [n]: in reverse gear, in which reports of speed may or may not be negative; left out of what has a sign."""
    gear = drive.get("report.gear")
    return np.zeros(drive.ticks, dtype=bool) if gear is None else gear == GEAR_REVERSE


def as_columns(drive: Drive, instead: Mapping[str, str]) -> CsvDrive:
    """A drive as episode/plausible.py judges it: each field where a frame brought it, commands while they were obeyed.

    instead: fields under another's name, {'report.steer_rad': 'command.steer_rad'}.
    """
    columns = {}
    usable = ~backwards(drive)
    for name in [*drive.fields, *instead]:
        source = instead.get(name, name)
        values = drive.fields[source]
        sent = drive.fresh[source] & usable & np.isfinite(values)
        if source.startswith("command."):
            sent &= drive.enabled
        unit = cast(Unit, next(iter(UNITS[si_unit(name.partition(".")[2])])))
        columns[name] = Column(ColumnSpec(column=source, field=name, unit=unit), values, sent)
    return CsvDrive(np.arange(drive.ticks, dtype=np.float64) * np.float64(drive.dt_s), columns, [], drive.dt_s)
