"""`HubBus`: python-can's interface `tfhub`, and the fast path of our own nodes.

    python -m can.logger -i tfhub -c default/veh             an observer: sees all, cannot stall the bus
    python -m can.player -i tfhub -c 'default/veh?role=member&listen=no' drive.log

The bus waits for each member, so a member must read all frames (or set listen=no).
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from typing import Any

from tunefree_hil.base.errors import BenchError, InputError, NoAnswer, PeerGone
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.error_frames import require_bus_on
from tunefree_hil.bus.python_can import can
from tunefree_hil.bus.tfhub import address
from tunefree_hil.bus.tfhub.records import (
    BRS,
    DROPPED,
    EFF_FLAG,
    EFF_MASK,
    ERR_FLAG,
    ESI,
    FRAME,
    HEAD,
    PEER_GONE,
    RTR_FLAG,
    Raw,
    body_of,
    pack_frames,
    pack_raw,
    plain_frames,
    unpack_raw,
)
from tunefree_hil.bus.tfhub.server.connection import Connection, ConnectionGone

LOG = logging.getLogger("can.tfhub")
ROLES = ("member", "observer")
FALSE_WORDS = ("0", "no", "false", "off")


class HubGone(BenchError, can.CanOperationError):
    """The hub is gone, or has dropped this peer."""


class MemberGone(PeerGone, can.CanOperationError):
    """A member of the bus is gone without BYE."""


class MayNotSend(InputError, can.CanOperationError):
    """Only members transmit."""


class BusHeld(NoAnswer, can.CanTimeoutError):
    """The bus took no more frames: a member does not read."""


class HubBus(can.BusABC):
    """One channel of a hub as a python-can bus.

    `channel`: an address of `address.py`, with options `?role=...&name=...&echo=yes&listen=no&stamps=yes&token_file=..`
    that may be keywords, too. `role` observer (default) or member. `stamps`: on a hub with the clock 'sender'
    this member's own time stamps are kept. `send` and `recv` raise HubGone; `recv` of a member raises MemberGone once
    for each member that is lost, after what it had sent. `only`: the hub hands over only frames with these ids, for
    a peer that needs few. `both`: this connection carries the other channel too; only `pair.py` reads that.
    """

    def __init__(
        self,
        channel: str,
        can_filters: Any = None,
        receive_own_messages: bool = False,
        *,
        role: str = "",
        name: str = "",
        listen: bool = True,
        stamps: bool = False,
        listen_only: bool = False,
        state: can.BusState | None = None,
        token_file: str = "",
        both: bool = False,
        only: Sequence[int] = (),
        **others: Any,
    ) -> None:
        if others:  # python-can, its tools and its configuration files pass options of adapters: bit times, handles
            LOG.info("no use for %s", ", ".join(sorted(others)))
        text, options = address.split_options(str(channel))
        self.role = _role(options.get("role", role), listen_only or state is can.BusState.PASSIVE)
        hello = {
            "role": self.role,
            "echo": _yes(options.get("echo"), receive_own_messages),
            "listen": _yes(options.get("listen"), listen),
            "stamps": _yes(options.get("stamps"), stamps),
            "both": both,
            "only": list(only),
        }
        where = address.parse(text, options.get("token_file", token_file))
        self._connection = Connection(where, hello, options.get("name", name))
        self.welcome = self._connection.welcome
        self.name = self.welcome.name
        self.dropped = 0  # frames that this observer missed, by the hub's count
        self._offset_ns = self.welcome.epoch_offset_ns
        self._can_protocol = can.CanProtocol.CAN_FD
        self.channel_info = f"tfhub {self.welcome.session}/{self.welcome.channel} as {self.role} {self.name}"
        super().__init__(channel, can_filters=can_filters)

    # --- interface of python-can ---------------------------------------------------------------------------------

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Transmit; waits while another member holds the bus. BusHeld after `timeout` seconds."""
        can_id = msg.arbitration_id | (EFF_FLAG if msg.is_extended_id else 0)
        can_id |= (RTR_FLAG if msg.is_remote_frame else 0) | (ERR_FLAG if msg.is_error_frame else 0)
        flags = (BRS if msg.bitrate_switch else 0) | (ESI if msg.error_state_indicator else 0)
        data = bytes(msg.data or b"")
        time_ns = max(0, round(msg.timestamp * 1e9))
        self._transmit(pack_raw(Raw(can_id, data, time_ns, msg.is_fd, flags, msg.dlc)), timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            if not self._connection.fill(timeout):
                return None, False
        except ConnectionGone as error:
            raise self._gone(error) from None
        if self._connection.kind() != FRAME:
            self._control(self._connection.take())
            return None, False
        return self._message(unpack_raw(self._connection.take())), False

    def _message(self, raw: Raw) -> can.Message:
        return can.Message(
            timestamp=(raw.time_ns + self._offset_ns) / 1e9,
            arbitration_id=raw.can_id & EFF_MASK,
            is_extended_id=bool(raw.can_id & EFF_FLAG),
            is_remote_frame=bool(raw.can_id & RTR_FLAG),
            is_error_frame=bool(raw.can_id & ERR_FLAG),
            channel=self.welcome.log_name,
            dlc=raw.length,
            data=raw.data,
            is_fd=raw.fd,
            bitrate_switch=bool(raw.flags & BRS),
            error_state_indicator=bool(raw.flags & ESI),
            is_rx=raw.sender != self.welcome.index,
        )

    def shutdown(self) -> None:
        """Leave with BYE; members then get no notice of a loss."""
        if not self._is_shutdown:
            super().shutdown()
            self._connection.close()

    def fileno(self) -> int:
        """The socket. From now on no frame waits in this object while the socket has nothing to read."""
        self._connection.careful = True
        return self._connection.sock.fileno()

    def flush_tx_buffer(self) -> None:
        """Nothing waits on this side."""

    @property
    def state(self) -> can.BusState:
        """ACTIVE, or ERROR when the hub is gone."""
        return can.BusState.ERROR if self._connection.gone or self._is_shutdown else can.BusState.ACTIVE

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        """The channels of this user's hubs."""
        channels = [where for info in address.running_hubs() for where in info.addresses.values()]
        return [{"interface": "tfhub", "channel": where} for where in channels]

    # --- the fast path -------------------------------------------------------------------------------------------

    def send_frames(self, frames: Sequence[CanFrame], timeout_s: float | None = None) -> None:
        """Transmit data frames in this order with one write. Their time_s counts where this member stamps."""
        if frames:
            self._transmit(pack_frames(frames), timeout_s)

    def recv_frames(self, timeout_s: float | None) -> list[CanFrame]:
        """All data frames that have arrived; waits up to timeout_s for the first. [] on time-out.

        Error and remote frames are not handed over. BenchError for bus-off.
        """
        connection = self._connection
        if timeout_s is not None and self._filters is None:
            data = connection.fresh(timeout_s)
            frames = plain_frames(data)
            if frames is not None:
                return frames.own
            if data:
                connection.put_back(data)
            elif not connection.buffer and not connection.gone and not connection.careful:
                return []
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            frames = self._some_frames(timeout_s)
            if frames is None or frames:
                return frames or []
            if deadline_s is not None:
                timeout_s = max(0.0, deadline_s - time.monotonic())

    def _some_frames(self, timeout_s: float | None) -> list[CanFrame] | None:
        """The data frames before the next record of another type that passed the filters; None on time-out."""
        frames: list[CanFrame] = []
        try:
            if not self._connection.fill(timeout_s):
                return None
        except ConnectionGone as error:
            raise self._gone(error) from None
        if self._connection.kind() != FRAME:
            self._control(self._connection.take())
            return frames
        with self._connection.reading:
            self._take_frames(frames)
        return frames if self._filters is None else [frame for frame in frames if self._wanted(frame)]

    def _take_frames(self, frames: list[CanFrame]) -> None:
        """Move whole FRAME records from the buffer to `frames`, up to the first record of another type."""
        connection = self._connection
        buffer, offset, end = connection.buffer, connection.position, len(connection.buffer)
        errors = 0  # the classes of all error frames
        while end - offset >= HEAD.size and buffer[offset + 2] == FRAME:
            size = buffer[offset] | buffer[offset + 1] << 8
            if end - offset < size:
                break
            raw = unpack_raw(buffer, offset)
            if raw.can_id & ERR_FLAG:
                errors |= raw.can_id & EFF_MASK
            elif not raw.can_id & RTR_FLAG:
                frames.append(raw.data_frame())
            offset += size
        connection.skip(offset - connection.position)
        require_bus_on(errors, self.channel_info)

    def _wanted(self, frame: CanFrame) -> bool:
        return self._matches_filters(can.Message(arbitration_id=frame.id, is_extended_id=frame.extended))

    # --- shared --------------------------------------------------------------------------------------------------

    def _transmit(self, data: bytes, timeout_s: float | None) -> None:
        if self.role != "member":
            raise MayNotSend(
                f"{self.name} is an observer of {self.welcome.session} and may not transmit",
                code="observer",
                key="role",
                hint="open the bus as a member: ?role=member",
            )
        try:
            taken = self._connection.send(data, timeout_s)
        except ConnectionGone as error:
            raise self._gone(error) from None
        if not taken:
            raise BusHeld(
                f"{self._connection} took no more frames for {timeout_s} s: a member does not read (its stats name it)",
                code="bus_held",
            )

    def _control(self, record: bytes) -> None:
        """Act on a record that is no frame."""
        kind = record[2]
        if kind == PEER_GONE:
            body = body_of(record)
            raise MemberGone(str(body["name"]), f"{body['name']} is gone from the bus: {body['why']}", code="peer_gone")
        if kind == DROPPED:
            self.dropped = HEAD.unpack_from(record)[3]
            return
        body = body_of(record)
        raise self._gone(ConnectionGone(str(body.get("message") or body.get("why"))))

    def _gone(self, error: ConnectionGone) -> HubGone:
        self._connection.gone = self._connection.gone or str(error)
        return HubGone(f"the {self._connection} is gone: {error}", code="hub_gone")


def _role(wanted: str, is_passive: bool) -> str:
    """The role of a peer; InputError for one that does not exist."""
    role = wanted or "observer"
    if role not in ROLES:
        raise InputError(f"no role {role!r}", key="role", hint=f"one of {', '.join(ROLES)}")
    return "observer" if is_passive else role


def _yes(word: str | None, otherwise: bool) -> bool:
    return otherwise if word is None else word.lower() not in FALSE_WORDS
