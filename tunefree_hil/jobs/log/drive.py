"""A drive out of any log: columns against a reference, however much or little of the vehicle the log knows."""

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
from tunefree_hil.grade.align import Align, find_by_speed, longitudinal_only, place_course
from tunefree_hil.grade.profile import Beside
from tunefree_hil.grade.reference import Reference
from tunefree_hil.grade.score import GradeVehicle
from tunefree_hil.jobs.log.files import by_channel
from tunefree_hil.jobs.run_folder import read_json

POSITION = {"x_m", "y_m", "heading_rad"}
ODOMETRY = "station error by the integral of the reported speed: it runs with that signal's scale"


class LogDrive(NamedTuple):
    """columns against `course`, which lies in the log's coordinates; notes: how it was placed, what was not had.

    span_s: first and last time stamp of the part of the log that the rows are.
    """

    recording: Recording
    course: Course
    notes: list[str]
    span_s: tuple[float, float]


def read_drive(
    frames: Sequence[LogFrame],
    codec: Codec,
    vehicle: GradeVehicle,
    reference: Reference,
    *,
    align: Align,
    start_s: float | None,
    folder: Path,
) -> LogDrive:
    """The columns of the part of a log in which `reference` is driven. folder: where the log lies.

    With positions by the follower Block, run on the INS frames; without them the longitudinal ones only.
    """
    dt_s = codec.tick_ms * 1e-3
    stamps = np.array([frame.time_s for frame in frames])
    off_grid = float(np.abs(stamps / dt_s - np.round(stamps / dt_s)).max())
    times = times_of(off_grid, float(stamps[0]), float(stamps.min()), dt_s, folder)
    named = by_channel(frames, codec)

    def columns(follower: Block, row: int, ticks: int) -> Recording:
        zero_s = times.zero_s + row * dt_s
        options = {"ticks": ticks, "zero_s": zero_s, "late_ticks": times.late_ticks, "by_channel": named}
        return columns_from_frames(frames, codec, follower, dt_s, **options)

    def span(row: int, ticks: int) -> tuple[float, float]:
        return times.zero_s + row * dt_s, times.zero_s + (row + ticks) * dt_s

    whole = columns(nobody(), 0, 0)
    notes = [times.words] if times.late_ticks else []
    if whole.columns.keys() >= POSITION:
        given = align if align != "auto" or not reference.world else "recorded"
        placed = place_course(whole, reference.course, align=given, start_s=start_s)
        ticks = _ticks(whole, placed.row, placed.course)
        found = columns(make_follower(placed.course, vehicle.rear_axle_m), placed.row, ticks)
        if "speed_error_mps" in found.columns:
            return LogDrive(found, placed.course, [*notes, placed.words], span(placed.row, ticks))
    row, words = _start_without(whole, reference.course, start_s)
    ticks = _ticks(whole, row, reference.course)
    found = columns(nobody(), row, ticks)
    notes += [words, "no INS frames with position and speed: nothing lateral can be had", ODOMETRY]
    return LogDrive(longitudinal_only(found, reference.course), reference.course, notes, span(row, ticks))


def refuse_jump(frames: Sequence[LogFrame], log: Path) -> None:
    """Raise InputError for a clock that jumps: the ticks between would be rows of the drive."""
    steps = np.diff([frame.time_s for frame in frames])
    if len(steps) and float(np.abs(steps).max()) > MOST_STEP_S:
        k = int(np.abs(steps).argmax())
        way = "back" if steps[k] < 0.0 else "ahead"
        raise clock_jump(abs(float(steps[k])), frames[k + 1].time_s, way, log)


def nobody() -> Block:
    """A follower that has nothing to say."""

    def init(params: Any, dt_s: float) -> None:
        return None

    def step(params: Any, state: Any, x: Any, dt_s: float) -> tuple[Any, Tracking]:
        return state, params

    return Block(init, step, Tracking())


def manual_s(frames: Sequence[LogFrame], codec: Codec, span_s: tuple[float, float]) -> float:
    """Seconds of a part of a log in which a report says that its by-wire channel is not enabled.

    0 where no report can say it. The source profiles rows in automatic mode only (apollo_facts 6.1).
    """
    telemetry, messages = set(codec.telemetry), {}
    off: dict[str, bool] = {}
    total_s = before_s = 0.0
    for frame in frames:
        key = (frame.can_id, frame.channel)
        if key not in messages:
            can_id, extended = frame.can_id & ~EXTENDED_BIT, bool(frame.can_id & EXTENDED_BIT)
            found = codec.find(CanFrame(can_id, b"", extended=extended))
            messages[key] = found if found in telemetry else None
        message = messages[key]
        enables = [state for state in message.states if state.condition == "enabled"] if message is not None else []
        if message is None or not enables or not codec.fits(message, frame.data):
            continue
        if any(off.values()):
            total_s += max(0.0, min(frame.time_s, span_s[1]) - max(before_s, span_s[0]))
        before_s, decoded = frame.time_s, codec.decode(message, frame.data)
        off[message.name] = any(decoded.get(state.signal) != state.active for state in enables)
    return total_s


def beside_of(folder: Path) -> Beside:
    """Compute times and the end of a drive of our own bench, from timing.npz and episode.json beside the log."""
    timing, summary = folder / "timing.npz", folder / "episode.json"
    control_time_s = None
    if timing.is_file():
        with np.load(timing, allow_pickle=False) as data:
            control_time_s = data.get("controller_control_time_s")
    if control_time_s is not None and len(control_time_s) == 0:
        control_time_s = None
    error = str(read_json(summary).get("error", "")) if summary.is_file() else None
    return Beside(control_time_s, error)


def _ticks(whole: Recording, row: int, course: Course) -> int:
    """Rows to keep: to the end of the plan or of the log."""
    left = min(course.ticks, whole.ticks - row)
    if row < 0 or left < 1:
        raise InputError(
            f"the log lasts {whole.ticks * whole.dt_s:.1f} s and the start is at {row * whole.dt_s:.1f} s",
            code="bad_start",
            key="--start-s",
            hint="give seconds from the log's first frame",
        )
    return left


def _start_without(whole: Recording, course: Course, start_s: float | None) -> tuple[int, str]:
    """Row and words of the start in a log without positions."""
    if start_s is not None:
        return round(start_s / whole.dt_s), f"started at {start_s:g} s of the log as asked for"
    speed = whole.get("speed_mps")
    return find_by_speed(np.full(whole.ticks, np.nan) if speed is None else speed, course, whole.dt_s)
