"""What a node makes of the frames it hears: the latest records, the state bits, and how old each message is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from tunefree_hil.base.records import CanFrame, Measurement
from tunefree_hil.bus.codec import Codec, Snapshot
from tunefree_hil.bus.message_map import MessageMap
from tunefree_hil.nodes.exchange import can_key
from tunefree_hil.nodes.handshake import VehicleState

MISSING_S = 0.2  # 20 missed periods of localization in the source (apollo_facts 1.2)
INS, CHASSIS = "ins", "chassis"


class Hearing:
    """The vehicle as the controller hears it. One instance an episode."""

    def __init__(self, codec: Codec, tick_s: float) -> None:
        self.codec = codec
        self.snapshot = Snapshot(codec)
        self.limit_ticks = round(MISSING_S / tick_s)
        self.heard_at: dict[str, int] = {}
        self._enable_messages = {
            message.name for message in codec.telemetry if any(state.condition == "enabled" for state in message.states)
        }
        self._active: dict[str, frozenset[str]] = {}
        self._payload: dict[str, bytes] = {}

    def hear(self, tick: int, frames: Iterable[CanFrame]) -> None:
        """Take in frames that have arrived by tick `tick`."""
        for frame in frames:
            message = self.codec.by_id[can_key(frame)]
            self.heard_at[message.name] = tick
            if self._payload.get(message.name) == frame.data:
                continue  # nothing new in it
            self._payload[message.name] = frame.data
            if message.states:
                self._note_bits(message, self.snapshot.hear(message, frame.data))
            else:
                self.snapshot.take(message, frame.data)

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
        """The latest values heard; NaN where nothing has been."""
        return Measurement(self.snapshot.report(), self.snapshot.ins())

    def missing(self, tick: int, needed: Mapping[str, Iterable[str]]) -> tuple[str, list[str]] | None:
        """(group, messages) of the first group of which a needed message has not been heard for 0.2 s, or None."""
        for group, messages in needed.items():
            late = [name for name in messages if tick - self.heard_at.get(name, 0) > self.limit_ticks]
            if late:
                return group, late
        return None
