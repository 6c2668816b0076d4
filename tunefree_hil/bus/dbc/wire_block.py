"""A record after its way over the bus, as a Block: bit for bit encode, then decode (docs/reference/design.md).

Each field is quantised and clipped as its signals are, and held between the transmissions of its message, which goes
out at every tick k at which (k + phase) % period_ticks is 0. Before its first transmission a field is NaN, as in a
Snapshot; fields that the vehicle does not have stay NaN. A receiver takes no value from the first frames of a
protected message (MessageMap.unproven_frames); a reader of the log does (`WireState.sent`).
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.base.kernel import Block, buffer, kernel, table
from tunefree_hil.base.records import GROUPS, NAN, Command, Ins, Report
from tunefree_hil.bus.dbc.message_map import FieldMap, MessageMap
from tunefree_hil.bus.dbc.quantise import to_raw, wrap_turn

if TYPE_CHECKING:
    from tunefree_hil.bus.dbc.codec import Codec


class WireParams(NamedTuple):
    """One entry a mapped field; the terms of field i are first_term[i] up to first_term[i + 1]."""

    index: Any  # in the record
    period_ticks: Any
    wait_ticks: Any  # to the first transmission
    unproven: Any  # first transmissions that the receiver does not take
    scale: Any
    offset: Any
    turn_low: Any
    raw_turn: Any
    first_term: Any
    term_scale: Any
    factor: Any
    signal_offset: Any
    raw_low: Any
    raw_high: Any


class WireState(NamedTuple):
    """Buffers: by field the ticks until its next transmission and how many are still not taken; by place in the record
    what was last on the wire, and the receiver's values.
    """

    wait_ticks: Any
    unproven: Any
    sent: Any
    heard: Any


@kernel
def cross_bus(p: WireParams, i: int, value: float) -> float:
    """The received value when `value` is sent as field i."""
    angle = float(p.raw_turn[i]) > 0.0
    if angle:
        value = wrap_turn(value, float(p.turn_low[i]))
    scale = float(p.scale[i])
    rest = (value - float(p.offset[i])) / scale  # not 0: check_vehicle refuses it
    total = 0.0
    first = int(p.first_term[i])
    for j in range(first, int(p.first_term[i + 1])):
        term_scale = float(p.term_scale[j])
        factor = float(p.factor[j])
        signal_offset = float(p.signal_offset[j])
        steps = (rest / term_scale - signal_offset) / factor  # not 0: check_vehicle refuses it
        turn = float(p.raw_turn[i]) if j == first else 0.0
        if value - value != 0.0:
            raw = 0.0
        else:
            raw = to_raw(steps, float(p.raw_low[j]), float(p.raw_high[j]), turn)
        physical = raw * factor + signal_offset
        rest = rest - physical * term_scale
        total = total + physical * term_scale
    return total * scale + float(p.offset[i])


@kernel
def pass_on(p: WireParams, state: WireState, x: Any) -> None:
    """Send the fields that are due; `state.heard` then holds the receiver's values."""
    for i in range(len(p.index)):
        wait = float(state.wait_ticks[i])
        if wait <= 0.0:
            transmit(p, state, i, x)
            wait = float(p.period_ticks[i])
        state.wait_ticks[i] = wait - 1.0


@kernel
def transmit(p: WireParams, state: WireState, i: int, x: Any) -> None:
    """Send field i of the record x."""
    place = int(p.index[i])
    value = cross_bus(p, i, float(x[place]))
    state.sent[place] = value
    if state.unproven[i] > 0.0:
        state.unproven[i] -= 1.0
    else:
        state.heard[place] = value


@kernel
def report_heard(state: WireState) -> Report:
    """The chassis reports as the receiver has them."""
    h = state.heard
    return Report(
        *(float(h[0]), float(h[1]), float(h[2]), float(h[3]), float(h[4]), float(h[5]), float(h[6])),
        *(float(h[7]), float(h[8]), float(h[9]), float(h[10]), float(h[11]), float(h[12]), float(h[13])),
        *(float(h[14]), float(h[15]), float(h[16]), float(h[17]), float(h[18]), float(h[19])),
    )


@kernel
def ins_heard(state: WireState) -> Ins:
    """The INS as the receiver has it."""
    h = state.heard
    return Ins(float(h[0]), float(h[1]), float(h[2]), float(h[3]), float(h[4]), float(h[5]))


@kernel
def command_heard(state: WireState) -> Command:
    """The commands as the receiver has them."""
    h = state.heard
    return Command(float(h[0]), float(h[1]), float(h[2]), float(h[3]), float(h[4]), float(h[5]))


@kernel
def report_step(p: WireParams, state: WireState, x: Report, dt_s: float) -> tuple[WireState, Report]:
    """One tick of the chassis reports."""
    pass_on(p, state, x)
    return state, report_heard(state)


@kernel
def ins_step(p: WireParams, state: WireState, x: Ins, dt_s: float) -> tuple[WireState, Ins]:
    """One tick of the INS."""
    pass_on(p, state, x)
    return state, ins_heard(state)


@kernel
def command_step(p: WireParams, state: WireState, x: Command, dt_s: float) -> tuple[WireState, Command]:
    """One tick of the commands."""
    pass_on(p, state, x)
    return state, command_heard(state)


STEPS = {"report": report_step, "ins": ins_step, "command": command_step}


def wire(codec: Codec, group: str, phases: Mapping[str, int]) -> Block:
    """The Block of a group ('report', 'ins', 'command') on its record. phases: tick of its period, by message."""
    fields = fields_of(codec, group)
    periods = [message.period_ticks for _, message in fields]
    waits = [-phases.get(message.name, 0) % ticks for (_, message), ticks in zip(fields, periods, strict=True)]
    unproven = [message.unproven_frames for _, message in fields]
    size = len(GROUPS[group]._fields)

    def init(params: WireParams, dt_s: float) -> WireState:
        state = WireState(
            buffer(max(len(fields), 1)), buffer(max(len(fields), 1)), buffer(size, NAN), buffer(size, NAN)
        )
        for i in range(len(fields)):
            state.wait_ticks[i] = float(params.wait_ticks[i])
            state.unproven[i] = float(params.unproven[i])
        return state

    return Block(init, STEPS[group], _params([field for field, _ in fields], periods, waits, unproven))


def fields_of(codec: Codec, group: str) -> list[tuple[FieldMap, MessageMap]]:
    """The fields of a group with their messages, in the order of WireParams."""
    messages = codec.commands if group == "command" else codec.telemetry
    return [(field, message) for message in messages for field in message.fields if field.group == group]


def _params(fields: list[FieldMap], periods: list[int], waits: list[int], unproven: list[int]) -> WireParams:
    terms = [term for field in fields for term in field.terms]
    first_terms = [0]
    for field in fields:
        first_terms.append(first_terms[-1] + len(field.terms))
    return WireParams(
        index=table(field.index for field in fields),
        period_ticks=table(periods),
        wait_ticks=table(waits),
        unproven=table(unproven),
        scale=table(field.scale for field in fields),
        offset=table(field.offset for field in fields),
        turn_low=table(field.turn.low_rad for field in fields),
        raw_turn=table(field.turn.raw_turn for field in fields),
        first_term=table(first_terms),
        term_scale=table(term.scale for term in terms),
        factor=table(term.signal.factor for term in terms),
        signal_offset=table(term.signal.offset for term in terms),
        raw_low=table(term.signal.raw_low for term in terms),
        raw_high=table(term.signal.raw_high for term in terms),
    )


def phases(codec: Codec, seed: int) -> dict[str, int]:
    """The tick of its period on which each message goes out: drawn from the seed, the same on every machine."""
    chance = random.Random(seed)
    messages = sorted((*codec.commands, *codec.telemetry), key=lambda message: (message.key, message.channel))
    return {message.name: chance.randrange(message.period_ticks) for message in messages}
