"""From a log to columns (docs/reference/files.md): from vehicle frames and the scenario only, so the log of a real
car gives the same ones.

The errors come from the reference follower, run on the INS frames exactly as in the controller.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from tunefree_hil.base.course import Tracking
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block
from tunefree_hil.base.records import GROUPS, NAN, CanFrame, Command, Ins, Report
from tunefree_hil.bus.dbc.codec import Codec, MessageMap
from tunefree_hil.bus.dbc.e2e import is_intact
from tunefree_hil.episode.candump import EXTENDED_BIT, RTR, LogFrame
from tunefree_hil.episode.frame_hash import CONTROLLER_PHASE, Placed, place_frames
from tunefree_hil.episode.recording import COMMAND_COLUMNS, REFERENCE_COLUMNS, Recording, make_recording

Array = np.ndarray

# column -> record field; the second is used where the vehicle lacks the first
SOURCES: dict[str, tuple[str, ...]] = {
    "out_throttle_frac": ("report.throttle_frac",),
    "out_brake_frac": ("report.brake_frac",),
    "out_steer_rad": ("report.steer_rad",),
    "speed_mps": ("report.speed_mps", "ins.speed_mps"),
    "accel_mps2": ("report.accel_mps2", "ins.accel_mps2"),
    "lateral_accel_mps2": ("report.lateral_accel_mps2",),
    "yaw_rate_radps": ("report.yaw_rate_radps", "ins.yaw_rate_radps"),
    "x_m": ("ins.x_m",),
    "y_m": ("ins.y_m",),
    "heading_rad": ("ins.heading_rad",),
}
_TRACKING_COLUMNS = (*REFERENCE_COLUMNS, "replan")


def columns_from_frames(
    frames: Iterable[LogFrame],
    codec: Codec,
    follower: Block,
    dt_s: float,
    *,
    ticks: int = 0,
    zero_s: float = 0.0,
    late_ticks: int = 0,
    by_channel: bool = False,
) -> Recording:
    """The columns of one drive.

    Row k holds the chassis and INS records received in phase 0 of tick k, the command of phase 1 of tick k (both
    held until the next frame), and the output of `follower`, x = (tick, Ins) -> Tracking. Values not received yet are
    NaN; a column without any value is absent.

    ticks: rows; 0 for as many as the log has. zero_s: time stamp of tick 0. late_ticks: by how many ticks a vehicle's
    frame is stamped before the tick that uses it: 0 in lockstep, 1 in real time, where cycle k uses what came before
    its deadline. by_channel: the log's channel names are those of vehicle.toml, and distinguish equal ids.
    Raises InputError for a log without one frame of the vehicle.
    """
    placed = place_vehicle(frames, codec, dt_s, zero_s)
    return columns_from_placed(placed, codec, follower, dt_s, ticks=ticks, late_ticks=late_ticks, by_channel=by_channel)


def place_vehicle(frames: Iterable[LogFrame], codec: Codec, dt_s: float, zero_s: float = 0.0) -> Placed:
    """A vehicle's frames in the order of the frame hash."""
    commands = {message.key for message in codec.commands}
    return place_frames(frames, dt_s, commands, codec.by_id.keys(), zero_s=zero_s)


def columns_from_placed(
    placed: Placed,
    codec: Codec,
    follower: Block,
    dt_s: float,
    *,
    ticks: int = 0,
    late_ticks: int = 0,
    by_channel: bool = False,
) -> Recording:
    """As columns_from_frames, for frames ordered by `place_vehicle`."""
    buckets = _buckets(placed, codec, late_ticks)
    rows = ticks or max(k for k, _ in buckets) + 1
    latest = _LatestValues(codec, by_channel)
    held_rows = latest.rows
    reports, fixes, commands, trackings = [], [], [], []
    step, params = follower.step, follower.params
    state = follower.init(params, dt_s)
    for k in range(rows):
        latest.update(buckets.get((k, 0), ()))
        reports.append(tuple(held_rows["report"]))
        fix = Ins._make(held_rows["ins"])
        fixes.append(fix)
        latest.update(buckets.get((k, 1), ()))
        commands.append(tuple(held_rows["command"]))
        state, tracking = step(params, state, (k, fix), dt_s)
        trackings.append(tracking)
    return assemble_columns(reports, fixes, commands, trackings, dt_s)


class _LatestValues:
    """The latest value of each field, by record group. A payload that did not change is not decoded again."""

    def __init__(self, codec: Codec, by_channel: bool) -> None:
        self.rows = {group: [NAN] * len(record._fields) for group, record in GROUPS.items()}
        self._codec = codec
        self._by_channel = by_channel
        self._messages: dict[tuple[int, str], MessageMap | None] = {}
        self._payloads: dict[MessageMap, bytes] = {}

    def update(self, frames: Sequence[LogFrame]) -> None:
        """Decode the frames of one phase of one tick."""
        codec, messages, payloads = self._codec, self._messages, self._payloads
        for frame in frames:
            key = (frame.can_id, frame.channel)
            message = messages[key] if key in messages else self._find(key)
            if message is None or payloads.get(message) == frame.data or not message.fits(frame.data):
                continue
            if message.e2e is not None and not is_intact(message.e2e, frame.data[: message.length]):
                continue  # a corrupted frame is rejected
            payloads[message] = frame.data
            for group, index, value in codec.values(message, codec.decode(message, frame.data)):
                self.rows[group][index] = value

    def _find(self, key: tuple[int, str]) -> MessageMap | None:
        """The message of (can_id, channel), cached."""
        can_id, channel = key
        bare = CanFrame(can_id & ~EXTENDED_BIT, b"", extended=bool(can_id & EXTENDED_BIT))
        self._messages[key] = self._codec.find(bare, channel if self._by_channel else "")
        return self._messages[key]


def _buckets(placed: Placed, codec: Codec, late_ticks: int) -> dict[tuple[int, int], list[LogFrame]]:
    """(tick that uses it, phase) -> frames in (id, sequence) order."""
    if not placed.frames:
        ids = ", ".join(f"0x{number:X}" for number in sorted(placed.foreign)[:8]) or "none"
        raise InputError(
            f"the log holds not one frame of vehicle {codec.name!r} (ids in it: {ids})",
            code="foreign_log",
            hint="is it a log of this vehicle?",
        )
    buckets: dict[tuple[int, int], list[LogFrame]] = {}
    for item in placed.frames:
        if not item.frame.flags & RTR:
            k = item.k if item.phase == CONTROLLER_PHASE else item.k + late_ticks
            buckets.setdefault((k, item.phase), []).append(item.frame)
    return buckets


def assemble_columns(
    reports: Sequence[Sequence[float]],
    fixes: Sequence[Sequence[float]],
    commands: Sequence[Sequence[float]],
    trackings: Sequence[Tracking],
    dt_s: float,
) -> Recording:
    """The columns of records held tick by tick (Report, Ins, Command, Tracking): one of each a row."""
    tables: dict[str, tuple[Any, Array]] = {
        "report": (Report, np.array(reports)),
        "ins": (Ins, np.array(fixes)),
        "cmd": (Command, np.array(commands)),
        "ref": (Tracking, np.array(trackings)),
    }

    def column(group: str, name: str) -> Array:
        record, values = tables[group]
        return values[:, record._fields.index(name)].copy()

    columns = {name: column("ref", name) for name in _TRACKING_COLUMNS}
    columns |= {name: column("cmd", name.removeprefix("cmd_")) for name in COMMAND_COLUMNS}
    instead = {}
    for name, sources in SOURCES.items():
        for source in sources:
            columns[name] = column(*source.split("."))
            if not np.isnan(columns[name]).all():
                if source != sources[0]:
                    instead[name] = source
                break
    if np.isnan(columns["x_m"]).all():
        del columns["replan"]  # no re-plan can be known
    return make_recording(columns, dt_s, instead)
