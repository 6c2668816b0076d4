"""ASAM MDF 4 bus logging, .mf4 (extra `mf4`): written through asammdf, read by python-can's reader.

python-can's writer counts its stamps from the moment of writing, which costs virtual times their last digits, and takes
a second for some thousand frames; so the three groups of the bus logging standard (data, error and remote frames) are
written here, each at once.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import can
import numpy as np
from asammdf import MDF, Signal, Source
from asammdf.blocks.utils import MdfException, count_channel_groups

from tunefree_hil.bus.formats.rows import (
    BRS,
    ERROR,
    ESI,
    EXTENDED_BIT,
    FD,
    ID_MASK,
    RTR,
    SENT,
    Format,
    Held,
    Row,
    channel_numbers,
    floor_ms,
    hold_numbered,
    row_of,
    unreadable,
)

HIGHEST_CHANNEL = 255
GROUPS = (("CAN_DataFrame", 0), ("CAN_ErrorFrame", ERROR), ("CAN_RemoteFrame", RTR))
DATES_FROM_S = 86400.0 * 365  # stamps below are no dates: the measurement then begins at 0
HEADER_AT, COMMENT_AT, LEAST_BYTES = 64, 128, 168  # header block, its link to a comment, its end
FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)  # by DLC


def read(path: Path) -> list[Row]:
    """Frames by time; those of one stamp in the order data, error, remote frames."""
    if not _has_header(path):
        raise unreadable(path, "MDF 4", EOFError("its header is not whole"))
    try:
        with path.open("rb") as file:
            count_channel_groups(
                file
            )  # raises where the chain of blocks is cut; the reader would complain on stderr, too
            file.seek(0)
            with can.MF4Reader(file) as reader:
                return [row_of(message) for message in reader]
    except (MdfException, struct.error, zlib.error, ValueError, KeyError, IndexError, OSError) as error:
        raise unreadable(path, "MDF 4", error) from error


def _has_header(path: Path) -> bool:
    """Whether the header block and its comment are there; without them asammdf complains on stderr, too."""
    with path.open("rb") as file:
        begin = file.read(LEAST_BYTES)
        if len(begin) < LEAST_BYTES or begin[:4] != b"MDF " or begin[HEADER_AT : HEADER_AT + 4] != b"##HD":
            return False
        (comment_at,) = struct.unpack_from("<Q", begin, COMMENT_AT)
        if not comment_at:
            return True
        file.seek(comment_at)
        head = file.read(16)
    return len(head) == 16 and comment_at + struct.unpack_from("<Q", head, 8)[0] <= path.stat().st_size


def write(path: Path, rows: Sequence[Row]) -> None:
    """Write rows that `hold` has given."""
    numbers = channel_numbers(rows)
    earliest_s = floor_ms(rows)
    base_s = earliest_s if earliest_s >= DATES_FROM_S else 0.0
    source = Source("", "", "", source_type=Source.SOURCE_BUS, bus_type=Source.BUS_TYPE_CAN)
    with MDF(version="4.10") as file:
        file.header.start_time = datetime.fromtimestamp(base_s, UTC)
        for name, kind in GROUPS:
            some = [row for row in rows if row.flags & (ERROR | RTR) == kind]
            if some:
                times = np.array([row.time_s - base_s for row in some])
                order = np.argsort(times, kind="stable")
                samples = _samples(name, some, numbers)[order]
                signal = Signal(name=name, samples=samples, timestamps=times[order], source=source)
                file.append(signal, acq_source=source, comment="CAN bus logging")
        file.save(path, overwrite=True, compression=2)


def _samples(name: str, rows: Sequence[Row], numbers: dict[str, int]) -> np.ndarray:
    """One record a frame, with the members' names of the standard."""
    fields = {
        "BusChannel": ("<u1", [numbers[row.channel] for row in rows]),
        "ID": ("<u4", [row.can_id & ID_MASK for row in rows]),
        "IDE": ("<u1", [bool(row.can_id & EXTENDED_BIT) for row in rows]),
        "DLC": ("<u1", [_dlc(row) for row in rows]),
        "DataLength": ("<u1", [len(row.data) for row in rows]),
        "Dir": ("<u1", [bool(row.flags & SENT) for row in rows]),
    }
    if name != "CAN_RemoteFrame":
        for member, bit in (("EDL", FD), ("BRS", BRS), ("ESI", ESI)):
            fields[member] = ("<u1", [bool(row.flags & bit) for row in rows])
    kinds = [(f"{name}.{member}", kind) for member, (kind, _) in fields.items()]
    with_data = name != "CAN_RemoteFrame"
    samples = np.zeros(len(rows), dtype=[*kinds, (f"{name}.DataBytes", "<u1", (64,))] if with_data else kinds)
    for member, (_, values) in fields.items():
        samples[f"{name}.{member}"] = values
    if with_data:
        padded = b"".join(row.data.ljust(64, b"\0") for row in rows)
        samples[f"{name}.DataBytes"] = np.frombuffer(padded, dtype=np.uint8).reshape(-1, 64)
    return samples


def _dlc(row: Row) -> int:
    """The length code: of a remote frame what it asks for."""
    if row.flags & RTR:
        return row.dlc
    return next(code for code, length in enumerate(FD_LENGTHS) if length >= len(row.data))


def hold(rows: Sequence[Row]) -> Held:
    """All frames, stamps (to the ns near 0) and directions are kept; channels are numbers."""
    return hold_numbered(rows, HIGHEST_CHANNEL)


FORMAT = Format("mf4", read, write, hold)
