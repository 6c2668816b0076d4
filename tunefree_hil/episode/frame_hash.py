"""The frame hash of an episode (docs/reference/bench_channel.md): two drives are the same when it is the same."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Collection, Iterable
from typing import NamedTuple

from tunefree_hil.episode.candump import ERROR, RTR, LogFrame

ECU_PHASE, CONTROLLER_PHASE = 0, 1
_HEAD = struct.Struct("<IBBIBB")  # k, phase, channel, id, flags, len


class FrameHash(NamedTuple):
    """hex: SHA-256. Frames that are not the vehicle's, and error frames, are counted (by id), not hashed."""

    hex: str
    frames: int
    foreign: dict[int, int]
    errors: int


class PlacedFrame(NamedTuple):
    """A frame with its place in the episode; sorted as in the hash: tick, phase, SocketCAN id, sequence."""

    k: int
    phase: int
    can_id: int
    sequence: int
    frame: LogFrame


class Placed(NamedTuple):
    """frames: in the order of the hash; foreign: frames that are not the vehicle's, by id; errors: error frames."""

    frames: list[PlacedFrame]
    foreign: dict[int, int]
    errors: int


def place_frames(
    frames: Iterable[LogFrame],
    tick_s: float,
    command_ids: Collection[int],
    vehicle_ids: Collection[int],
    *,
    zero_s: float = 0.0,
) -> Placed:
    """Put an episode's frames in order.

    `command_ids` (phase 1) and `vehicle_ids` (all of the vehicle's; the rest is phase 0) hold SocketCAN ids
    (EFF bit included), as the codec's `by_id` does.
    k = round((time - zero_s) / tick_s); frames before k = 0 belong to no tick and are left out.
    """
    commands, known = frozenset(command_ids), frozenset(vehicle_ids) | frozenset(command_ids)
    placed: list[PlacedFrame] = []
    foreign: dict[int, int] = {}
    errors = 0
    make = tuple.__new__  # a third of the time of a named tuple's constructor
    for sequence, frame in enumerate(frames):
        can_id = frame.can_id
        if frame.flags & ERROR:
            errors += 1
        elif can_id not in known or frame.flags & RTR:  # nodes of this vehicle send no remote frames
            foreign[can_id] = foreign.get(can_id, 0) + 1
        else:
            k = round((frame.time_s - zero_s) / tick_s)
            if k >= 0:
                phase = CONTROLLER_PHASE if can_id in commands else ECU_PHASE
                placed.append(make(PlacedFrame, (k, phase, can_id, sequence, frame)))
    placed.sort()
    return Placed(placed, foreign, errors)


def frame_hash(
    frames: Iterable[LogFrame],
    tick_s: float,
    command_ids: Collection[int],
    vehicle_ids: Collection[int],
    *,
    zero_s: float = 0.0,
) -> FrameHash:
    """SHA-256 over the vehicle's frames of one episode; arguments as `place_frames`."""
    return hash_of(place_frames(frames, tick_s, command_ids, vehicle_ids, zero_s=zero_s))


def hash_of(placed: Placed) -> FrameHash:
    """SHA-256 over ordered frames."""
    digest = hashlib.sha256(b"".join([pack(item) for item in placed.frames]))
    return FrameHash(digest.hexdigest(), len(placed.frames), placed.foreign, placed.errors)


def pack(item: PlacedFrame) -> bytes:
    """`k u32, phase u8, channel u8 (0), id u32 (with the EFF bit), flags u8, len u8 (bytes), data`, little-endian."""
    frame = item.frame
    return _HEAD.pack(item.k, item.phase, 0, item.can_id, frame.flags & 15, len(frame.data)) + frame.data
