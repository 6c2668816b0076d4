"""Both channels of a hub over one connection: half the wake-ups of two, which dominate a lockstep tick."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial

from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.error_frames import require_bus_on
from tunefree_hil.bus.tfhub.plugin import HubBus
from tunefree_hil.bus.tfhub.records import (
    EFF_MASK,
    ERR_FLAG,
    FRAME,
    RTR_FLAG,
    SECOND_FRAME,
    pack_frames,
    plain_frames,
    unpack_raw,
)
from tunefree_hil.bus.tfhub.server.connection import ConnectionGone

SEND_S = 10.0


def _nothing() -> None:
    """There is nothing to send."""


class HubPair:
    """A member on both channels. `receive(0)` reads the vehicle channel, `receive(1)` the bench channel."""

    def __init__(self, vehicle_address: str, *, name: str = "", stamps: bool = False) -> None:
        self._bus = HubBus(vehicle_address, role="member", name=name, stamps=stamps, both=True)
        self._connection = self._bus._connection
        self._frames: list[list[CanFrame]] = [[], []]  # by channel
        self.name = self._bus.name
        self.welcome = self._bus.welcome

    def send(self, vehicle: Sequence[CanFrame], bench: Sequence[CanFrame]) -> None:
        """Vehicle frames, then bench frames, in one write."""
        self.prepare(vehicle, bench)()

    def prepare(self, vehicle: Sequence[CanFrame], bench: Sequence[CanFrame]) -> Callable[[], None]:
        """The same in two steps: the records now, the write when the function that is returned is called."""
        data = pack_frames(vehicle) if vehicle else b""
        if bench:
            data += pack_frames(bench, SECOND_FRAME)
        return partial(self._bus._transmit, data, SEND_S) if data else _nothing

    def receive(self, channel: int, timeout_s: float) -> list[CanFrame]:
        """All that has arrived on a channel; waits up to timeout_s for the first. See link.BusLink.receive."""
        if self._frames[channel]:
            return self._take(channel)
        deadline_s = time.monotonic() + timeout_s
        rest_s = timeout_s
        while True:
            data = self._connection.fresh(rest_s)
            if data and not self._sort(data):
                self._connection.put_back(data)
            if not data or self._connection.buffer:
                self._one_by_one(rest_s if not data and self._connection.careful else 0.0)
            if self._frames[channel]:
                return self._take(channel)
            rest_s = deadline_s - time.monotonic()
            if rest_s <= 0.0:
                return []

    def close(self) -> None:
        """Leave the bus in good order."""
        self._bus.shutdown()

    def _take(self, channel: int) -> list[CanFrame]:
        frames, self._frames[channel] = self._frames[channel], []
        return frames

    def _sort(self, data: bytes) -> bool:
        """Sort whole records of classic data frames by channel; False, and nothing done, for other bytes."""
        frames = plain_frames(data)
        if frames is None:
            return False
        self._frames[0] += frames.own
        self._frames[1] += frames.second
        return True

    def _one_by_one(self, timeout_s: float) -> None:
        """The slow path: FD, error and remote frames, records of other types, an incomplete record."""
        connection = self._connection
        try:
            while connection.fill(timeout_s):
                timeout_s = 0.0
                kind, record = connection.kind(), connection.take()
                if kind not in (FRAME, SECOND_FRAME):
                    self._bus._control(record)
                    continue
                raw = unpack_raw(record)
                if raw.can_id & ERR_FLAG:
                    require_bus_on(raw.can_id & EFF_MASK, self._bus.channel_info)
                elif not raw.can_id & RTR_FLAG:
                    self._frames[kind == SECOND_FRAME].append(raw.data_frame())
        except ConnectionGone as error:
            raise self._bus._gone(error) from None
