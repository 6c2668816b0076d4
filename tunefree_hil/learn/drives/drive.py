"""The recording of one drive on the vehicle's tick grid: the data of all learning.

Where the INS and the chassis both measure a quantity, learning prefers the INS: it has neither wheel slip nor a wheel
radius. The checks prefer the chassis, because a bench's controller reads it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np

from tunefree_hil.base.records import GEAR_REVERSE
from tunefree_hil.config.import_schema import UNITS, ColumnSpec, Unit, si_unit
from tunefree_hil.episode.csv_drive import Column, CsvDrive

Array = np.ndarray
NO_COMMAND_AGES: Mapping[str, Array] = {}


class LogSummary(NamedTuple):
    """Counts and time stamps of a log, for learn/checks/drive_checks.py.

    Frames are counted by message name: all of them (0: the message never came), those too short to decode, and those
    with a wrong CRC or data id. unknown_ids counts frames by the CAN ids that the vehicle folder does not have.
    max_backward_step_s, max_forward_step_s: between two frames of the vehicle, each with the stamp where it ends.
    """

    file: str
    frames: int
    frames_by_message: Mapping[str, int]
    short_frames: Mapping[str, int]
    corrupt_frames: Mapping[str, int]
    unknown_ids: Mapping[int, int]
    span_s: float
    max_backward_step_s: float
    backward_step_at_s: float
    max_forward_step_s: float
    forward_step_at_s: float
    is_truncated: bool  # the last line was incomplete and left out


class Drive(NamedTuple):
    """One recording on the vehicle's tick grid; every array has the shape (n_rows,) unless stated otherwise.

    fields: values by record field as in vehicle.toml, 'command.steer_rad', 'report.wheel_fl_radps', 'ins.x_m': that of
        the newest frame stamped before the end of the tick, NaN before the first frame. A field that the log or the
        vehicle does not have is absent.
    fresh: by the same keys, the ticks in which a frame brought a value.
    enabled: ticks in which by-wire control was enabled, as far as reports show it; all True where no report does.
    command_ages: by the field of an echo, shape (n_changes,): seconds from a command to the first report that echoes it
        (actuators/command_age.py). Absent where commands come with the ticks or the log does not show it.
    """

    name: str
    log_hash: str  # 'sha256:...' of the log's bytes
    dt_s: float
    fields: Mapping[str, Array]
    fresh: Mapping[str, Array]
    enabled: Array
    log_summary: LogSummary | None = None  # None for a drive that was not read from a log
    command_ages: Mapping[str, Array] = NO_COMMAND_AGES

    @property
    def n_rows(self) -> int:
        """The number of ticks."""
        return len(self.enabled)

    @property
    def path(self) -> str:
        """The log as the user named it; the drive's name where it was not read from a log."""
        return self.log_summary.file if self.log_summary is not None else self.name

    def get(self, name: str) -> Array | None:
        """A field's values, None where the drive does not have it."""
        return self.fields.get(name)


class DrivePart(NamedTuple):
    """Rows [begin, end) of a drive, without a gap in the needed fields."""

    drive: Drive
    begin: int
    end: int


class DriveSplit(NamedTuple):
    """Training and held-out parts: whole drives are held out, or guarded blocks of one or two drives."""

    training: tuple[DrivePart, ...]
    held_out: tuple[DrivePart, ...]
    description: str


INS_FIRST_SPEEDS = ("ins.speed_mps", "report.speed_mps")
INS_FIRST_YAW_RATES = ("ins.yaw_rate_radps", "report.yaw_rate_radps")
CHASSIS_FIRST_SPEEDS = ("report.speed_mps", "ins.speed_mps")
CHASSIS_FIRST_YAW_RATES = ("report.yaw_rate_radps", "ins.yaw_rate_radps")
# Best first: the actuator's output, the echo of its command, the command.
THROTTLE_FIELDS = ("report.throttle_frac", "report.throttle_command_frac", "command.throttle_frac")
BRAKE_FIELDS = ("report.brake_frac", "report.brake_command_frac", "command.brake_frac")
STEER_FIELDS = ("report.steer_rad", "report.steer_command_rad", "command.steer_rad")
MOVING_MPS = 0.3  # slower than a scale model drives, faster than the noise of a speed sensor


def first_valid_field(drive: Drive, names: Sequence[str]) -> str | None:
    """The first of these fields that has a finite value anywhere in a drive."""
    for name in names:
        values = drive.get(name)
        if values is not None and np.isfinite(values).any():
            return name
    return None


def first_field_values(drive: Drive, names: Sequence[str]) -> Array | None:
    """The values of `first_field_name`."""
    name = first_field_name(drive, names)
    return None if name is None else drive.fields[name]


def first_field_name(drive: Drive, names: Sequence[str]) -> str | None:
    """The first of these fields that the drive has."""
    return next((name for name in names if name in drive.fields), None)


def moving_rows(drive: Drive) -> Array:
    """Rows in which the vehicle moves, shape (n_rows,); all False where no speed is known."""
    speed = first_field_values(drive, CHASSIS_FIRST_SPEEDS)
    return np.zeros(drive.n_rows, dtype=bool) if speed is None else np.abs(speed) > MOVING_MPS


def reversing_rows(drive: Drive) -> Array:
    """Rows in reverse gear, shape (n_rows,). A reported speed may have either sign there."""
    gear = drive.get("report.gear")
    return np.zeros(drive.n_rows, dtype=bool) if gear is None else gear == GEAR_REVERSE


def csv_drive_from_drive(drive: Drive, substitutes: Mapping[str, str]) -> CsvDrive:
    """A drive in the form that episode/plausible.py checks: fresh values, commands only while enabled.

    Args:
        substitutes: by the name of a field, the field whose values take its place,
            {'report.steer_rad': 'command.steer_rad'}.
    """
    columns = {}
    is_forward = ~reversing_rows(drive)
    for name in [*drive.fields, *substitutes]:
        source = substitutes.get(name, name)
        values = drive.fields[source]
        is_usable = drive.fresh[source] & is_forward & np.isfinite(values)
        if source.startswith("command."):
            is_usable &= drive.enabled
        unit = cast(Unit, next(iter(UNITS[si_unit(name.partition(".")[2])])))
        columns[name] = Column(ColumnSpec(column=source, field=name, unit=unit), values, is_usable)
    return CsvDrive(np.arange(drive.n_rows, dtype=np.float64) * np.float64(drive.dt_s), columns, [], drive.dt_s)
