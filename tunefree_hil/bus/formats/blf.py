"""Vector's binary log, .blf, by python-can's reader and writer.

python-can drops the base of stamps that are no dates (below the year 1990) and cuts those before the first frame to it;
so the writer is given its base here: 0 for such stamps, else the earliest one.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.rows import (
    Format,
    Row,
    Survey,
    floor_ms,
    hold_numbered,
    row_of,
    unreadable,
    write_messages,
)
from tunefree_hil.bus.python_can import can

DATES_FROM_S = 631152000.0  # 1990: python-can takes a stamp from here on for a date
HIGHEST_CHANNEL = 65534
LEAST_BYTES = 144  # of the file's header


def read(path: Path) -> Iterator[Row]:
    """Frames in the file's order. InputError for a file that is cut off or no BLF at all."""
    size = path.stat().st_size
    if size < LEAST_BYTES:
        raise unreadable(path, "BLF", EOFError(f"{size} bytes are less than its header"))
    try:
        with path.open("rb") as file, can.BLFReader(file) as reader:
            if reader.file_size > size:
                raise InputError(
                    f"cut off: {size} of {reader.file_size} bytes are there",
                    code="truncated_log",
                    file=str(path),
                    hint="copy it again",
                )
            yield from map(row_of, reader)
    except (can.io.blf.BLFParseError, struct.error, zlib.error, ValueError, EOFError) as error:
        raise unreadable(path, "BLF", error) from error


def write(path: Path, rows: Iterable[Row], seen: Survey) -> None:
    """Write rows that `FORMAT.hold` has given."""
    base_s = floor_ms(seen.earliest_s)
    with can.BLFWriter(path) as writer:
        writer.start_timestamp = base_s if base_s >= DATES_FROM_S else 0.0
        write_messages(writer, rows)


# All frames, stamps and directions are kept; channels are numbers.
FORMAT = Format("blf", read, write, partial(hold_numbered, highest=HIGHEST_CHANNEL))
