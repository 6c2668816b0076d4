"""What learning works on: recordings of a vehicle on its tick grid, one Drive a log."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

Array = np.ndarray
NO_AGES: Mapping[str, Array] = {}


class Reading(NamedTuple):
    """What a log said beside its values; for learn/checks.py, and for people.

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
