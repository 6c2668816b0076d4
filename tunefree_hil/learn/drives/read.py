"""Logs of a vehicle -> Drives: any format, our own runs' or a car's; decoded in columns, a piece at a time.

Where a tick ends in a recording of real time: where the fewest frames come, so that none falls now here, now there.

A message that always comes half a tick after the log's first frame, give or take a tenth of a millisecond, would be
rounded to either tick by chance; and of two that come together, one would be said to be a whole tick late.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.message_map import EXTENDED_FLAG, MessageMap
from tunefree_hil.bus.formats.find import CANDUMP, format_of
from tunefree_hil.episode.candump import ERROR, RTR, cut_line
from tunefree_hil.episode.log_columns import Name, Piece, read_pieces
from tunefree_hil.episode.real_time import CUT_THERE, MOST_STEP_S, clock_jump, times_of
from tunefree_hil.learn.actuators.command_age import command_ages
from tunefree_hil.learn.drives.decode import SLOW_S, Ear, Seen, place
from tunefree_hil.learn.drives.drive import Drive, Reading

Progress = Callable[[float, str], None]  # share of all logs read, 0 to 1; the log at hand
MOST_SLOW, SLOW_SHARE = 9, 0.01  # so many and such a share of frames this late: other units, and no jump of the clock
PACKED = {b"\x1f\x8b": "gzip", b"\x28\xb5\x2f\xfd": "zstd", b"\xfd7zXZ": "xz", b"BZh": "bzip2", b"PK\x03\x04": "zip"}


def read_drives(logs: Sequence[Path], codec: Codec, *, progress: Progress | None = None) -> list[Drive]:
    """One Drive a log, in the order given; each with the clock, INS origin and heading of its own.

    Ticks as episode/columns.py gives them: a report field in row k is what was heard in tick k, a command field what
    was sent in it. Stamps of virtual time are ticks; in real time tick 0 is where a bench.log beside the log says,
    else at the log's first frame, or up to half a tick off it (learn/drives/read.py), and a report stamped in tick k is
    heard in k + 1. Frames that nobody believes (a CRC that does not fit) or that are too short are left out. enabled:
    every report that says `enabled` says so; without one, none that says what disables ([state] of vehicle.toml).

    Raises InputError for a log that cannot be read, that holds no frame of the vehicle, or whose clock jumps by more
    than MOST_STEP_S.
    """
    names = _called(logs)
    drives: list[Drive] = []
    for place_in_line, path in enumerate(logs):

        def tell(share: float, before: int = place_in_line, name: str = names[place_in_line]) -> None:
            if progress is not None:
                progress((before + share) / len(logs), name)

        drives.append(_read(Path(path), names[place_in_line], codec, tell))
        tell(1.0)
    return drives


def _called(logs: Sequence[Path]) -> list[str]:
    """Each log by as much of its path's end as tells it from the others."""
    parts = [Path(path).parts for path in logs]
    longest = max((len(one) for one in parts), default=1)
    for depth in range(1, longest):
        names = ["/".join(one[-depth:]) for one in parts]
        if len(set(names)) == len(set(parts)):
            return names
    return [str(path) for path in logs]


def _read(path: Path, name: str, codec: Codec, tell: Callable[[float], None]) -> Drive:
    _refuse_packed(path)
    ears = {message: Ear(message) for message in (*codec.telemetry, *codec.commands)}
    apart = codec.has_channels(channel for piece in read_pieces(path) for channel, _ in piece.names)
    seen = Seen()
    messages: dict[Name, MessageMap | None] = {}
    for piece in read_pieces(path):
        for one in piece.names:
            if one not in messages:
                messages[one] = _find(codec, one, apart)
        known = _hear(piece, [messages[one] for one in piece.names], ears, seen)
        seen.take(piece, known, codec.tick_ms * 1e-3)
        tell(piece.done)
    _refuse(path, codec, seen)
    if not apart:
        _refuse_mixed(path, messages)
    dt_s = codec.tick_ms * 1e-3
    times = times_of(seen.off_grid, seen.first_s, seen.earliest_s, dt_s, path.parent)
    zero_s = even_zero((ear.times_s for ear in ears.values()), dt_s, times.zero_s) if times.by_frame else times.zero_s
    grid = place(ears.values(), dt_s, zero_s, times.late_ticks)
    reading = _reading(path, ears.values(), seen, times.words)
    heard = {field: column for ear in ears.values() for field, column in ear.columns().items()}
    ages = command_ages(heard) if times.by_frame else {}
    return Drive(name, _hash(path), dt_s, grid.fields, grid.fresh, grid.enabled, reading, ages)


def _refuse_packed(path: Path) -> None:
    """By how it begins; what is not there or empty its reader says."""
    if not path.is_file():
        return
    with path.open("rb") as file:
        begin = file.read(8)
    kind = next((name for start, name in PACKED.items() if begin.startswith(start)), "")
    if kind:
        hint = "unpack it, and name what comes out"
        raise InputError(f"it is compressed ({kind})", code="packed_log", file=str(path), hint=hint)


def _find(codec: Codec, name: Name, apart: bool) -> MessageMap | None:
    channel, can_id = name
    bare = CanFrame(can_id & ~EXTENDED_FLAG, b"", extended=bool(can_id & EXTENDED_FLAG))
    return codec.find(bare, channel if apart else "")


def _hear(
    piece: Piece, messages: Sequence[MessageMap | None], ears: Mapping[MessageMap, Ear], seen: Seen
) -> np.ndarray:
    """Give each message its frames; which frames of the piece are the vehicle's, bool [n]."""
    data = (piece.flags & (RTR | ERROR)) == 0
    known = np.zeros(len(data), dtype=bool)
    by_message: dict[MessageMap, np.ndarray] = {}
    for number, message in enumerate(messages):
        rows = (piece.name == number) & data
        if message is None:
            seen.count_foreign(piece.names[number][1], int(rows.sum()))
        else:
            by_message[message] = by_message.get(message, False) | rows
            known |= rows
    for message, rows in by_message.items():
        ears[message].hear(piece.time_s[rows], piece.payloads.of(rows))
    return known


def _refuse(path: Path, codec: Codec, seen: Seen) -> None:
    """What no tick grid can be made of."""
    if not seen.known:
        ids = ", ".join(f"0x{can_id & ~EXTENDED_FLAG:X}" for can_id in sorted(seen.foreign)[:8]) or "none"
        raise InputError(
            f"the log holds not one frame of vehicle {codec.name!r} (ids in it: {ids})",
            code="foreign_log",
            file=str(path),
            hint="is it a log of this vehicle? --vehicle names another folder",
        )
    step_s, at_s = max((seen.back_s, seen.back_at_s), (seen.ahead_s, seen.ahead_at_s))
    if step_s > MOST_STEP_S:
        way = "back" if seen.back_s >= seen.ahead_s else "ahead"
        hint = CUT_THERE
        if seen.slow > max(MOST_SLOW, SLOW_SHARE * seen.known):
            hint = f"is the clock in seconds? {seen.slow} of {seen.known} frames come more than {SLOW_S:g} s after the "
            hint += "one before; write the stamps in seconds"
        raise clock_jump(step_s, at_s, way, path, hint)


def _refuse_mixed(path: Path, messages: Mapping[Name, MessageMap | None]) -> None:
    """Of a folder whose messages have channels a log with other names of them: one alone may be that bus, several that
    carry the same id cannot be told apart.
    """
    heard: dict[MessageMap, list[str]] = {}
    for (channel, _), message in messages.items():
        if message is not None and message.channel:
            heard.setdefault(message, []).append(channel)
    for message, channels in heard.items():
        if len(channels) > 1:
            where = " and ".join(sorted(channels))
            raise InputError(
                f"{message.name} comes on {where}, and the vehicle has it on {message.channel}",
                code="other_channels",
                file=str(path),
                key="channel",
                hint="name the channels as vehicle.toml does, in the log (`log convert` to candump) or in vehicle.toml",
            )


def _hash(path: Path) -> str:
    """SHA-256 over the log's bytes; of a folder (a ROS 2 bag) over its files in the order of their names."""
    digest = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as opened:
                while block := opened.read(1 << 20):
                    digest.update(block)
    return f"sha256:{digest.hexdigest()}"


def _reading(path: Path, ears: Iterable[Ear], seen: Seen, words: str) -> Reading:
    ears = list(ears)
    cut = not path.is_dir() and format_of(path) == CANDUMP and bool(cut_line(path))
    return Reading(
        file=str(path),
        frames=seen.frames,
        heard={ear.message.name: ear.frames for ear in ears},
        short={ear.message.name: ear.short for ear in ears if ear.short},
        broken={ear.message.name: ear.broken for ear in ears if ear.broken},
        foreign=dict(sorted(seen.foreign.items())),
        span_s=max(0.0, seen.latest_s - seen.earliest_s) if math.isfinite(seen.latest_s) else 0.0,
        back_s=seen.back_s,
        back_at_s=seen.back_at_s,
        ahead_s=seen.ahead_s,
        ahead_at_s=seen.ahead_at_s,
        times=words,
        cut=cut,
    )


Array = np.ndarray

BINS = 100  # of a tick
NEAR = 10  # bins to either side that count as the place itself: as much as frames come sooner or later by
WORTH = 0.5  # of the frames at the end of a tick: where no place has fewer, messages come at any time
SOME = 0.02  # of a message's frames: fewer at an end of a tick are no harm


def even_zero(times_s: Iterable[Array], dt_s: float, zero_s: float) -> float:
    """zero_s, or up to half a tick off it. times_s: stamps of each message; each counts alike, however often it comes.

    It stays where hardly any frame comes half a tick from it, and where as many come everywhere. Else ticks end in the
    middle of the longest stretch of a tick in which the fewest come.
    """
    load = np.zeros(BINS)
    for one in times_s:
        if len(one):
            at = np.floor(((one - zero_s) / dt_s + 0.5) % 1.0 * BINS).astype(int) % BINS
            load += np.bincount(at, minlength=BINS) / len(one)
    near = np.sum([np.roll(load, by) for by in range(-NEAR, NEAR + 1)], axis=0)
    if near[0] <= SOME or near.min() > WORTH * near[0]:
        return zero_s
    end = _middle(near <= near.min() + SOME)
    return zero_s + (end if end <= 0.5 else end - 1.0) * dt_s


def _middle(free: Array) -> float:
    """Of the longest run of a circle of bins, as a share of the circle."""
    if free.all():
        return 0.0
    first = int(np.argmin(free))  # the circle is cut where it is not free
    edges = np.diff(np.concatenate([[False], np.roll(free, -first), [False]]).astype(int))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    longest = int(np.argmax(ends - begins))
    return float((first + 0.5 * (begins[longest] + ends[longest])) / len(free) % 1.0)
