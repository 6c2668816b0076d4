"""What a node holds of a bus: a BusLink, which hides the kind of the bus."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from typing import NamedTuple, Protocol

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.error_frames import require_bus_on
from tunefree_hil.bus.python_can import can
from tunefree_hil.bus.tfhub.pair import HubPair
from tunefree_hil.bus.tfhub.plugin import HubBus

SEND_S = 10.0  # how long a send may wait while another member blocks the bus
MOST_AT_ONCE = 4096  # frames of one receive of a foreign bus, so that a flood cannot keep it for ever


class BusLink(Protocol):
    """One channel of one bus.

    `time_s` of a received frame is its stamp: virtual time on a hub with the clock 'sender' (and where members stamp on
    a virtual bus), else CLOCK_MONOTONIC seconds. Error frames and remote frames are never handed over as data.
    `refused`: the frames of the last send that a full queue did not take, where a late frame is worse than none
    (SocketCAN in real time).
    """

    @property
    def name(self) -> str: ...

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

    def __init__(self, bus: HubBus) -> None:
        self.name = bus.name
        self._bus = bus

    def send(self, frames: Sequence[CanFrame]) -> None:
        """See BusLink."""
        self._bus.send_frames(frames, SEND_S)

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """See BusLink."""
        return self._bus.recv_frames(timeout_s)

    def fileno(self) -> int:
        """The socket, to wait on."""
        return self._bus.fileno()

    def close(self) -> None:
        """See BusLink."""
        self._bus.shutdown()


class PairLink:
    """One channel of a HubPair as a BusLink."""

    refused: Sequence[CanFrame] = ()

    def __init__(self, pair: HubPair, channel: int) -> None:
        self.name = pair.name
        self._pair = pair
        self._channel = channel

    def send(self, frames: Sequence[CanFrame]) -> None:
        """See BusLink."""
        if self._channel == 0:
            self._pair.send(frames, ())
        else:
            self._pair.send((), frames)

    def receive(self, timeout_s: float) -> list[CanFrame]:
        """See BusLink."""
        return self._pair.receive(self._channel, timeout_s)

    def close(self) -> None:
        """See BusLink; closes both."""
        self._pair.close()


Sending = Callable[[], None]


class Links(NamedTuple):
    """Both channels of a node.

    `prepare(vehicle, bench)` makes ready what can be before the moment to send; the function that it gives sends the
    vehicle's frames first, in as few writes as can be.
    """

    vehicle: BusLink
    bench: BusLink
    prepare: Callable[[Sequence[CanFrame], Sequence[CanFrame]], Sending]

    def send_both(self, vehicle: Sequence[CanFrame], bench: Sequence[CanFrame]) -> None:
        """Send at once."""
        self.prepare(vehicle, bench)()

    def close(self) -> None:
        """Leave both."""
        self.vehicle.close()
        self.bench.close()


def separate_links(vehicle: BusLink, bench: BusLink) -> Links:
    """Two links that share no connection."""

    def send_both(vehicle_frames: Sequence[CanFrame], bench_frames: Sequence[CanFrame]) -> None:
        if vehicle_frames:
            vehicle.send(vehicle_frames)
        if bench_frames:
            bench.send(bench_frames)

    return Links(vehicle, bench, partial(partial, send_both))


class CanLink:
    """A BusLink over any other bus of python-can. `keeps_stamps`: the bus carries the senders' own stamps."""

    refused: Sequence[CanFrame] = ()

    def __init__(self, bus: can.BusABC, name: str, *, may_send: bool, keeps_stamps: bool = False) -> None:
        self.name = name
        self._bus = bus
        self._may_send = may_send
        self._keeps_stamps = keeps_stamps

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
            bitrate_switch=frame.fd,
            check=True,
        )

    def _sort(self, message: can.Message, frames: list[CanFrame]) -> None:
        if message.is_error_frame:
            require_bus_on(message.arbitration_id, self._bus.channel_info)
        elif not message.is_remote_frame:
            data = bytes(message.data)
            extended = message.is_extended_id
            frames.append(CanFrame(message.arbitration_id, data, extended, message.is_fd, message.timestamp))
