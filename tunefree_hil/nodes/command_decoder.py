"""Decodes command frames for the simulated by-wire vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tunefree_hil.base.records import GEAR_NONE, CanFrame, Command
from tunefree_hil.bus.dbc.codec import Codec, MessageMap
from tunefree_hil.bus.dbc.integrity import VALID_STATUSES, E2eStatus
from tunefree_hil.nodes.exchange import can_key
from tunefree_hil.nodes.reception import Reception
from tunefree_hil.plant.actuation.bywire import ReceivedChannel, ReceivedCommand

_COMMAND_INDEX = {"throttle": 0, "brake": 1, "steer": 2}


class CommandDecoder:
    """Command frames -> Heard. Keeps the counters from frame to frame. One instance an episode."""

    def __init__(self, codec: Codec) -> None:
        self.codec = codec
        self.reception = Reception(codec.commands)
        self.tick = 0
        self._protected = [
            (message, channel)
            for message in codec.commands
            if message.e2e is not None
            for channel in message.bywire
            if channel in _COMMAND_INDEX
        ]

    def receive(self, frames: Sequence[CanFrame]) -> ReceivedCommand:
        """The channels of one tick; a channel without a valid frame is not fresh."""
        channels: dict[str, Any] = {}
        for frame in frames:
            message = self.codec.by_id[can_key(frame)]
            if self.reception.receive(message, frame.data, self.tick) and message.bywire:
                self._take(message, frame.data, channels)
        self.reception.end_tick(self.tick)
        self.tick += 1
        self._add_statuses(channels)
        return ReceivedCommand(**channels) if channels else ReceivedCommand()

    def _take(self, message: MessageMap, data: bytes, channels: dict[str, Any]) -> None:
        decoded = self.codec.decode(message, data)
        values = {index: value for group, index, value in self.codec.values(message, decoded) if group == "command"}
        for channel in message.bywire:
            if channel == "gear":
                channels["gear"] = values.get(Command._fields.index("gear"), GEAR_NONE)
                channels["gear_clear"] = float(decoded.get(message.clear, 0.0)) if message.clear else 0.0
            else:
                channels[channel] = self._channel(message, decoded, values.get(_COMMAND_INDEX[channel], 0.0))

    def _channel(self, message: MessageMap, decoded: Mapping[str, float], value: float) -> ReceivedChannel:
        repeated = message.e2e is None and self.reception.status(message.name) is E2eStatus.REPEATED
        return ReceivedChannel(
            float(value),
            float(decoded.get(message.enable, 0.0)) if message.enable else 1.0,
            float(decoded.get(message.clear, 0.0)) if message.clear else 0.0,
            float(decoded.get(message.ignore, 0.0)) if message.ignore else 0.0,
            0.0 if repeated else 1.0,
            1.0,
        )

    def _add_statuses(self, channels: dict[str, Any]) -> None:
        """Add the E2E status of protected messages to their channels, whether a frame came or not."""
        for message, channel in self._protected:
            status = self.reception.status(message.name)
            if status not in VALID_STATUSES:
                channels[channel] = channels.get(channel, ReceivedChannel())._replace(e2e=float(status))
