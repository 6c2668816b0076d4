"""One recorded frame as every log format gives and takes it, and what a format cannot hold, counted.

python-can's `Message` is the go-between for the formats that python-can reads and writes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import can

from tunefree_hil.base.errors import InputError

FD, BRS, ESI, RTR, ERROR, SENT = 1, 2, 4, 8, 16, 32  # flags of a Row; the first five as in episode/candump.py
EXTENDED_BIT = 0x80000000
ID_MASK = 0x1FFFFFFF
TICK_S = 1e-6  # the stamps of two formats are the same when they differ by less
_CAN_NUMBER = re.compile(r"can(\d{1,5})")


class Row(NamedTuple):
    """One frame. can_id with the EFF bit (an error frame's: its class bits); flags as above; dlc of a remote frame."""

    time_s: float
    channel: str
    can_id: int
    data: bytes
    flags: int = 0
    dlc: int = 0


class Loss(NamedTuple):
    """What a format does not hold: how many frames it concerns, and what becomes of them in words."""

    frames: int
    what: str

    def __str__(self) -> str:
        return f"{self.frames} {'frame' if self.frames == 1 else 'frames'}: {self.what}"


class Held(NamedTuple):
    """The rows as a file of the format gives them back, and what was lost on the way."""

    rows: list[Row]
    losses: list[Loss]


class Format(NamedTuple):
    """read(path) -> rows in the file's order; write(path, rows) takes what `hold(rows)` has given."""

    name: str
    read: Callable[[Path], list[Row]]
    write: Callable[[Path, Sequence[Row]], None]
    hold: Callable[[Sequence[Row]], Held]


def channel_numbers(rows: Iterable[Row], first: int = 0) -> dict[str, int]:
    """A number for each channel name: can<N> is N, any other gets the lowest free number from `first` on."""
    names = list(dict.fromkeys(row.channel for row in rows))
    numbers = {name: int(match[1]) for name in names if (match := _CAN_NUMBER.fullmatch(name))}
    if len(set(numbers.values())) < len(numbers):  # can1 and can01
        numbers = {}
    for name in names:
        if name not in numbers:
            taken = set(numbers.values())
            numbers[name] = next(one for one in range(first, first + len(names) + 1) if one not in taken)
    return numbers


def hold_numbered(rows: Sequence[Row], highest: int) -> Held:
    """Channels as numbers up to `highest`: other names are read back as can<N>; a number above it is refused."""
    numbers = channel_numbers(rows)
    beyond = sorted(name for name, number in numbers.items() if number > highest)
    if beyond:
        raise InputError(
            f"channel {beyond[0]} has a number above {highest}, the format's highest",
            code="channel_number",
            key="--channel",
            hint="name the channels that you need: --channel can0",
        )
    renamed = {name: f"can{number}" for name, number in numbers.items() if name != f"can{number}"}
    kept = [row._replace(channel=renamed.get(row.channel, row.channel)) for row in rows] if renamed else list(rows)
    losses = [
        Loss(sum(row.channel == name for row in rows), f"channel {name} has a number only and is read back as {back}")
        for name, back in renamed.items()
    ]
    return Held(kept, losses)


def leave_out(rows: Iterable[Row], which: Callable[[Row], bool], what: str) -> Held:
    """Rows without those of which `which` is true."""
    rows = list(rows)
    kept = [row for row in rows if not which(row)]
    gone = len(rows) - len(kept)
    return Held(kept, [Loss(gone, what)] if gone else [])


def change(rows: Sequence[Row], changed: Callable[[Row], Row], what: str) -> Held:
    """Rows as `changed` makes them; counts those that it changes."""
    after = [changed(row) for row in rows]
    count = sum(a != b for a, b in zip(after, rows, strict=True))
    return Held(after, [Loss(count, what)] if count else [])


def floor_ms(rows: Iterable[Row]) -> float:
    """The earliest stamp, rounded down to a whole millisecond: what file headers hold as the begin of a measurement."""
    return math.floor(min(row.time_s for row in rows) * 1000.0) / 1000.0


def message_of(row: Row, channel: int) -> can.Message:
    """A Row as python-can's Message."""
    remote = bool(row.flags & RTR)
    return can.Message(
        timestamp=row.time_s,
        arbitration_id=row.can_id & ID_MASK,
        is_extended_id=bool(row.can_id & EXTENDED_BIT),
        is_remote_frame=remote,
        is_error_frame=bool(row.flags & ERROR),
        channel=channel,
        dlc=row.dlc if remote else len(row.data),
        data=None if remote else row.data,
        is_fd=bool(row.flags & FD),
        bitrate_switch=bool(row.flags & BRS),
        error_state_indicator=bool(row.flags & ESI),
        is_rx=not row.flags & SENT,
    )


def row_of(message: can.Message) -> Row:
    """python-can's Message as a Row. CAN FD has no remote frames: one that a reader makes of an empty frame is none."""
    remote = message.is_remote_frame and not message.is_fd
    flags = (FD if message.is_fd else 0) | (RTR if remote else 0) | (0 if message.is_rx else SENT)
    flags |= (BRS if message.bitrate_switch else 0) | (ESI if message.error_state_indicator else 0)
    can_id = message.arbitration_id
    if message.is_error_frame:
        flags |= ERROR
    elif message.is_extended_id:
        can_id |= EXTENDED_BIT
    channel = message.channel if isinstance(message.channel, str) else f"can{message.channel or 0}"
    data = b"" if remote else bytes(message.data)
    return Row(message.timestamp, channel, can_id, data, flags, message.dlc if remote else 0)


def unreadable(path: Path, what: str, error: BaseException) -> InputError:
    """A file that begins like the format and is not whole."""
    said = str(error) or type(error).__name__
    return InputError(
        f"cannot be read as {what}: {said}",
        code="broken_log",
        file=str(path),
        hint="is it cut off? copy it again, or export it anew",
    )
