"""Decodes report and INS frames: the latest records, the state bits, and the age of each message.

A frame of a protected message that fails its check changes none of them, and does not count as received.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from tunefree_hil.base.records import CanFrame, Measurement
from tunefree_hil.bus.dbc.codec import Codec, Snapshot
from tunefree_hil.bus.dbc.message_map import EXTENDED_FLAG, MessageMap
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
        self._state: VehicleState | None = None  # None: to be made anew from `_active`
        self._payload: dict[str, bytes] = {}
        self._state_masks = {message.name: _state_mask(message) for message in codec.telemetry if message.states}
        self._state_bits: dict[str, int] = {}  # the latest bits of `_state_masks`
        self._needed: Mapping[str, Iterable[str]] = {}
        self._safe_until = -1  # up to this tick nothing of `_needed` can be missing

    def receive(self, tick: int, frames: Iterable[CanFrame]) -> None:
        """Take in frames that have arrived by tick `tick`."""
        by_id, payloads, reception = self.codec.by_id, self._payload, self.reception
        for can_id, data, extended, _, _ in frames:
            message = by_id[can_id | EXTENDED_FLAG if extended else can_id]  # can_key
            if not reception.receive(message, data, tick):
                continue
            name = message.name
            self.heard_at[name] = tick
            if payloads.get(name) == data:
                continue  # nothing new in it
            payloads[name] = data
            if message.states:
                self._take_states(message, data)
            else:
                self.snapshot.take(message, data)
        reception.end_tick(tick)

    def _take_states(self, message: MessageMap, data: bytes) -> None:
        """Take in a payload with state bits, which are looked at where they have changed."""
        mask, name = self._state_masks[message.name], message.name
        bits = int.from_bytes(data, "little") & mask if mask and len(data) == message.length else -1
        if bits >= 0 and self._state_bits.get(name) == bits:
            self.snapshot.take(message, data)
            return
        self._state_bits[name] = bits
        self._note_bits(message, self.snapshot.receive(message, data))

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
        self._state = None

    def state(self) -> VehicleState:
        """All channels together: enabled where every enable bit is set; override or fault where any is."""
        if self._state is None:
            together = frozenset[str]().union(*self._active.values())
            self._state = VehicleState(
                known=self._enable_messages <= self._active.keys(),
                enabled="disabled" not in together,
                override="override" in together,
                fault=bool(together & {"fault", "timeout", "watchdog"}),
            )
        return self._state

    def measurement(self) -> Measurement:
        """The latest values received; NaN before the first."""
        return Measurement(self.snapshot.report(), self.snapshot.ins())

    def missing(self, tick: int, needed: Mapping[str, Iterable[str]]) -> tuple[str, list[str]] | None:
        """(group, messages) of the first group of which a message is not there, or None.

        That is: no valid frame for 0.2 s, or as long as a slower message takes. `needed` names messages by
        group; protected ones all count.
        """
        if needed is self._needed and tick <= self._safe_until:
            return None
        safe_until = tick + self.limit_ticks
        for group, messages in needed.items():
            protected = [name for name, own in self._protected.items() if own == group]
            last_ticks = {
                name: self.heard_at.get(name, 0) + self._limits.get(name, self.limit_ticks)
                for name in [*messages, *protected]
            }
            late = [name for name, last in last_ticks.items() if tick > last]
            if late:
                return group, late
            safe_until = min([safe_until, *last_ticks.values()])
        self._needed, self._safe_until = needed, safe_until
        return None

    def why(self, name: str) -> str:
        """A missing message as text, with its E2E status where it is protected."""
        return f"{name} ({self.reception.status(name).words})" if name in self._protected else name


def _state_mask(message: MessageMap) -> int:
    """The bits of a payload, as a little-endian integer, that its states look at; 0 where one cannot be read there."""
    mask = 0
    for name in {state.signal for state in message.states}:
        signal = message.signals[name]
        if signal.big_endian or signal.is_float:
            return 0
        mask |= signal.mask << signal.shift
    return mask


def _group(message: MessageMap) -> str:
    return INS if any(one.group == "ins" for one in message.fields) else CHASSIS
