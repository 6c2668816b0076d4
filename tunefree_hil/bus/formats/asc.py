"""Vector's text log, .asc, by python-can's reader and writer.

Three things are set right here: the writer's header has milliseconds without leading zeros and takes the first frame's
stamp for the earliest; the reader takes an empty CAN FD frame for a remote one (rows.row_of) and ignores that stamps
may be relative to the line before, which is refused. The begin in the header is local time, as the format has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import can

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.rows import (
    ERROR,
    Format,
    Held,
    Loss,
    Row,
    change,
    channel_numbers,
    floor_ms,
    hold_numbered,
    message_of,
    row_of,
    unreadable,
)

HIGHEST_CHANNEL = 254


class _Writer(can.ASCWriter):
    """python-can's, with the begin of the measurement given."""

    def __init__(self, path: Path, base_s: float) -> None:
        self._base_s = base_s
        super().__init__(path)
        self.file.write(f"Begin Triggerblock {self._begin()}\n")
        self.header_written = True
        self.started = self.last_timestamp = base_s
        self.log_event("Start of measurement", base_s)

    def _begin(self) -> str:
        when = datetime.fromtimestamp(self._base_s)
        return when.strftime(f"%a %b %d %H:%M:%S.{round(when.microsecond / 1000):03d} %Y")

    def _format_header_datetime(self, dt: datetime) -> str:
        return self._begin()


def read(path: Path) -> list[Row]:
    """Frames in the file's order; error frames have no class here."""
    try:
        with path.open(encoding="utf-8") as file, can.ASCReader(file, relative_timestamp=False) as reader:
            rows = [row_of(message) for message in reader]
            relative = reader.timestamps_format == "relative"
    except (ValueError, IndexError, UnicodeDecodeError) as error:
        raise unreadable(path, "ASC", error) from error
    if relative:
        raise InputError(
            "its stamps are relative to the line before, which cannot be summed up where lines are of another kind",
            code="relative_stamps",
            file=str(path),
            hint="export it with absolute time stamps",
        )
    return rows


def write(path: Path, rows: Sequence[Row]) -> None:
    """Write rows that `hold` has given."""
    numbers = channel_numbers(rows)
    with _Writer(path, floor_ms(rows)) as writer:
        for row in rows:
            writer.on_message_received(message_of(row, numbers[row.channel]))


def hold(rows: Sequence[Row]) -> Held:
    """Error frames lose class, data and direction; stamps are kept to the microsecond, channels as numbers."""
    numbered = hold_numbered(rows, HIGHEST_CHANNEL)
    bare = change(
        numbered.rows,
        lambda row: row._replace(can_id=0, data=b"", flags=ERROR) if row.flags & ERROR else row,
        "an error frame is kept without its class, its data and its direction",
    )
    losses: list[Loss] = [*numbered.losses, *bare.losses]
    return Held(bare.rows, losses)


FORMAT = Format("asc", read, write, hold)
