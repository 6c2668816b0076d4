"""State bits of the vehicle's frames from the by-wire unit's status, by the tables of vehicle.toml."""

from __future__ import annotations

from collections.abc import Mapping

from tunefree_hil.base.records import GEAR_DRIVE, GEAR_LOW, GEAR_NEUTRAL, GEAR_PARK, GEAR_REVERSE
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.integrity import VALID_STATUSES, E2eStatus
from tunefree_hil.bus.dbc.message_map import MessageMap, StateMap
from tunefree_hil.plant.actuation.bywire import CAUSES, GEAR_REJECTS, ByWireStatus, ChannelStatus

_CHANNELS = ("throttle", "brake", "steer")
_FROM_STATUS = {"enabled": "enabled", "override": "override", "timeout": "timeout", "driver": "driver"}
COUNTER_CAUSE = "watchdog"  # cause of a fault bit: this channel's counter does not count
E2E = "e2e"  # condition: this channel's commands have the E2E status `cause` ('': no valid one); or a cause

# Conditions without a channel, and the meaning of their causes.
LIGHTS = {"input": "light_input", "command": "light_command", "output": "light_output"}
GEARS = {"park": GEAR_PARK, "reverse": GEAR_REVERSE, "neutral": GEAR_NEUTRAL, "drive": GEAR_DRIVE, "low": GEAR_LOW}


def set_bits(message: MessageMap, status: ByWireStatus) -> dict[str, float]:
    """Raw values of the state signals of one message. Codes are 0 while none of their causes holds."""
    bits: dict[str, float] = {}
    decoded: set[str] = set()
    for state in message.states:
        bits.setdefault(state.signal, 1.0 - state.active if state.active in (0, 1) else 0.0)
        if state.signal not in decoded and _holds(state, status):  # of several codes for one cause the first
            bits[state.signal] = state.active
            decoded.add(state.signal)
    return bits


def _holds(state: StateMap, status: ByWireStatus) -> bool:
    if state.condition == "watchdog":
        code = CAUSES.get(state.cause, -1.0)
        return status.watchdog_cause == code if state.cause else status.watchdog_braking > 0.5
    if state.condition == "brake_light":
        return getattr(status, LIGHTS[state.cause]) > 0.5
    if state.condition == "gear_command":
        return status.gear_wish == GEARS[state.cause]
    if state.condition == "gear_reject":
        return status.gear_reject == GEAR_REJECTS[state.cause]
    if state.bywire == "gear":
        return state.condition == "override" and status.gear_override > 0.5
    channels = [getattr(status, state.bywire)] if state.bywire else [getattr(status, name) for name in _CHANNELS]
    return any(_channel_holds(state, channel) for channel in channels)


def _channel_holds(state: StateMap, channel: ChannelStatus) -> bool:
    if state.condition == E2E and state.cause:
        return channel.e2e == E2eStatus[state.cause.upper()]
    if state.condition == E2E:
        return channel.e2e not in VALID_STATUSES
    if state.condition == "fault" and state.cause == E2E:
        return channel.e2e not in (*VALID_STATUSES, E2eStatus.INITIAL)  # nothing is wrong before the first frame
    if state.condition == "fault":
        return state.cause == COUNTER_CAUSE and channel.counter_fault > 0.5
    name = _FROM_STATUS.get(state.condition)
    return name is not None and getattr(channel, name) > 0.5


class StatusSignals:
    """State signals by message, computed again only when the status changes."""

    def __init__(self, codec: Codec) -> None:
        self._messages = codec.telemetry
        self._status: ByWireStatus | None = None
        self._signals: dict[str, dict[str, float]] = {}

    def of(self, status: ByWireStatus) -> Mapping[str, Mapping[str, float]]:
        """message name -> {signal: raw value}."""
        if status != self._status:
            self._status = status
            self._signals = {message.name: set_bits(message, status) for message in self._messages}
        return self._signals


def cause_name(code: float) -> str:
    """The name of a watchdog cause."""
    return next((name for name, value in CAUSES.items() if value == code), "unknown")
