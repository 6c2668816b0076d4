"""Reads the logs of a vehicle into drives on its tick grid, in any log format, decoded in columns piece by piece."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.message_map import EXTENDED_FLAG, MessageMap
from tunefree_hil.bus.formats.find import CANDUMP, format_of
from tunefree_hil.episode.candump import ERROR, RTR, cut_line
from tunefree_hil.episode.log_columns import Name, Piece, read_pieces
from tunefree_hil.episode.real_time import CUT_THERE, MOST_STEP_S, clock_jump, times_of
from tunefree_hil.learn.actuators.command_age import measure_command_ages
from tunefree_hil.learn.drives.decode import LATE_FRAME_S, LogStatistics, MessageDecoder, place_on_ticks
from tunefree_hil.learn.drives.drive import Array, Drive, LogSummary

ReadProgress = Callable[[float, str], None]  # the share of all logs read, 0 to 1, and the name of the current log
COMPRESSION_BY_MAGIC = {
    b"\x1f\x8b": "gzip",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"\xfd7zXZ": "xz",
    b"BZh": "bzip2",
    b"PK\x03\x04": "zip",
}


class TickOriginCriteria(NamedTuple):
    """When and where tick ends move to a time at which no message comes; every value is an engineering choice."""

    bins: int = 100  # of a tick, in which frames are counted
    neighbour_bins: int = 10  # to either side: the jitter of a message
    max_frames_at_end: float = 0.02  # in multiples of a message's frames; fewer at an end of a tick do no harm
    max_quiet_share: float = 0.5  # of the frames at the tick end, in the quietest bins; more: messages come at any time


class LateFrameCriteria(NamedTuple):
    """When so many frames are late that the stamps are probably not in seconds; engineering choices."""

    max_frames: int = 9  # late ones: more than LATE_FRAME_S after the frame before
    max_share: float = 0.01  # of all frames of the vehicle, that may be late


TICK_ORIGIN = TickOriginCriteria()
LATE_FRAMES = LateFrameCriteria()


def read_drives(logs: Sequence[Path], codec: Codec, *, progress: ReadProgress | None = None) -> list[Drive]:
    """Read one drive from each log, in the order given; each has its own clock, INS origin and heading.

    Ticks are those of episode/columns.py: a report in row k was received in tick k, a command was sent in it. Stamps in
    virtual time are ticks. In real time a bench.log beside the log gives tick 0, else the log's first frame (see
    choose_tick_origin), and a report stamped in tick k is received in k + 1. Corrupt and short frames are left out.
    By-wire control is enabled where every report with an `enabled` state shows it; without such a report, where none
    shows a disabling state ([state] of vehicle.toml).

    Raises:
        InputError: a log cannot be read, has no frame of the vehicle, or its clock jumps by more than MOST_STEP_S.
    """
    names = _shortest_names(logs)
    drives: list[Drive] = []
    for i, (path, name) in enumerate(zip(logs, names, strict=True)):

        def report_share(share: float, index: int = i, log: str = name) -> None:
            if progress is not None:
                progress((index + share) / len(logs), log)

        drives.append(_read_drive(Path(path), name, codec, report_share))
        report_share(1.0)
    return drives


def _shortest_names(logs: Sequence[Path]) -> list[str]:
    """For each log the shortest end of its path that distinguishes it from the others."""
    parts = [Path(path).parts for path in logs]
    max_depth = max((len(path_parts) for path_parts in parts), default=1)
    for depth in range(1, max_depth):
        names = ["/".join(path_parts[-depth:]) for path_parts in parts]
        if len(set(names)) == len(set(parts)):
            return names
    return [str(path) for path in logs]


def _read_drive(path: Path, name: str, codec: Codec, report_share: Callable[[float], None]) -> Drive:
    _refuse_compressed(path)
    dt_s = codec.tick_ms * 1e-3
    decoders = {message: MessageDecoder(message) for message in (*codec.telemetry, *codec.commands)}
    has_channels = codec.has_channels(channel for piece in read_pieces(path) for channel, _ in piece.names)
    statistics = LogStatistics()
    messages: dict[Name, MessageMap | None] = {}
    for piece in read_pieces(path):
        for frame_name in piece.names:
            if frame_name not in messages:
                messages[frame_name] = _find_message(codec, frame_name, has_channels)
        is_vehicle_frame = _decode_piece(piece, [messages[key] for key in piece.names], decoders, statistics)
        statistics.add_piece(piece, is_vehicle_frame, dt_s)
        report_share(piece.done)
    _refuse_unusable(path, codec, statistics)
    if not has_channels:
        _refuse_mixed_channels(path, messages)
    times = times_of(statistics.max_off_tick, statistics.first_s, statistics.earliest_s, dt_s, path.parent)
    zero_s = times.zero_s
    if times.by_frame:
        zero_s = choose_tick_origin((decoder.times_s for decoder in decoders.values()), dt_s, times.zero_s)
    grid = place_on_ticks(decoders.values(), dt_s, zero_s, times.late_ticks)
    summary = _summarise_log(path, decoders.values(), statistics)
    samples = {field: column for decoder in decoders.values() for field, column in decoder.field_samples().items()}
    ages = measure_command_ages(samples) if times.by_frame else {}
    return Drive(name, _hash_log(path), dt_s, grid.fields, grid.fresh, grid.enabled, summary, ages)


def _refuse_compressed(path: Path) -> None:
    """Refuse a compressed log. The reader of the format reports a missing file."""
    if not path.is_file():
        return
    with path.open("rb") as file:
        begin = file.read(8)
    kind = next((name for magic, name in COMPRESSION_BY_MAGIC.items() if begin.startswith(magic)), "")
    if kind:
        hint = "decompress it and name the decompressed file"
        raise InputError(f"the log is compressed ({kind})", code="packed_log", file=str(path), hint=hint)


def _find_message(codec: Codec, name: Name, has_channels: bool) -> MessageMap | None:
    channel, can_id = name
    frame = CanFrame(can_id & ~EXTENDED_FLAG, b"", extended=bool(can_id & EXTENDED_FLAG))
    return codec.find(frame, channel if has_channels else "")


def _decode_piece(
    piece: Piece,
    messages: Sequence[MessageMap | None],
    decoders: Mapping[MessageMap, MessageDecoder],
    statistics: LogStatistics,
) -> Array:
    """Give each decoder its frames of a piece. Returns which frames are the vehicle's, shape (n_frames,)."""
    is_data = (piece.flags & (RTR | ERROR)) == 0
    is_vehicle_frame = np.zeros(len(is_data), dtype=bool)
    rows_by_message: dict[MessageMap, Array] = {}
    for i, message in enumerate(messages):
        rows = (piece.name == i) & is_data
        if message is None:
            statistics.count_unknown_id(piece.names[i][1], int(rows.sum()))
        else:
            rows_by_message[message] = rows_by_message.get(message, False) | rows
            is_vehicle_frame |= rows
    for message, rows in rows_by_message.items():
        decoders[message].add_frames(piece.time_s[rows], piece.payloads.of(rows))
    return is_vehicle_frame


def _refuse_unusable(path: Path, codec: Codec, statistics: LogStatistics) -> None:
    """Refuse a log without frames of the vehicle, and one whose clock jumps."""
    if not statistics.vehicle_frames:
        ids = ", ".join(f"0x{can_id & ~EXTENDED_FLAG:X}" for can_id in sorted(statistics.unknown_ids)[:8]) or "none"
        raise InputError(
            f"the log holds not one frame of vehicle {codec.name!r} (ids in it: {ids})",
            code="foreign_log",
            file=str(path),
            hint="if the log is of another vehicle, name its folder with --vehicle",
        )
    backward_s, forward_s = statistics.max_backward_step_s, statistics.max_forward_step_s
    step_s, at_s = max((backward_s, statistics.backward_step_at_s), (forward_s, statistics.forward_step_at_s))
    if step_s > MOST_STEP_S:
        direction = "back" if backward_s >= forward_s else "ahead"
        hint = CUT_THERE
        late, total = statistics.late_frames, statistics.vehicle_frames
        if late > max(LATE_FRAMES.max_frames, LATE_FRAMES.max_share * total):
            hint = f"{late} of {total} frames come more than {LATE_FRAME_S:g} s after the frame before: if the stamps "
            hint += "are not in seconds, convert them"
        raise clock_jump(step_s, at_s, direction, path, hint)


def _refuse_mixed_channels(path: Path, messages: Mapping[Name, MessageMap | None]) -> None:
    """Refuse a log in which a message comes on several channels, none of which the vehicle folder names.

    With one channel the log may be of that bus; with several it is unknown which of them carries the message.
    """
    channels_by_message: dict[MessageMap, list[str]] = {}
    for (channel, _), message in messages.items():
        if message is not None and message.channel:
            channels_by_message.setdefault(message, []).append(channel)
    for message, channels in channels_by_message.items():
        if len(channels) > 1:
            raise InputError(
                f"{message.name} comes on {' and '.join(sorted(channels))}, but vehicle.toml has it on "
                f"{message.channel}",
                code="other_channels",
                file=str(path),
                key="channel",
                hint="use the same channel names in the log (`log convert` to candump) and in vehicle.toml",
            )


def _hash_log(path: Path) -> str:
    """SHA-256 of the log's bytes; of a folder (a ROS 2 bag) over its files in the order of their names."""
    digest = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
    return f"sha256:{digest.hexdigest()}"


def _summarise_log(path: Path, decoders: Iterable[MessageDecoder], statistics: LogStatistics) -> LogSummary:
    decoders = list(decoders)
    span_s = statistics.latest_s - statistics.earliest_s
    return LogSummary(
        file=str(path),
        frames=statistics.frames,
        frames_by_message={decoder.message.name: decoder.frames for decoder in decoders},
        short_frames={decoder.message.name: decoder.short_frames for decoder in decoders if decoder.short_frames},
        corrupt_frames={decoder.message.name: decoder.corrupt_frames for decoder in decoders if decoder.corrupt_frames},
        unknown_ids=dict(sorted(statistics.unknown_ids.items())),
        span_s=max(0.0, span_s) if math.isfinite(statistics.latest_s) else 0.0,
        max_backward_step_s=statistics.max_backward_step_s,
        backward_step_at_s=statistics.backward_step_at_s,
        max_forward_step_s=statistics.max_forward_step_s,
        forward_step_at_s=statistics.forward_step_at_s,
        is_truncated=not path.is_dir() and format_of(path) == CANDUMP and bool(cut_line(path)),
    )


def choose_tick_origin(times_s: Iterable[Array], dt_s: float, zero_s: float) -> float:
    """Move the origin of ticks by up to half a tick, so that few frames come near the end of a tick.

    A message that always comes half a tick after the origin would be rounded to either tick by its jitter, and would
    seem a whole tick later than another one of the same time. The origin is not moved where hardly any frame comes half
    a tick from it, or where frames come at any time. Else ticks end in the middle of the longest quiet stretch.

    Args:
        times_s: the stamps of each message; every message has the same weight.
        dt_s: length of a tick.
        zero_s: the origin to start from.
    """
    criteria = TICK_ORIGIN
    load = np.zeros(criteria.bins)
    for stamps in times_s:
        if len(stamps):
            phase = ((stamps - zero_s) / dt_s + 0.5) % 1.0
            bins = np.floor(phase * criteria.bins).astype(int) % criteria.bins
            load += np.bincount(bins, minlength=criteria.bins) / len(stamps)
    reach = criteria.neighbour_bins
    nearby = np.sum([np.roll(load, shift) for shift in range(-reach, reach + 1)], axis=0)
    if nearby[0] <= criteria.max_frames_at_end or nearby.min() > criteria.max_quiet_share * nearby[0]:
        return zero_s
    end = _middle_of_longest_run(nearby <= nearby.min() + criteria.max_frames_at_end)
    return zero_s + (end if end <= 0.5 else end - 1.0) * dt_s


def _middle_of_longest_run(is_quiet: Array) -> float:
    """The middle of the longest run of True in a circle of bins, as a share of the circle."""
    if is_quiet.all():
        return 0.0
    first = int(np.argmin(is_quiet))  # the circle is cut at a bin that is not quiet
    edges = np.diff(np.concatenate([[False], np.roll(is_quiet, -first), [False]]).astype(int))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    longest = int(np.argmax(ends - begins))
    return float((first + 0.5 * (begins[longest] + ends[longest])) / len(is_quiet) % 1.0)
