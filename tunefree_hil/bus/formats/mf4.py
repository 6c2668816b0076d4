"""ASAM MDF 4 bus logging, .mf4 (extra `mf4`), by asammdf: the standard's groups of data, error and remote frames.

Not by python-can's reader and writer: the writer counts its stamps from the moment of writing, which costs virtual
times their last digits, and the reader takes ten times as long. Here both go by blocks of BLOCK frames. A log whose
time runs backwards is held in memory as a whole to be written, for the groups are kept in the order of time.
"""

from __future__ import annotations

import heapq
import logging
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

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
    Row,
    Survey,
    floor_ms,
    hold_numbered,
    number_of,
    unreadable,
)
from tunefree_hil.bus.python_can import can

HIGHEST_CHANNEL = 255
KINDS = {"CAN_DataFrame": 0, "CAN_ErrorFrame": ERROR, "CAN_RemoteFrame": RTR}  # name of a group -> flag of its rows
BLOCK = 20_000  # frames that are read or written at once
DATES_FROM_S = 86400.0 * 365  # stamps below are no dates: the measurement then begins at 0
HEADER_AT, COMMENT_AT, LEAST_BYTES = 64, 128, 168  # header block, its link to a comment, its end
logging.getLogger("asammdf").setLevel(logging.CRITICAL + 1)  # it raises what it logs
_OPTIONS: dict[str, Any] = {"process_bus_logging": False}  # asammdf would decode it by DBCs inside the file
_FAULTS = (  # what asammdf raises over broken files
    MdfException,
    struct.error,
    zlib.error,
    ValueError,
    LookupError,
    TypeError,
    OverflowError,
    MemoryError,
    EOFError,
    OSError,
)


def read(path: Path) -> Iterator[Row]:
    """Frames by time; those of one stamp in the order of the groups (here: data, error, remote frames)."""
    try:
        with path.open("rb") as file:
            _refuse_headless(file, path.stat().st_size)
            count_channel_groups(file)  # raises where the chain of blocks is cut; MDF would complain on stderr, too
            file.seek(0)
            with MDF(file, **_OPTIONS) as mdf:
                groups = [_group(mdf, index, name) for index, name in _groups_of(mdf)]
                yield from heapq.merge(*groups, key=lambda row: row.time_s)
    except Exception as error:
        if isinstance(error, _FAULTS) or type(error).__module__ == "igzip_lib":  # its error has no other class
            raise unreadable(path, "MDF 4", error) from error
        raise


def _refuse_headless(file: BinaryIO, size: int) -> None:
    """Raise EOFError unless the header block and its comment are there; MDF would complain on stderr, too."""
    begin = file.read(LEAST_BYTES)
    whole = len(begin) == LEAST_BYTES and begin[:4] == b"MDF " and begin[HEADER_AT : HEADER_AT + 4] == b"##HD"
    (comment_at,) = struct.unpack_from("<Q", begin, COMMENT_AT) if whole else (0,)
    if comment_at:
        file.seek(comment_at)
        head = file.read(16)
        whole = len(head) == 16 and comment_at + struct.unpack_from("<Q", head, 8)[0] <= size
    if not whole:
        raise EOFError("its header is not whole")
    file.seek(0)


def _groups_of(file: Any) -> list[tuple[int, str]]:
    """(index, kind) of the groups with frames of a CAN bus."""
    groups = []
    for index, group in enumerate(file.groups):
        source = group.channel_group.acq_source
        if source is None or source.bus_type != Source.BUS_TYPE_CAN or not group.channel_group.cycles_nr:
            continue
        names = {channel.name for channel in group.channels}
        kinds = [(index, name) for name in KINDS if name in names]
        if kinds:
            _refuse_outside(group)
        groups += kinds
    return groups


def _refuse_outside(group: Any) -> None:
    """Raise ValueError where a channel lies outside its record: asammdf would read foreign memory."""
    size = group.channel_group.samples_byte_nr + group.channel_group.invalidation_bytes_nr
    for channel in group.channels:
        if 8 * channel.byte_offset + channel.bit_offset + channel.bit_count > 8 * size:
            raise ValueError(f"{channel.name} lies outside its record of {size} bytes")


def _group(file: Any, index: int, name: str) -> Iterator[Row]:
    base_s = file.header.start_time.timestamp()
    count = file.groups[index].channel_group.cycles_nr
    for first in range(0, count, BLOCK):
        block = file.get(name, index, record_offset=first, record_count=BLOCK, raw=False)
        if len(block.samples) != min(BLOCK, count - first):
            raise ValueError(f"{name} has fewer than its {count} records")
        yield from _rows(name, block.samples, (block.timestamps + base_s).tolist())


def _rows(name: str, samples: np.ndarray, times_s: Sequence[float]) -> Iterator[Row]:
    """The frames of one block. Members that a recorder left out are 0."""
    member = {one.removeprefix(f"{name}."): samples[one] for one in samples.dtype.names or ()}
    kind, none = KINDS[name], np.zeros(len(samples), dtype=np.uint32)
    flags = none + np.uint32(kind) + SENT * _sent(member.get("Dir", none))
    for key, bit in (("EDL", FD), ("BRS", BRS), ("ESI", ESI)):
        flags = flags + bit * (member.get(key, none) != 0) if kind != RTR else flags
    ids = member.get("ID", none).astype(np.uint32) & ID_MASK
    if kind != ERROR:
        ids = ids + EXTENDED_BIT * (member.get("IDE", none) != 0).astype(np.uint32)
    dlc = (member["DLC"] if kind == RTR else none).tolist()
    channels = [f"can{number}" for number in member.get("BusChannel", none).tolist()]
    return map(Row, times_s, channels, ids.tolist(), _payloads(member, kind, len(samples)), flags.tolist(), dlc)


def _sent(directions: np.ndarray) -> np.ndarray:
    """1 where a frame was sent: recorders write the direction as a number or as a word."""
    if directions.dtype.kind in "SU":
        directions = np.char.lower(directions.astype("U2")) == "tx"
    return (directions != 0).astype(np.uint32)


def _payloads(member: dict[str, np.ndarray], kind: int, count: int) -> list[bytes]:
    if kind == RTR or not {"DataBytes", "DataLength"} <= member.keys():
        return [b""] * count
    data = np.ascontiguousarray(member["DataBytes"], dtype=np.uint8).reshape(count, -1)
    whole, width = data.tobytes(), data.shape[1]
    lengths = member["DataLength"].tolist()
    return [whole[k * width : k * width + min(length, width)] for k, length in enumerate(lengths)]


def write(path: Path, rows: Iterable[Row], seen: Survey) -> None:
    """Write rows that `FORMAT.hold` has given."""
    earliest_s = floor_ms(seen.earliest_s)
    base_s = earliest_s if earliest_s >= DATES_FROM_S else 0.0
    source = Source("", "", "", source_type=Source.SOURCE_BUS, bus_type=Source.BUS_TYPE_CAN)
    groups: dict[str, int] = {}
    with MDF(version="4.10") as file:
        file.header.start_time = datetime.fromtimestamp(base_s, UTC)
        for block in _blocks(rows, seen):
            for name, kind in KINDS.items():
                chosen = [row for row in block if row.flags & (ERROR | RTR) == kind]
                if not chosen:
                    continue
                times, samples = np.array([row.time_s - base_s for row in chosen]), _samples(name, chosen)
                if name in groups:
                    file.extend(groups[name], [(times, None), (samples, None)])
                else:
                    groups[name] = len(groups)
                    signal = Signal(name=name, samples=samples, timestamps=times, source=source)
                    file.append(signal, acq_source=source, comment="CAN bus logging")
        file.save(path, overwrite=True, compression=2)


def _blocks(rows: Iterable[Row], seen: Survey) -> Iterator[list[Row]]:
    """BLOCK rows at a time; all at once and sorted where time runs backwards."""
    if seen.backwards:
        rows = sorted(rows, key=lambda row: row.time_s)
    block: list[Row] = []
    for row in rows:
        block.append(row)
        if len(block) == BLOCK:
            yield block
            block = []
    yield block


def _samples(name: str, rows: Sequence[Row]) -> np.ndarray:
    """One record a frame, with the members' names of the standard."""
    fields: dict[str, tuple[str, Sequence[int]]] = {
        "BusChannel": ("<u1", [number_of(row) for row in rows]),
        "ID": ("<u4", [row.can_id & ID_MASK for row in rows]),
        "IDE": ("<u1", [bool(row.can_id & EXTENDED_BIT) for row in rows]),
        "DLC": ("<u1", [row.dlc if row.flags & RTR else can.util.len2dlc(len(row.data)) for row in rows]),
        "DataLength": ("<u1", [len(row.data) for row in rows]),
        "Dir": ("<u1", [bool(row.flags & SENT) for row in rows]),
    }
    with_data = name != "CAN_RemoteFrame"
    if with_data:
        for member, bit in (("EDL", FD), ("BRS", BRS), ("ESI", ESI)):
            fields[member] = ("<u1", [bool(row.flags & bit) for row in rows])
    kinds = [(f"{name}.{member}", kind) for member, (kind, _) in fields.items()]
    samples = np.zeros(len(rows), dtype=[*kinds, (f"{name}.DataBytes", "<u1", (64,))] if with_data else kinds)
    for member, (_, values) in fields.items():
        samples[f"{name}.{member}"] = values
    if with_data:
        padded = b"".join(row.data.ljust(64, b"\0") for row in rows)
        samples[f"{name}.DataBytes"] = np.frombuffer(padded, dtype=np.uint8).reshape(-1, 64)
    return samples


# All frames, stamps (to the ns near 0) and directions are kept; channels are numbers.
FORMAT = Format("mf4", read, write, partial(hold_numbered, highest=HIGHEST_CHANNEL))
