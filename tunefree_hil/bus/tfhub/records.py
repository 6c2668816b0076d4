"""The records between a hub and its peers, as bytes.

Every record starts with the same 20 bytes, little-endian: length u16 (of the whole record), type u8, sender u8 (index
that the hub gave; 0 = the hub), sequence u64 (one count over both channels), time u64 (ns). A FRAME record goes on with
the bytes of Linux' `struct can_frame` (16) or `struct canfd_frame` (72), so no flag of a frame is lost.
The other types carry JSON or nothing.
"""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Iterable
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import CanFrame

PROTOCOL = 1
TCP_BUFFER_BYTES = 1 << 17
CHANNELS = ("vehicle", "bench")
ENDPOINTS = {"vehicle": "veh", "bench": "bench"}  # channel -> last part of its address
LOG_NAMES = {"vehicle": "can0", "bench": "bench"}  # channel -> its default name in a log

# record types
FRAME, HELLO, WELCOME, REFUSED, BYE, PEER_GONE, DROPPED, REQUEST, REPLY, END = range(1, 11)
SECOND_FRAME = 11  # a frame of the channel that a joint connection carries beside its own

# struct can_frame: can_id u32, len u8, 3 bytes, 8 data bytes; canfd_frame: can_id u32, len u8, flags u8, 2, 64
HEAD = struct.Struct("<HBBQQ")
FRAME_HEAD = struct.Struct("<HBBQQIBB")
CLASSIC = struct.Struct("<HBBQQIB3x8s")
FD = struct.Struct("<HBBQQIBB2x64s")
SIZES, KINDS = (CLASSIC.size, FD.size), (FRAME, SECOND_FRAME)  # of the records of frames
STAMP = struct.Struct("<BQQ")  # sender, sequence, time; at STAMP_AT of a record
NUMBER = struct.Struct("<BQ")  # the same without time
KIND_AT = 2
STAMP_AT = 3
TIME_AT = 12
ID = struct.Struct("<I")
ID_AT = 20
LEN_AT = 24  # of the frame's length byte in a FRAME record
DATA_AT = 28

EFF_FLAG, RTR_FLAG, ERR_FLAG = 0x80000000, 0x40000000, 0x20000000
EFF_MASK, SFF_MASK = 0x1FFFFFFF, 0x7FF
NO_DATA = RTR_FLAG | ERR_FLAG  # a frame with one of these is never taken for data
NO_LENGTH = -1
BRS, ESI = 0x01, 0x02
NO_CLASS = 0x80  # bus error: what python-can writes for an error frame that names no class


class RecordError(ValueError):
    """Bytes that are no record."""


class Raw(NamedTuple):
    """One FRAME record, taken apart.

    `can_id` holds the EFF, RTR and ERR bits; `length` is the DLC of an RTR frame, NO_LENGTH: that of the data.
    """

    can_id: int
    data: bytes
    time_ns: int = 0
    fd: bool = False
    flags: int = 0
    length: int = NO_LENGTH
    sender: int = 0
    sequence: int = 0

    def data_frame(self) -> CanFrame:
        """The same as a data frame, with its stamp in seconds."""
        can_id = self.can_id
        return CanFrame(can_id & EFF_MASK, self.data, bool(can_id & EFF_FLAG), self.fd, self.time_ns / 1e9)


def small_buffers(sock: socket.socket) -> None:
    """Keep a TCP connection's buffers in the kernel small: frames wait in the hub, which counts them.

    Call it before the socket connects or listens.
    """
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, TCP_BUFFER_BYTES)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, TCP_BUFFER_BYTES)


def pack_control(kind: int, body: dict[str, Any] | None = None, *, sender: int = 0, sequence: int = 0) -> bytes:
    """A record that is no frame; `body` becomes JSON."""
    text = json.dumps(body).encode() if body is not None else b""
    if HEAD.size + len(text) > 0xFFFF:
        raise RecordError(f"a control record of {len(text)} bytes is too long")
    return HEAD.pack(HEAD.size + len(text), kind, sender, sequence, 0) + text


def body_of(record: bytes) -> dict[str, Any]:
    """The JSON object of a control record. RecordError when it is none."""
    try:
        body = json.loads(record[HEAD.size :] or b"{}")
    except (ValueError, RecursionError) as error:
        raise RecordError(f"a control record without JSON: {error}") from error
    if not isinstance(body, dict):
        raise RecordError("a control record whose JSON is no object")
    return body


def pack_raw(raw: Raw) -> bytes:
    """One FRAME record as a sender writes it. InputError for a frame that no CAN bus could carry."""
    can_id, fd = raw.can_id, raw.fd
    count = len(raw.data) if raw.length == NO_LENGTH else raw.length
    if not can_id & (EFF_FLAG | ERR_FLAG) and can_id & EFF_MASK > SFF_MASK:
        raise InputError(f"id 0x{can_id & EFF_MASK:X} does not fit a standard frame", hint="send it as extended")
    if count > (64 if fd else 8):
        raise InputError(f"{count} bytes do not fit a {'CAN FD' if fd else 'classic CAN'} frame")
    if fd:
        return FD.pack(FD.size, FRAME, 0, 0, raw.time_ns, can_id, count, raw.flags, raw.data)
    return CLASSIC.pack(CLASSIC.size, FRAME, 0, 0, raw.time_ns, can_id, count, raw.data)


def pack_frames(frames: Iterable[CanFrame], kind: int = FRAME) -> bytes:
    """FRAME (or SECOND_FRAME) records of data frames, time_s as ns. FD frames are sent with bit-rate switch."""
    parts = []
    pack, size, last_s, time_ns = CLASSIC.pack, CLASSIC.size, -1.0, 0
    for identifier, data, extended, fd, time_s in frames:
        if time_s != last_s:
            if not time_s >= 0.0:
                raise InputError(f"a frame's stamp is {time_s} s", hint="stamps begin at 0")
            last_s, time_ns = time_s, round(time_s * 1e9)
        if not 0 <= identifier <= EFF_MASK:
            raise InputError(f"{identifier:#x} is no CAN id", hint="ids have 11 bits, or 29 when extended")
        length = len(data)
        can_id = identifier | EFF_FLAG if extended else identifier
        if length <= 8 and not fd and (extended or identifier <= SFF_MASK):
            parts.append(pack(size, kind, 0, 0, time_ns, can_id, length, data))
            continue
        record = pack_raw(Raw(can_id, data, time_ns, fd, BRS if fd else 0))
        parts.append(record if kind == FRAME else mark_second_channel(record, 1))
    return b"".join(parts)


def mark_second_channel(records: bytes, count: int) -> bytes:
    """`count` FRAME records as SECOND_FRAME records."""
    marked = bytearray(records)
    if len(marked) == count * CLASSIC.size:
        marked[KIND_AT :: CLASSIC.size] = bytes([SECOND_FRAME]) * count
        return bytes(marked)
    offset = 0
    while offset < len(marked):
        marked[offset + KIND_AT] = SECOND_FRAME
        offset += marked[offset] | marked[offset + 1] << 8
    return bytes(marked)


def select_ids(records: bytes, count: int, ids: frozenset[int]) -> list[bytes]:
    """Those of `count` records that are frames with one of these ids (flag bits left out)."""
    selected, offset = [], 0
    for _ in range(count):
        end = offset + (records[offset] | records[offset + 1] << 8)
        if ID.unpack_from(records, offset + ID_AT)[0] & EFF_MASK in ids:
            selected.append(records[offset:end])
        offset = end
    return selected


class ChannelFrames(NamedTuple):
    """Data frames of a connection: those of its own channel, and of the one that a joint connection carries beside."""

    own: list[CanFrame]
    second: list[CanFrame]


def plain_frames(data: bytes) -> ChannelFrames | None:
    """The frames of `data` where it holds only whole records of data frames, else None."""
    if not data or len(data) % CLASSIC.size:
        return _frames_of_any_size(data)
    own: list[CanFrame] = []
    second: list[CanFrame] = []
    make = tuple.__new__  # half the time of CanFrame(...)
    whole, last_ns, time_s = CLASSIC.size, 0, 0.0
    for size, kind, _, _, time_ns, can_id, length, payload in CLASSIC.iter_unpack(data):
        if size != whole or (kind != FRAME and kind != SECOND_FRAME) or can_id & NO_DATA:
            return _frames_of_any_size(data)
        if time_ns != last_ns:
            last_ns, time_s = time_ns, time_ns / 1e9
        part = payload if length == 8 else payload[:length]
        frame = make(CanFrame, (can_id & EFF_MASK, part, can_id > EFF_MASK, False, time_s))
        (own if kind == FRAME else second).append(frame)
    return ChannelFrames(own, second)


def _frames_of_any_size(data: bytes) -> ChannelFrames | None:
    """`plain_frames` of classic and FD frames in any order."""
    frames = ChannelFrames([], [])
    offset, end = 0, len(data)
    while end - offset >= CLASSIC.size:
        size, kind, _, _, time_ns, can_id, length, _ = FRAME_HEAD.unpack_from(data, offset)
        is_data = size in SIZES and kind in KINDS and not can_id & NO_DATA
        if not is_data or size > end - offset:
            return None
        payload = data[offset + DATA_AT : offset + DATA_AT + length]
        frame = CanFrame(can_id & EFF_MASK, payload, can_id > EFF_MASK, size == FD.size, time_ns / 1e9)
        (frames.own if kind == FRAME else frames.second).append(frame)
        offset += size
    return frames if 0 < offset == end else None


def unpack_raw(buffer: bytes | bytearray | memoryview, offset: int = 0) -> Raw:
    """The FRAME record at `offset`."""
    size, _, sender, sequence, time_ns, can_id, length, flags = FRAME_HEAD.unpack_from(buffer, offset)
    fd = size == FD.size
    n_bytes = 0 if can_id & RTR_FLAG else length
    data = bytes(buffer[offset + DATA_AT : offset + DATA_AT + n_bytes])
    return Raw(can_id, data, time_ns, fd, flags if fd else 0, length, sender, sequence)
