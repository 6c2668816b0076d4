"""Frames as SocketCAN carries them: struct can_frame, struct canfd_frame, struct can_filter (linux/can.h)."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.tfhub.records import BRS, EFF_FLAG, EFF_MASK, ESI, RTR_FLAG, SFF_MASK, Raw

CLASSIC_FRAME = struct.Struct("=IB3x8s")
FD_FRAME = struct.Struct("=IBB2x64s")
HEAD = struct.Struct("=IBB")
FILTER = struct.Struct("=II")


def pack(frame: CanFrame) -> bytes:
    """struct can_frame, or canfd_frame (with bit-rate switch), of a data frame. InputError where it does not fit."""
    can_id = frame.id | EFF_FLAG if frame.extended else frame.id
    if not 0 <= frame.id <= (EFF_MASK if frame.extended else SFF_MASK):
        raise InputError(f"id 0x{frame.id:X} does not fit {'an extended' if frame.extended else 'a standard'} frame")
    if len(frame.data) > (64 if frame.fd else 8):
        raise InputError(f"{len(frame.data)} bytes do not fit a {'CAN FD' if frame.fd else 'classic CAN'} frame")
    if frame.fd:
        return FD_FRAME.pack(can_id, len(frame.data), BRS, frame.data)
    return CLASSIC_FRAME.pack(can_id, len(frame.data), frame.data)


def unpack(data: bytes, time_ns: int) -> Raw:
    """A frame as the kernel hands it over."""
    can_id, length, flags = HEAD.unpack_from(data)
    fd = len(data) == FD_FRAME.size
    n_bytes = 0 if can_id & RTR_FLAG else length
    return Raw(can_id, data[8 : 8 + n_bytes], time_ns, fd, flags & (BRS | ESI) if fd else 0, length)


def pack_filters(ids: Sequence[int]) -> bytes:
    """struct can_filter for exactly these ids (EFF bit included), remote frames left out."""
    both = EFF_FLAG | RTR_FLAG
    masks = [both | (EFF_MASK if can_id & EFF_FLAG else SFF_MASK) for can_id in ids]
    return b"".join(FILTER.pack(can_id, mask) for can_id, mask in zip(ids, masks, strict=True))
