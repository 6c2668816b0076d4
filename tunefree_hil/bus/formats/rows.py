"""One recorded frame, common to all log formats, and counts of what a format cannot store.

Rows of the formats that python-can reads and writes are converted from and to its `Message`.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.python_can import can

FD, BRS, ESI, RTR, ERROR, SENT = 1, 2, 4, 8, 16, 32  # flags of a Row; the first five as in episode/candump.py
EXTENDED_BIT = 0x80000000
ID_MASK = 0x1FFFFFFF
TICK_S = 1e-6  # the stamps of two formats are the same when they differ by less
LONGEST_LINE = 4096  # bytes read from the end of a text
EXACT_S = 2e-9  # a stamp that differs more from its microsecond (and from double precision) needs nine decimals
_CAN_NUMBER = re.compile(r"can(\d{1,5})")


class Row(NamedTuple):
    """One frame. can_id with the EFF bit (an error frame's: its class bits); flags as above; dlc of a remote frame."""

    time_s: float
    channel: str
    can_id: int
    data: bytes
    flags: int = 0
    dlc: int = 0


class FormatLoss(NamedTuple):
    """What a format cannot store: how many frames it concerns, and what becomes of them."""

    frames: int
    text: str

    def __str__(self) -> str:
        return f"{self.frames} {'frame' if self.frames == 1 else 'frames'}: {self.text}"


class Survey(NamedTuple):
    """Facts about all rows that a writer needs before the first: a log is read once for them, never kept as a whole.

    channels: name -> frames, in the order of their first. earliest_s: inf for no row. backwards: stamps before the one
    in front of them. sent: a row has that flag. micro: no stamp is finer than a microsecond.
    """

    channels: dict[str, int]
    earliest_s: float
    backwards: int
    sent: bool
    micro: bool

    @property
    def frames(self) -> int:
        """How many rows there are."""
        return sum(self.channels.values())


class Lost(Counter[str]):
    """What becomes of frames that a format cannot store -> how many. `left_out`: frames that are not written at all."""

    left_out = 0


class Format(NamedTuple):
    """read(path) -> rows in the file's order, one by one; write(path, rows, survey) takes what `hold` has given.

    hold(rows, survey, lost) -> the rows as a file of the format gives them back; counts in `lost` what it cannot store.
    """

    name: str
    read: Callable[[Path], Iterator[Row]]
    write: Callable[[Path, Iterable[Row], Survey], None]
    hold: Callable[[Iterable[Row], Survey, Lost], Iterable[Row]]


def survey(rows: Iterable[Row]) -> Survey:
    """Go through all rows once."""
    channels: Counter[str] = Counter()
    earliest_s, before_s = math.inf, -math.inf
    backwards, flags, micro = 0, 0, True
    for row in rows:
        time_s = row[0]
        channels[row[1]] += 1
        flags |= row[4]
        backwards += time_s < before_s
        before_s = time_s
        earliest_s = min(earliest_s, time_s)
        micro = micro and is_micro(time_s)
    return Survey(dict(channels), earliest_s, backwards, bool(flags & SENT), micro)


def is_micro(time_s: float) -> bool:
    """Whether six decimals keep all digits that a double has of this stamp."""
    return abs(time_s - round(time_s, 6)) <= max(EXACT_S, math.ulp(time_s))


def channel_numbers(names: Iterable[str]) -> dict[str, int]:
    """A number for each channel name: can<N> is N, any other gets the lowest free number."""
    names = list(names)
    numbers = {name: int(match[1]) for name in names if (match := _CAN_NUMBER.fullmatch(name))}
    if len(set(numbers.values())) < len(numbers):  # can1 and can01
        numbers = {}
    for name in names:
        if name not in numbers:
            taken = set(numbers.values())
            numbers[name] = next(one for one in range(len(names) + 1) if one not in taken)
    return numbers


def number_of(row: Row) -> int:
    """The number of a row's channel, which hold_numbered has named can<number>."""
    return int(row.channel[3:])


def hold_numbered(rows: Iterable[Row], seen: Survey, lost: Lost, highest: int) -> Iterable[Row]:
    """For formats whose channels are numbers up to `highest`: names become can<number>, directions are kept.

    Raises InputError where there is a higher number.
    """
    numbers = channel_numbers(seen.channels)
    beyond = sorted(name for name, number in numbers.items() if number > highest)
    if beyond:
        raise InputError(
            f"channel {beyond[0]} has a number above {highest}, the format's highest",
            code="channel_number",
            key="--channel",
            hint="name the channels that you need: --channel can0",
        )
    renamed = {name: f"can{number}" for name, number in numbers.items() if name != f"can{number}"}
    for name, back in renamed.items():
        lost[f"channel {name} has a number only and is read back as {back}"] += seen.channels[name]
    if not renamed:
        return rows
    return (row._replace(channel=renamed.get(row.channel, row.channel)) for row in rows)


def leave_out(rows: Iterable[Row], which: Callable[[Row], bool], text: str, lost: Lost) -> Iterator[Row]:
    """Rows without those for which `which` is true; counts them."""
    for row in rows:
        if which(row):
            lost[text] += 1
            lost.left_out += 1
        else:
            yield row


def change(rows: Iterable[Row], changed: Callable[[Row], Row], text: str, lost: Lost) -> Iterator[Row]:
    """Rows as `changed` makes them; counts those that it changes."""
    for row in rows:
        after = changed(row)
        if after is not row and after != row:
            lost[text] += 1
        yield after


def floor_ms(time_s: float) -> float:
    """Rounded down to a whole millisecond: the begin of a measurement in file headers."""
    return math.floor(time_s * 1000.0) / 1000.0


def write_messages(writer: can.Listener, rows: Iterable[Row]) -> None:
    """Write rows, whose channels hold_numbered has named, by a writer of python-can."""
    for row in rows:
        writer.on_message_received(message_of(row))


def message_of(row: Row) -> can.Message:
    """A Row, whose channel hold_numbered has named, as python-can's Message."""
    remote = bool(row.flags & RTR)
    return can.Message(
        timestamp=row.time_s,
        arbitration_id=row.can_id & ID_MASK,
        is_extended_id=bool(row.can_id & EXTENDED_BIT),
        is_remote_frame=remote,
        is_error_frame=bool(row.flags & ERROR),
        channel=number_of(row),
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


def refuse_cut(path: Path) -> None:
    """Raise InputError for a text whose last line has no end: its rest may read as another frame."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(0, size - LONGEST_LINE))
        tail = file.read()
    if tail and not tail.endswith(b"\n"):
        rest = tail.rpartition(b"\n")[2][:60].decode("ascii", "replace")
        raise InputError(
            f"the log is cut off in its last line: {rest!r}",
            code="truncated_log",
            file=str(path),
            hint="delete the last line to use what is before it; if it is whole, end it with a line feed",
        )


def unreadable(path: Path, format_title: str, error: BaseException) -> InputError:
    """The error for a file that begins like the format and is damaged."""
    reason = str(error) or type(error).__name__
    return InputError(
        f"cannot be read as {format_title}: {reason}",
        code="broken_log",
        file=str(path),
        hint="is it cut off? copy it again, or export it anew",
    )
