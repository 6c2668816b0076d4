"""Vector's text log, .asc, by python-can's reader and writer.

Four things are corrected here: the writer's header has milliseconds without leading zeros and takes the first frame's
stamp for the earliest; the reader takes an empty CAN FD frame for a remote one (rows.row_of), does not know its header
behind a byte order mark, and ignores that stamps may be relative to the line before, which is refused. The begin in the
header is local time, as the format has it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import datetime
from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.rows import (
    ERROR,
    Format,
    Lost,
    Row,
    Survey,
    change,
    floor_ms,
    hold_numbered,
    refuse_cut,
    row_of,
    unreadable,
    write_messages,
)
from tunefree_hil.bus.python_can import can

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


def read(path: Path) -> Iterator[Row]:
    """Frames in the file's order; error frames have no class here."""
    refuse_cut(path)
    try:
        with path.open(encoding="utf-8-sig") as file, can.ASCReader(file, relative_timestamp=False) as reader:
            for message in reader:
                if reader.timestamps_format == "relative":
                    raise _relative(path)
                yield row_of(message)
    except (ValueError, IndexError, UnicodeDecodeError) as error:
        raise unreadable(path, "ASC", error) from error


def _relative(path: Path) -> InputError:
    return InputError(
        "its stamps are relative to the line before, which cannot be summed up where lines are of another kind",
        code="relative_stamps",
        file=str(path),
        hint="export it with absolute time stamps",
    )


def write(path: Path, rows: Iterable[Row], seen: Survey) -> None:
    """Write rows that `hold` has given."""
    with _Writer(path, floor_ms(seen.earliest_s)) as writer:
        write_messages(writer, rows)


def hold(rows: Iterable[Row], seen: Survey, lost: Lost) -> Iterable[Row]:
    """Error frames lose class, data and direction; stamps are kept to the microsecond, channels as numbers."""
    return change(
        hold_numbered(rows, seen, lost, HIGHEST_CHANNEL),
        lambda row: row._replace(can_id=0, data=b"", flags=ERROR) if row.flags & ERROR else row,
        "an error frame is kept without its class, its data and its direction",
        lost,
    )


FORMAT = Format("asc", read, write, hold)
