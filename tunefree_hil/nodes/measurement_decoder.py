"""Decodes report and INS frames: the latest records, the state bits, and the age of each message.

A frame of a protected message that fails its check changes none of them, and does not count as received.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from tunefree_hil.base.records import CanFrame, Measurement
from tunefree_hil.bus.dbc.codec import Codec, Snapshot
from tunefree_hil.bus.dbc.message_map import MessageMap
from tunefree_hil.nodes.exchange import can_key
from tunefree_hil.nodes.handshake import VehicleState
from tunefree_hil.nodes.reception import Reception

MISSING_S = 0.2  # 20 missed periods of localization in the source (docs/reference/apollo.md)
SLOW = 2.5  # periods of a slow message, whose first frame may not be valid
INS, CHASSIS = "ins", "chassis"


class MeasurementDecoder:
    """The vehicle as the controller receives it. One instance an episode."""

    def __init__(self, codec: Codec, tick_s: float) -> None:
        self.codec = codec
        self.snapshot = Snapshot(codec)
        self.reception = Reception(codec.telemetry)
        self._protected = {message.name: _group(message) for message in codec.telemetry if message.e2e is not None}
        default_ticks = round(MISSING_S / tick_s)
        self._limits = {
            message.name: max(default_ticks, message.timeout_ticks, round(SLOW * message.period_ticks))
            for message in codec.telemetry
        }
        self.limit_ticks = max([default_ticks, *self._limits.values()])
        self.heard_at: dict[str, int] = {}
        self._enable_messages = {
            message.name for message in codec.telemetry if any(state.condition == "enabled" for state in message.states)
        }
        self._active: dict[str, frozenset[str]] = {}
        self._payload: dict[str, bytes] = {}

    def receive(self, tick: int, frames: Iterable[CanFrame]) -> None:
        """Take in frames that have arrived by tick `tick`."""
        for frame in frames:
            message = self.codec.by_id[can_key(frame)]
            if not self.reception.receive(message, frame.data, tick):
                continue
            self.heard_at[message.name] = tick
            if self._payload.get(message.name) == frame.data:
                continue  # nothing new in it
            self._payload[message.name] = frame.data
            if message.states:
                self._note_bits(message, self.snapshot.receive(message, frame.data))
            else:
                self.snapshot.take(message, frame.data)
        self.reception.end_tick(tick)

    def _note_bits(self, message: MessageMap, decoded: Mapping[str, float]) -> None:
        active = set()
        for state in message.states:
            if state.effect == "warn":
                continue
            hit = decoded.get(state.signal) == state.active
            if state.condition == "enabled":
                if not hit:
                    active.add("disabled")
            elif hit:
                active.add(state.condition)
        self._active[message.name] = frozenset(active)

    def state(self) -> VehicleState:
        """All channels together: enabled where every enable bit is set; override or fault where any is."""
        together = frozenset[str]().union(*self._active.values())
        return VehicleState(
            known=self._enable_messages <= self._active.keys(),
            enabled="disabled" not in together,
            override="override" in together,
            fault=bool(together & {"fault", "timeout", "watchdog"}),
        )

    def measurement(self) -> Measurement:
        """The latest values received; NaN before the first."""
        return Measurement(self.snapshot.report(), self.snapshot.ins())

    def missing(self, tick: int, needed: Mapping[str, Iterable[str]]) -> tuple[str, list[str]] | None:
        """(group, messages) of the first group of which a message is not there, or None.

        That is: no valid frame for 0.2 s, or as long as a slower message takes. `needed` names messages by
        group; protected ones all count.
        """
        for group, messages in needed.items():
            protected = [name for name, own in self._protected.items() if own == group]
            names = dict.fromkeys([*messages, *protected])
            late = [
                name for name in names if tick - self.heard_at.get(name, 0) > self._limits.get(name, self.limit_ticks)
            ]
            if late:
                return group, late
        return None

    def why(self, name: str) -> str:
        """A missing message as text, with its E2E status where it is protected."""
        return f"{name} ({self.reception.status(name).words})" if name in self._protected else name


def _group(message: MessageMap) -> str:
    return INS if any(one.group == "ins" for one in message.fields) else CHASSIS
