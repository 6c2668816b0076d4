"""What the checks of drives share: which field says a thing where several do, and drives as csv_drive's columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from tunefree_hil.base.records import GEAR_REVERSE
from tunefree_hil.config.import_schema import UNITS, ColumnSpec, Unit, si_unit
from tunefree_hil.episode.csv_drive import Column, CsvDrive
from tunefree_hil.learn.drives import Drive
from tunefree_hil.learn.fields import CHASSIS_FIRST_SPEEDS

Array = np.ndarray

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
