"""Finds senders of a vehicle's ids that are no nodes of the bench; only the hub knows the sender of a frame.

A node is on both channels, by one connection or by two of one process; a tool that plays frames onto the vehicle's
channel is on that one only. Frames are counted, never held back.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from tunefree_hil.bus.tfhub.records import EFF_FLAG, EFF_MASK, ID, ID_AT, NO_DATA
from tunefree_hil.bus.tfhub.server.connections import Peer

VEHICLE, BENCH = "vehicle", "bench"
MOST = 1000  # pairs of member and id that are kept


class SenderCheck:
    """Counts frames with one of `ids` (EFF bit included) by sender; remote and error frames are none of them."""

    def __init__(self, ids: frozenset[int] = frozenset()) -> None:
        self.ids = ids
        self._seen: Counter[tuple[str, int, int]] = Counter()

    def watch(self, peers: Iterable[Peer], sender: Peer, chunk: bytes) -> None:
        """Look at FRAME records that a member has sent on the vehicle channel."""
        if sender.also or is_node(peers, sender):
            return
        offset, end = 0, len(chunk)
        while offset < end:
            can_id = ID.unpack_from(chunk, offset + ID_AT)[0]
            offset += chunk[offset] | chunk[offset + 1] << 8
            if can_id & NO_DATA:
                continue
            key = (sender.name, sender.pid, can_id & (EFF_FLAG | EFF_MASK))
            if key[2] in self.ids and (key in self._seen or len(self._seen) < MOST):
                self._seen[key] += 1

    def seen(self) -> list[dict[str, Any]]:
        """One entry for each member and id, the most frames first."""
        return [
            {"name": name, "pid": pid, "can_id": can_id, "count": count}
            for (name, pid, can_id), count in self._seen.most_common()
        ]


def is_node(peers: Iterable[Peer], sender: Peer) -> bool:
    """Whether a member's process is on the bench channel, too."""
    return any(one.role == "member" and BENCH in one.channels and one.pid == sender.pid for one in peers)
