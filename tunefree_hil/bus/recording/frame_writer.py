"""The sender's side of counters and end-to-end protection, one for ECU and controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.dbc.codec import Codec, RawBits, raw_bits
from tunefree_hil.bus.dbc.e2e import protect
from tunefree_hil.bus.dbc.message_map import MessageMap

_NOTHING: tuple[Mapping[str, float] | None, RawBits] = (None, RawBits(-1, 0, -1, 0))


class FrameWriter:
    """Records -> frames of a vehicle, each message counted on from its last. One a node; counters begin at 0."""

    def __init__(self, codec: Codec) -> None:
        self.codec = codec
        self._next: dict[str, int] = {}
        self._raw: dict[str, tuple[Mapping[str, float], RawBits]] = {}  # by message: the last signals, and their bits

    def restart(self) -> None:
        """Count from 0 again: a new episode."""
        self._next.clear()

    def write(
        self, message: MessageMap, records: Mapping[str, Any], signals: Mapping[str, float], stamp_s: float
    ) -> CanFrame:
        """The next frame of a message.

        records, signals: as Codec.encode takes them, without counter and CRC. The same `signals` object is taken to
        hold the same values.
        """
        name = message.name
        known, raw = self._raw.get(name, _NOTHING)
        if known is not signals:
            raw = raw_bits(message, signals)
            self._raw[name] = signals, raw
        counter = 0
        if message.counter:
            counter = self._next.get(name, 0)
            self._next[name] = (counter + 1) % message.counter_modulus
            if message.e2e is None:
                raw = _with_counter(message, raw, counter)
        data = self.codec.encode_bits(message, records, raw)
        if message.e2e is not None:
            data = protect(message.e2e, data, counter)
        return self._frame(message, data, stamp_s)

    def write_short(
        self,
        message: MessageMap,
        records: Mapping[str, Any],
        signals: Mapping[str, float],
        length: int,
        stamp_s: float,
    ) -> CanFrame:
        """A frame that ends before its counter, which then stays. A protected message is never shortened."""
        if message.e2e is not None:
            return self.write(message, records, signals, stamp_s)
        return self._frame(message, self.codec.encode(message, records, signals, length), stamp_s)

    @staticmethod
    def _frame(message: MessageMap, data: bytes, stamp_s: float) -> CanFrame:
        return tuple.__new__(CanFrame, (message.can_id, data, message.extended, message.fd, stamp_s))  # half the time


def _with_counter(message: MessageMap, raw: RawBits, counter: int) -> RawBits:
    mask, shift, others, is_big = message.plan.raws[message.counter]
    keep_little, little, keep_big, big = raw
    if is_big:
        return RawBits(keep_little, little, keep_big & others, big & others | (counter & mask) << shift)
    return RawBits(keep_little & others, little & others | (counter & mask) << shift, keep_big, big)
