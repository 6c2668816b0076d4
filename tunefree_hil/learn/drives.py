"""What learning works on: recordings of a vehicle on its tick grid, one Drive a log."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

Array = np.ndarray


class Drive(NamedTuple):
    """One recording on the vehicle's tick grid.

    fields: record field by its name in vehicle.toml ('command.steer_rad', 'report.steer_command_rad',
    'report.throttle_frac', 'ins.x_m', ...; a list of wheels as 'report.wheel_fl_radps' ...) -> float64 [n]: the value
    of the newest frame stamped before the end of the tick, NaN before the first. A field that the log or the vehicle
    does not have is absent. fresh: the same keys -> bool [n]: ticks in which a frame brought a value.
    enabled: bool [n], whether the by-wire channels obeyed as far as reports say (all True where none can say it).
    """

    name: str
    log_hash: str  # 'sha256:...' of the log's bytes
    dt_s: float
    fields: Mapping[str, Array]
    fresh: Mapping[str, Array]
    enabled: Array

    @property
    def ticks(self) -> int:
        """Rows."""
        return len(self.enabled)

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
