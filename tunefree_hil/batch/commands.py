"""From the controller's command to the command received by the by-wire unit, as kernels without frames.

The rules are those of nodes/controller.py (frames sent) and nodes/command_decoder.py (frames received). Clear frames
are not modelled: a drive that needs one cannot run in the batch (`episode.NEEDS_THE_BUS`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import Block, buffer, kernel, table
from tunefree_hil.base.records import GEAR_NONE, Command
from tunefree_hil.bus.dbc.codec import Codec, MessageMap
from tunefree_hil.bus.dbc.integrity import E2eStatus
from tunefree_hil.bus.dbc.message_map import FieldMap
from tunefree_hil.bus.dbc.wire_block import WireParams, WireState, fields_of, transmit, wire
from tunefree_hil.plant.actuation.bywire import ReceivedChannel, ReceivedCommand

CHANNELS = ("throttle", "brake", "steer", "gear")
PLACES = {"throttle": "throttle_frac", "brake": "brake_frac", "steer": "steer_rad", "gear": "gear"}
NOT_PROVEN = float(E2eStatus.INITIAL)


class CommandParams(NamedTuple):
    """By field of the wire: its message, and the value decoded from raw 0. By message: period, has an enable bit,
    rejected first frames, is protected. By channel of CHANNELS: its message and place in Command, -1 for none.
    """

    wire: WireParams
    message: Any
    silent: Any
    period_ticks: Any
    enable: Any
    unproven: Any
    protected: Any
    channel_message: Any
    channel_place: Any


class CommandState(NamedTuple):
    """The wire, and by message the frames sent so far, whether one went out at this tick, and its enable bit."""

    wire: WireState
    sent: Any
    fresh: Any
    enabled: Any


def command_params(codec: Codec) -> CommandParams:
    """The tables of a vehicle. Raises InputError where two messages command one channel."""
    messages, fields = codec.commands, fields_of(codec, "command")
    of_channel = [_message_of(channel, messages) for channel in CHANNELS]
    places = [_place_of(channel, messages, at) for channel, at in zip(CHANNELS, of_channel, strict=True)]
    return CommandParams(
        wire(codec, "command", {}).params,
        table(messages.index(message) for _, message in fields),
        table(_silent(field) for field, _ in fields),
        table(message.period_ticks for message in messages),
        table(1.0 if message.enable else 0.0 for message in messages),
        table(message.unproven_frames for message in messages),
        table(0.0 if message.e2e is None else 1.0 for message in messages),
        table(of_channel),
        table(places),
    )


def init_commands(block: Block, params: CommandParams) -> CommandState:
    """Nothing sent yet. block: the wire of the commands."""
    size = max(len(params.period_ticks), 1)
    return CommandState(block.init(params.wire, 0.0), buffer(size), buffer(size), buffer(size))


@kernel
def send(p: CommandParams, state: CommandState, tick: int, command: Command) -> None:
    """The frames that are due, enable bit set."""
    for m in range(len(p.period_ticks)):
        state.fresh[m] = 0.0
        if int(tick) % int(p.period_ticks[m]) == 0:  # not 0: a period is a tick or more
            state.fresh[m], state.enabled[m] = 1.0, 1.0
            state.sent[m] += 1.0
    for i in range(len(p.message)):
        if state.fresh[int(p.message[i])] > 0.5:
            transmit(p.wire, state.wire, i, command)


@kernel
def send_quiet(p: CommandParams, state: CommandState) -> None:
    """Every message with an enable bit, once, without it and without values."""
    for m in range(len(p.period_ticks)):
        state.fresh[m] = 0.0
        if p.enable[m] > 0.5:
            state.fresh[m], state.enabled[m] = 1.0, 0.0
            state.sent[m] += 1.0
    for i in range(len(p.message)):
        if state.fresh[int(p.message[i])] > 0.5:
            state.wire.sent[int(p.wire.index[i])] = float(p.silent[i])


@kernel
def send_nothing(p: CommandParams, state: CommandState) -> None:
    """Send no frame."""
    for m in range(len(p.period_ticks)):
        state.fresh[m] = 0.0


@kernel
def received_channel(p: CommandParams, state: CommandState, channel: int) -> ReceivedChannel:
    """The command received on a by-wire channel at this tick."""
    m = int(p.channel_message[channel])
    if m < 0:
        return ReceivedChannel(0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)
    believed = state.sent[m] > p.unproven[m]
    doubt = 0.0 if believed or p.protected[m] < 0.5 else NOT_PROVEN
    if not believed or state.fresh[m] < 0.5:
        return ReceivedChannel(0.0, 0.0, 0.0, 0.0, 1.0, 0.0, doubt)
    place = int(p.channel_place[channel])
    value = float(state.wire.sent[place]) if place >= 0 else 0.0
    enabled = float(state.enabled[m]) if p.enable[m] > 0.5 else 1.0
    return ReceivedChannel(value, enabled, 0.0, 0.0, 1.0, 1.0, doubt)


@kernel
def received_command(p: CommandParams, state: CommandState) -> ReceivedCommand:
    """All commands received at this tick."""
    gear = received_channel(p, state, 3)
    return ReceivedCommand(
        received_channel(p, state, 0),
        received_channel(p, state, 1),
        received_channel(p, state, 2),
        gear.value if gear.fresh > 0.5 else GEAR_NONE,
        0.0,
    )


def _message_of(channel: str, messages: tuple[MessageMap, ...]) -> int:
    places = [at for at, message in enumerate(messages) if channel in message.bywire]
    if len(places) > 1:
        names = ", ".join(messages[at].name for at in places)
        raise InputError(
            f"more than one message commands {channel}: {names}",
            code="not_in_batch",
            hint="the batch cannot drive such a vehicle; leave out --backend batch",
        )
    return places[0] if places else -1


def _place_of(channel: str, messages: tuple[MessageMap, ...], start: int) -> int:
    fields = [] if start < 0 else [field.name for field in messages[start].fields if field.group == "command"]
    return Command._fields.index(PLACES[channel]) if PLACES[channel] in fields else -1


def _silent(field: FieldMap) -> float:
    """The value that Codec.decode and values give where every signal of a field is raw 0."""
    total = 0.0
    for term in field.terms:
        total += (0 * term.signal.factor + term.signal.offset) * term.scale
    return float(total * field.scale + field.offset)
