"""Are two recordings of one bus the same? Ours beside `candump -L` of the link that it was made from.

Stamps may differ (lockstep's are virtual, in real time two programs read two queues), so they are not compared, nor are
channel names. The kernel hands each socket the frames of one sender in the order in which they were sent; how frames
of two senders on two processors interleave may differ by a few places between two sockets. So the frames of each id
must be the same in the same order, and exchanged neighbours of different ids are counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from tunefree_hil.episode.candump import EXTENDED_BIT, LogFrame


class SameFrames(NamedTuple):
    """difference: the first one in words, '' where there is none. exchanged: places at which the order differs."""

    frames: int
    difference: str
    exchanged: int


def same_frames(ours: Sequence[LogFrame], theirs: Sequence[LogFrame]) -> SameFrames:
    """Compare two recordings frame by frame, id by id."""
    difference = ""
    left, right = _by_id(ours), _by_id(theirs)
    for key in sorted(left.keys() | right.keys()):
        difference = _difference(_name(key), left.get(key, []), right.get(key, []))
        if difference:
            break
    pairs = zip(ours, theirs, strict=False)
    exchanged = 0 if difference else sum(_key(one) != _key(other) for one, other in pairs)
    return SameFrames(len(ours), difference, exchanged)


def _difference(name: str, ours: list[LogFrame], theirs: list[LogFrame]) -> str:
    for i, (one, other) in enumerate(zip(ours, theirs, strict=False)):
        if (one.data, one.flags) != (other.data, other.flags):
            return f"{name}, frame {i}: {_text(one)} here, {_text(other)} there"
    if len(ours) != len(theirs):
        return f"{name}: {len(ours)} frames here, {len(theirs)} there"
    return ""


def _by_id(frames: Sequence[LogFrame]) -> dict[tuple[int, int], list[LogFrame]]:
    found: dict[tuple[int, int], list[LogFrame]] = {}
    for frame in frames:
        found.setdefault(_key(frame), []).append(frame)
    return found


def _key(frame: LogFrame) -> tuple[int, int]:
    return frame.can_id, frame.flags & ~7  # remote and error frames of an id are others than its data frames


def _name(key: tuple[int, int]) -> str:
    return f"0x{key[0] & ~EXTENDED_BIT:X}{' (extended)' if key[0] & EXTENDED_BIT else ''}"


def _text(frame: LogFrame) -> str:
    return frame.data.hex().upper() or "no data"
