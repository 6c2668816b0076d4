"""Extract the drive of a reference from a log: its columns, with or without positions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.course import Course, Tracking
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.control.follower import make_follower
from tunefree_hil.episode.candump import EXTENDED_BIT, LogFrame
from tunefree_hil.episode.columns import columns_from_frames
from tunefree_hil.episode.real_time import MOST_STEP_S, clock_jump, times_of
from tunefree_hil.episode.recording import Recording
from tunefree_hil.grade.align import AlignMode, add_longitudinal_reference, find_start_by_speed, place_course
from tunefree_hil.grade.profile import DriveExtras
from tunefree_hil.grade.reference import ReferencePath
from tunefree_hil.grade.score import GradeVehicle
from tunefree_hil.jobs.log.files import has_vehicle_channels
from tunefree_hil.jobs.run_folder import read_json

POSITION = {"x_m", "y_m", "heading_rad"}
ODOMETRY = "station error from the integral of the reported speed: it contains the scale error of that signal"


class LogDrive(NamedTuple):
    """A drive against `course` in the log's coordinates. notes: alignment, and missing signals.

    span_s: first and last time stamp of the drive in the log.
    """

    recording: Recording
    course: Course
    notes: list[str]
    span_s: tuple[float, float]


def read_log_drive(
    reader: LogColumns, vehicle: GradeVehicle, reference: ReferencePath, *, align: AlignMode, start_s: float | None
) -> LogDrive:
    """Read the part of a log in which `reference` is driven.

    With positions, the follower computes the errors from the INS frames; without them only longitudinal errors.

    Args:
        start_s: Start given by the user, in seconds from the first frame; None to find it.
    """
    whole = reader.read(make_silent_follower(), 0, 0)
    notes = [reader.times.words] if reader.times.late_ticks else []
    if whole.columns.keys() >= POSITION:
        given = align if align != "auto" or not reference.in_log_coordinates else "recorded"
        placed = place_course(whole, reference.course, align=given, start_s=start_s)
        ticks = _count_ticks(whole, placed.row, placed.course)
        drive = reader.read(make_follower(placed.course, vehicle.rear_axle_m), placed.row, ticks)
        if "speed_error_mps" in drive.columns:
            return LogDrive(drive, placed.course, [*notes, placed.text], reader.span_s(placed.row, ticks))
    row, text = _start_without_positions(whole, reference.course, start_s)
    ticks = _count_ticks(whole, row, reference.course)
    drive = add_longitudinal_reference(reader.read(make_silent_follower(), row, ticks), reference.course)
    notes += [text, "no INS frames with position and speed: no lateral errors", ODOMETRY]
    return LogDrive(drive, reference.course, notes, reader.span_s(row, ticks))


class LogColumns:
    """Reads parts of a log as columns. folder: of the log."""

    def __init__(self, frames: Sequence[LogFrame], codec: Codec, folder: Path) -> None:
        self._frames, self._codec = frames, codec
        self._dt_s = dt_s = codec.tick_ms * 1e-3
        stamps = np.array([frame.time_s for frame in frames])
        off_grid = float(np.abs(stamps / dt_s - np.round(stamps / dt_s)).max())
        self.times = times_of(off_grid, float(stamps[0]), float(stamps.min()), dt_s, folder)
        self._by_channel = has_vehicle_channels(frames, codec)

    def read(self, follower: Block, row: int, ticks: int) -> Recording:
        """Columns of `ticks` rows from `row` on; 0 ticks: all."""
        zero_s, late_ticks = self.times.zero_s + row * self._dt_s, self.times.late_ticks
        part = {"ticks": ticks, "zero_s": zero_s, "late_ticks": late_ticks, "by_channel": self._by_channel}
        return columns_from_frames(self._frames, self._codec, follower, self._dt_s, **part)

    def span_s(self, row: int, ticks: int) -> tuple[float, float]:
        """First and last time stamp of some rows."""
        return self.times.zero_s + row * self._dt_s, self.times.zero_s + (row + ticks) * self._dt_s


def require_steady_clock(frames: Sequence[LogFrame], log: Path) -> None:
    """Raise InputError for a clock that jumps."""
    steps = np.diff([frame.time_s for frame in frames])
    if len(steps) and float(np.abs(steps).max()) > MOST_STEP_S:
        k = int(np.abs(steps).argmax())
        direction = "back" if steps[k] < 0.0 else "ahead"
        raise clock_jump(abs(float(steps[k])), frames[k + 1].time_s, direction, log)


def make_silent_follower() -> Block:
    """A follower without output, for a log without positions."""

    def init(params: Any, dt_s: float) -> None:
        return None

    def step(params: Any, state: Any, x: Any, dt_s: float) -> tuple[Any, Tracking]:
        return state, params

    return Block(init, step, Tracking())


def manual_driving_s(frames: Sequence[LogFrame], codec: Codec, span_s: tuple[float, float]) -> float:
    """Seconds in a part of a log in which a by-wire channel is reported as not enabled.

    0 where no message reports it. Apollo's control profiling uses rows in automatic mode only.
    """
    telemetry, messages = set(codec.telemetry), {}
    off: dict[str, bool] = {}
    total_s = before_s = 0.0
    for frame in frames:
        key = (frame.can_id, frame.channel)
        if key not in messages:
            can_id, extended = frame.can_id & ~EXTENDED_BIT, bool(frame.can_id & EXTENDED_BIT)
            decoded_by = codec.find(CanFrame(can_id, b"", extended=extended))
            messages[key] = decoded_by if decoded_by in telemetry else None
        message = messages[key]
        enables = [state for state in message.states if state.condition == "enabled"] if message is not None else []
        if message is None or not enables or not message.fits(frame.data):
            continue
        if any(off.values()):
            total_s += max(0.0, min(frame.time_s, span_s[1]) - max(before_s, span_s[0]))
        before_s, decoded = frame.time_s, codec.decode(message, frame.data)
        off[message.name] = any(decoded.get(state.signal) != state.active for state in enables)
    return total_s


def read_extras(folder: Path) -> DriveExtras:
    """Compute times and end of a drive from timing.npz and episode.json beside the log, where they exist."""
    timing, summary = folder / "timing.npz", folder / "episode.json"
    control_time_s = None
    if timing.is_file():
        with np.load(timing, allow_pickle=False) as data:
            control_time_s = data.get("controller_control_time_s")
    if control_time_s is not None and not len(control_time_s):
        control_time_s = None
    error = str(read_json(summary).get("error", "")) if summary.is_file() else None
    return DriveExtras(control_time_s, error)


def _count_ticks(whole: Recording, row: int, course: Course) -> int:
    """Number of rows to the end of the plan or of the log. Raises InputError for a start outside the log."""
    ticks = min(course.ticks, whole.ticks - row)
    if row < 0 or ticks < 1:
        message = f"the start at {row * whole.dt_s:.1f} s is outside the log of {whole.ticks * whole.dt_s:.1f} s"
        raise InputError(message, code="bad_start", key="--start-s", hint="give seconds from the log's first frame")
    return ticks


def _start_without_positions(whole: Recording, course: Course, start_s: float | None) -> tuple[int, str]:
    """Row of the start in a log without positions, and a text about it."""
    if start_s is not None:
        return round(start_s / whole.dt_s), f"started at {start_s:g} s of the log (--start-s)"
    speed = whole.get("speed_mps")
    return find_start_by_speed(np.full(whole.ticks, np.nan) if speed is None else speed, course, whole.dt_s)
