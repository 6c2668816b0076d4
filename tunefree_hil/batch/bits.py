"""State bits from the by-wire unit's status to the controller's decoded state, as a kernel without frames.

The rules are those of nodes/status_bits.py (encoding) and nodes/measurement_decoder.py (decoding) as tables of numbers;
tests/batch/test_bits.py compares both over random statuses.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from tunefree_hil.base.kernel import buffer, kernel, table
from tunefree_hil.bus.dbc.message_map import MessageMap, StateMap
from tunefree_hil.nodes.handshake import VehicleState
from tunefree_hil.nodes.status_bits import COUNTER_CAUSE
from tunefree_hil.plant.actuation.bywire import CAUSES, ByWireStatus, ChannelStatus

NEVER, CAUSE, BRAKING, GEAR, CHANNEL = 0.0, 1.0, 2.0, 3.0, 4.0  # status that a row reads
DISABLED, OVERRIDE, FAULT = 0, 1, 2  # flags of a message, three numbers a message
CHANNELS = ("throttle", "brake", "steer")
ANY = 3.0
SIGNS = {"override": OVERRIDE, "fault": FAULT, "timeout": FAULT, "watchdog": FAULT}


class BitParams(NamedTuple):
    """One row a state of vehicle.toml, message by message; signals have one entry for each signal of each message."""

    first_row: Any  # of message i, up to first_row[i + 1]
    first_signal: Any
    signal: Any  # of a row
    kind: Any
    channel: Any
    field: Any  # of ChannelStatus, or the watchdog's code
    active: Any
    read_back: Any  # value decoded where `active` was written
    sign: Any  # DISABLED, OVERRIDE, FAULT; -1: a warning only
    rest: Any  # of a signal: value decoded where no row is active
    enables: Any  # of a message: 1 where its enable bits must have been received


class BitState(NamedTuple):
    """Buffers: current and received status of each message (three values each), received messages, scratch."""

    current: Any
    received: Any
    known: Any
    value: Any
    decoded: Any


def bit_params(messages: Sequence[MessageMap]) -> BitParams:
    """The tables of some messages, in this order."""
    rows: list[tuple[float, ...]] = []
    first_row, first_signal, rest = [0], [0], []
    for message in messages:
        names = list(dict.fromkeys(state.signal for state in message.states))
        for name in names:
            first = next(state for state in message.states if state.signal == name)
            low = 1.0 - first.active if first.active in (0, 1) else 0.0
            rest.append(_read_back(message, name, low))
        for state in message.states:
            read_back = _read_back(message, state.signal, state.active)
            column = float(first_signal[-1] + names.index(state.signal))
            rows.append((column, *_status_source(state), float(state.active), read_back, _effect_index(state)))
        first_row.append(len(rows))
        first_signal.append(first_signal[-1] + len(names))
    columns = [table(row[i] for row in rows) for i in range(7)]
    enables = [float(any(state.condition == "enabled" for state in message.states)) for message in messages]
    return BitParams(*[table(first_row), table(first_signal), *columns, table(rest), table(enables)])


def init_bits(params: BitParams) -> BitState:
    """Nothing received yet."""
    messages, signals = len(params.enables), max(len(params.rest), 1)
    three = 3 * max(messages, 1)
    return BitState(buffer(three), buffer(three), buffer(max(messages, 1)), buffer(signals), buffer(signals))


@kernel
def holds(kind: float, channel: float, field: float, status: ByWireStatus) -> bool:
    """Whether the status of a row is active."""
    if kind == CAUSE:
        return status.watchdog_cause == field
    if kind == BRAKING:
        return status.watchdog_braking > 0.5
    if kind == GEAR:
        return status.gear_override > 0.5
    if kind != CHANNEL:
        return False
    column = int(field)
    if channel in (0.0, ANY) and status.throttle[column] > 0.5:
        return True
    if channel in (1.0, ANY) and status.brake[column] > 0.5:
        return True
    return channel in (2.0, ANY) and status.steer[column] > 0.5


@kernel
def set_bits(p: BitParams, state: BitState, status: ByWireStatus) -> None:
    """Set the flags of each message for a status; to be called when the status has changed."""
    value, decoded = state.value, state.decoded
    for i in range(len(p.rest)):
        value[i], decoded[i] = float(p.rest[i]), 0.0
    for i in range(len(p.kind)):
        column = int(p.signal[i])
        if decoded[column] == 0.0 and holds(float(p.kind[i]), float(p.channel[i]), float(p.field[i]), status):
            value[column], decoded[column] = float(p.read_back[i]), 1.0
    for m in range(len(p.enables)):
        for j in range(3):
            state.current[3 * m + j] = 0.0
        for i in range(int(p.first_row[m]), int(p.first_row[m + 1])):
            sign = int(p.sign[i])
            if sign >= 0:
                hit = value[int(p.signal[i])] == p.active[i]
                if hit != (sign == DISABLED):  # an enable bit counts when it is not set
                    state.current[3 * m + sign] = 1.0


@kernel
def receive_bits(state: BitState, m: int) -> None:
    """The controller receives message m."""
    for j in range(3):
        state.received[3 * m + j] = float(state.current[3 * m + j])
    state.known[m] = 1.0


@kernel
def vehicle_state(p: BitParams, state: BitState) -> VehicleState:
    """The state from all received messages."""
    known, disabled, override, fault = True, False, False, False
    for m in range(len(p.enables)):
        if p.enables[m] > state.known[m]:
            known = False
        disabled = disabled or state.received[3 * m + DISABLED] > 0.5
        override = override or state.received[3 * m + OVERRIDE] > 0.5
        fault = fault or state.received[3 * m + FAULT] > 0.5
    return VehicleState(known, not disabled, override, fault)


class StatusSource(NamedTuple):
    """Which status a row reads: its kind, the channel, the field."""

    kind: float
    channel: float
    field: float


def _status_source(state: StateMap) -> StatusSource:
    """The status that a condition of the vehicle folder reads."""
    if state.condition == "watchdog":
        if state.cause:
            return StatusSource(CAUSE, 0.0, CAUSES.get(state.cause, -1.0))
        return StatusSource(BRAKING, 0.0, 0.0)
    if state.bywire == "gear":
        return StatusSource(GEAR if state.condition == "override" else NEVER, 0.0, 0.0)
    channel = float(CHANNELS.index(state.bywire)) if state.bywire else ANY
    if state.condition == "fault":
        counts = state.cause == COUNTER_CAUSE
        field = float(ChannelStatus._fields.index("counter_fault"))
        return StatusSource(CHANNEL if counts else NEVER, channel, field)
    if state.condition not in ("enabled", "override", "timeout", "driver"):
        return StatusSource(NEVER, channel, 0.0)
    return StatusSource(CHANNEL, channel, float(ChannelStatus._fields.index(state.condition)))


def _effect_index(state: StateMap) -> float:
    """Index of the flag that a row sets; -1 for none."""
    if state.effect == "warn":
        return -1.0
    return float(DISABLED if state.condition == "enabled" else SIGNS.get(state.condition, -1))


def _read_back(message: MessageMap, name: str, value: float) -> float:
    """The raw value that is decoded from a signal of this width."""
    signal = message.signals[name]
    sign = 1 << (signal.bits - 1) if signal.signed else 0
    return float(((int(value) & signal.mask) ^ sign) - sign)
