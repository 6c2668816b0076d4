"""What the simulated by-wire vehicle makes of the command frames it hears."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tunefree_hil.base.records import GEAR_NONE, CanFrame, Command
from tunefree_hil.bus.codec import Codec, MessageMap
from tunefree_hil.bus.integrity import Order, check_counter
from tunefree_hil.nodes.exchange import can_key
from tunefree_hil.plant.bywire import Heard, HeardChannel

_COMMAND_INDEX = {"throttle": 0, "brake": 1, "steer": 2}


class Ears:
    """Command frames -> Heard. Keeps the counters, as each frame must count on from the last."""

    def __init__(self, codec: Codec) -> None:
        self.codec = codec
        self._counters: dict[str, int] = {}

    def hear(self, frames: Sequence[CanFrame]) -> Heard:
        """The channels of one tick; a channel without a frame is not fresh."""
        channels: dict[str, Any] = {}
        for frame in frames:
            message = self.codec.by_id[can_key(frame)]
            decoded = self.codec.decode(message, frame.data)
            values = {index: value for group, index, value in self.codec.values(message, decoded) if group == "command"}
            for channel in message.bywire:
                if channel == "gear":
                    channels["gear"] = values.get(Command._fields.index("gear"), GEAR_NONE)
                    channels["gear_clear"] = float(decoded.get(message.clear, 0.0)) if message.clear else 0.0
                else:
                    channels[channel] = self._channel(message, decoded, values.get(_COMMAND_INDEX[channel], 0.0))
        return Heard(**channels) if channels else Heard()

    def _channel(self, message: MessageMap, decoded: Mapping[str, float], value: float) -> HeardChannel:
        return HeardChannel(
            float(value),
            float(decoded.get(message.enable, 0.0)) if message.enable else 1.0,
            float(decoded.get(message.clear, 0.0)) if message.clear else 0.0,
            float(decoded.get(message.ignore, 0.0)) if message.ignore else 0.0,
            self._counts(message, decoded),
            1.0,
        )

    def _counts(self, message: MessageMap, decoded: Mapping[str, float]) -> float:
        """1 where the rolling counter moved on from the last frame, or there is none."""
        if not message.counter or message.counter not in decoded:
            return 1.0
        now = int(decoded[message.counter])
        last = self._counters.get(message.name)
        self._counters[message.name] = now
        return 0.0 if check_counter(last, now, message.counter_modulus).order is Order.REPEATED else 1.0
