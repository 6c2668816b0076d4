"""What a node holds of a bus: a BusLink, which hides the kind of the bus."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import NamedTuple, Protocol

from tunefree_hil.base.errors import BenchError, InputError, NoAnswer
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.error_frames import note_error
from tunefree_hil.bus.python_can import can
from tunefree_hil.bus.tfhub.owner import HubStats, Owner, PeerStats
from tunefree_hil.bus.tfhub.pair import HubPair
from tunefree_hil.bus.tfhub.plugin import HubBus
from tunefree_hil.bus.tfhub.records import EFF_MASK

SEND_S = 10.0  # how long a send may wait while another member blocks the bus
MOST_AT_ONCE = 4096  # frames of one receive of a foreign bus, so that a flood cannot keep it for ever


class BusLink(Protocol):
    """One channel of one bus.

    `time_s` of a received frame is its stamp: virtual time on a hub with the clock 'sender' (and where members stamp on
    a virtual bus), else CLOCK_MONOTONIC seconds. `errors` counts error frames by name (error_frames.py),
    `remote_frames` the remote frames of foreign tools; neither is ever handed over as data. `refused`: the frames of
    the last send that a full queue did not take, where a late frame is worse than none (SocketCAN in real time).
    """

    @property
    def name(self) -> str: ...

    @property
    def errors(self) -> Counter[str]: ...

    @property
    def remote_frames(self) -> int: ...

    @property
    def refused(self) -> Sequence[CanFrame]: ...

    def send(self, frames: Sequence[CanFrame]) -> None:
        """In this order; one write where the bus allows it. BenchError when the bus is gone or does not take them."""

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """All that has arrived, in the bus's order; waits up to timeout_s for the first; [] on time-out.

        PeerGone when a member is lost (once for each), BenchError when the bus is gone or off.
        """
        ...

    def close(self) -> None:
        """Leave the bus in good order."""


class HubLink:
    """A BusLink over a hub's fast path."""

    refused: Sequence[CanFrame] = ()

    def __init__(self, bus: HubBus, brs: bool = True) -> None:
        self.name = bus.name
        self.errors: Counter[str] = Counter()
        self._bus = bus
        self._brs = brs

    @property
    def remote_frames(self) -> int:
        """Remote frames seen so far."""
        return self._bus.remote_frames

    @property
    def dropped(self) -> int:
        """Frames that this observer did not get; 0 for a member."""
        return self._bus.dropped

    def send(self, frames: Sequence[CanFrame]) -> None:
        """See BusLink."""
        try:
            self._bus.send_frames(frames, SEND_S, self._brs)
        except can.CanTimeoutError as error:
            raise NoAnswer(str(error), code="bus_held") from None

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """See BusLink."""
        frames = self._bus.recv_frames(timeout_s)
        if self._bus.error_frames:
            latest, self._bus.error_frames = self._bus.error_frames, []
            for raw in latest:
                note_error(self.errors, raw.can_id & EFF_MASK, raw.data, self._bus.channel_info)
        return frames

    def close(self) -> None:
        """See BusLink."""
        self._bus.shutdown()


class PairLink:
    """One channel of a HubPair as a BusLink."""

    refused: Sequence[CanFrame] = ()

    def __init__(self, pair: HubPair, channel: int) -> None:
        self.name = pair.name
        self.errors: Counter[str] = Counter()
        self._pair = pair
        self._channel = channel

    @property
    def remote_frames(self) -> int:
        """Remote frames seen so far."""
        return self._pair.remote_frames[self._channel]

    def send(self, frames: Sequence[CanFrame]) -> None:
        """See BusLink."""
        vehicle, bench = (frames, ()) if self._channel == 0 else ((), frames)
        try:
            self._pair.send(vehicle, bench)
        except can.CanTimeoutError as error:
            raise NoAnswer(str(error), code="bus_held") from None

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """See BusLink."""
        frames = self._pair.receive(self._channel, timeout_s)
        if self._pair.error_frames:
            latest, self._pair.error_frames = self._pair.error_frames, []
            for raw in latest:
                note_error(self.errors, raw.can_id & EFF_MASK, raw.data, self._pair.info)
        return frames

    def close(self) -> None:
        """See BusLink; closes both."""
        self._pair.close()


class Links(NamedTuple):
    """Both channels of a node. `send_both(vehicle, bench)`: the vehicle's frames first, in as few writes as can be."""

    vehicle: BusLink
    bench: BusLink
    send_both: Callable[[Sequence[CanFrame], Sequence[CanFrame]], None]

    def close(self) -> None:
        """Leave both."""
        self.vehicle.close()
        self.bench.close()


class CanLink:
    """A BusLink over any other bus of python-can. `keeps_stamps`: the bus carries the senders' own stamps."""

    refused: Sequence[CanFrame] = ()

    def __init__(
        self, bus: can.BusABC, name: str, *, may_send: bool, keeps_stamps: bool = False, brs: bool = True
    ) -> None:
        self.name = name
        self.errors: Counter[str] = Counter()
        self.remote_frames = 0
        self._bus = bus
        self._may_send = may_send
        self._keeps_stamps = keeps_stamps
        self._brs = brs

    def send(self, frames: Sequence[CanFrame]) -> None:
        """See BusLink. InputError on a link that was opened to listen."""
        if not self._may_send:
            raise InputError(f"{self.name} only listens to {self._bus.channel_info}", code="observer", key="role")
        try:
            for frame in frames:
                self._bus.send(self._message(frame), SEND_S)
        except (can.CanError, OSError) as error:
            raise BenchError(
                f"{self._bus.channel_info} did not take a frame: {error}",
                code="bus_error",
                hint="is the link up? with 'no buffer space': ip link set dev NAME txqueuelen 1000",
            ) from error

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """See BusLink."""
        frames: list[CanFrame] = []
        deadline_s = time.monotonic() + timeout_s
        try:
            message = self._bus.recv(timeout_s)
            while message is not None and len(frames) < MOST_AT_ONCE:
                self._sort(message, frames)
                rest_s = 0.0 if frames else max(0.0, deadline_s - time.monotonic())
                message = self._bus.recv(rest_s)
            if message is not None:
                self._sort(message, frames)
        except (can.CanError, OSError) as error:
            raise BenchError(f"{self._bus.channel_info} is gone: {error}", code="bus_error") from error
        if self._keeps_stamps or not frames:
            return frames
        # measured each time, so that a step of the wall clock moves no more than the frames that wait at that moment
        offset_s = datetime.now(UTC).timestamp() - time.monotonic()
        return [frame._replace(time_s=frame.time_s - offset_s) for frame in frames]

    def close(self) -> None:
        """See BusLink."""
        self._bus.shutdown()

    def _message(self, frame: CanFrame) -> can.Message:
        return can.Message(
            timestamp=frame.time_s,
            arbitration_id=frame.id,
            is_extended_id=frame.extended,
            data=frame.data,
            is_fd=frame.fd,
            bitrate_switch=frame.fd and self._brs,
            check=True,
        )

    def _sort(self, message: can.Message, frames: list[CanFrame]) -> None:
        if message.is_error_frame:
            note_error(self.errors, message.arbitration_id, bytes(message.data), self._bus.channel_info)
        elif message.is_remote_frame:
            self.remote_frames += 1
        else:
            data = bytes(message.data)
            extended = message.is_extended_id
            frames.append(CanFrame(message.arbitration_id, data, extended, message.is_fd, message.timestamp))


__all__ = ["BusLink", "CanLink", "HubLink", "HubStats", "Links", "Owner", "PairLink", "PeerStats"]
