"""Builds MessageMaps, message by message, from the tables of vehicle.toml, field by field."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, NamedTuple

from tunefree_hil.base.records import GROUPS, WHEEL_FIELDS
from tunefree_hil.bus.dbc.e2e import Nibble, Protection
from tunefree_hil.bus.dbc.encode_plan import heading_turn, make_plan, sort_terms
from tunefree_hil.bus.dbc.message_map import (
    BYWIRE_PREFIXES,
    COMMAND,
    TELEMETRY,
    FieldMap,
    MessageMap,
    SignalMap,
    StateMap,
    Term,
    Turn,
)
from tunefree_hil.bus.dbc.network import signal_map

if TYPE_CHECKING:
    from cantools.database.can import Message

    from tunefree_hil.config.schema import E2eSpec, ExtraSpec, FieldSpec, VehicleSpec

ROLES = ("enable", "clear", "ignore", "counter", "checksum")
WHEELS = "wheel_speed_radps"


class Entry(NamedTuple):
    """One record field of vehicle.toml: `key` is 'report.speed_mps', a wheel's own name where four are listed."""

    key: str
    group: str
    name: str
    spec: FieldSpec
    parts: tuple[tuple[str, float], ...]  # signal, scale


LEAST_COUNTER = 3  # that a DBC declares as a counter's highest value: what counts less far is a default range


def entries(spec: VehicleSpec) -> list[Entry]:
    """Every mapped record field, `wheel_speed_radps` as its four."""
    mapped = []
    for group in GROUPS:
        for name, field in getattr(spec, group).items():
            names = WHEEL_FIELDS if name == WHEELS else (name,)
            for place, field_name in enumerate(names):
                mapped.append(Entry(f"{group}.{name}", group, field_name, field, field_signals(field, place)))
    return [entry for entry in mapped if entry.name in GROUPS[entry.group]._fields]


def field_signals(field: FieldSpec, place: int = 0) -> tuple[tuple[str, float], ...]:
    """The signals of a field with their scale in the sum; `place` in the list where there is one signal a wheel."""
    if field.signals:
        return tuple((term.name, term.scale) for term in field.signals)
    if isinstance(field.signal, str):
        return ((field.signal, 1.0),) if field.signal else ()
    return ((field.signal[place], 1.0),) if place < len(field.signal) else ()


def by_message(mapped: Iterable[Entry]) -> dict[tuple[str, str], list[Entry]]:
    """Entries by (message, channel)."""
    table: dict[tuple[str, str], list[Entry]] = {}
    for entry in mapped:
        table.setdefault((entry.spec.message, entry.spec.channel), []).append(entry)
    return table


def build_messages(spec: VehicleSpec, network: Mapping[str, Message]) -> list[MessageMap]:
    """All messages that the folder names, in id order. The folder has passed check_vehicle."""
    table = by_message(entries(spec))
    for name, extra in spec.extra.items():
        table.setdefault((name, extra.channel), [])
    named = {name for name, _ in table}
    for state in (state for states in spec.state.values() for state in states):
        if state.message not in named:
            table.setdefault((state.message, ""), [])
    maps = [_build(spec, network[name], channel, members) for (name, channel), members in table.items()]
    return sorted(maps, key=lambda message: (message.extended, message.can_id, message.channel))


def _build(spec: VehicleSpec, message: Message, channel: str, members: list[Entry]) -> MessageMap:
    signals = {signal.name: signal_map(signal, message.length) for signal in message.signals}
    fields = tuple(_field(entry, signals) for entry in members)
    roles = {role: _first(getattr(entry.spec, role) for entry in members) for role in ROLES}
    extra = spec.extra.get(message.name)
    declarations = [*(entry.spec for entry in members), *([extra] if extra else [])]
    e2e = _e2e(declarations)
    if e2e is not None:
        roles["counter"] = roles["counter"] or e2e.counter
        roles["checksum"] = roles["checksum"] or e2e.crc
    protection = _protection(e2e, signals, message.length)
    states = _states(spec, message.name)
    constants = {name: value for one in reversed(declarations) for name, value in one.constants.items()}
    raw = {name for name in roles.values() if name} | {state.signal for state in states}
    return MessageMap(
        name=message.name,
        can_id=message.frame_id,
        extended=message.is_extended_frame,
        fd=bool(message.is_fd) or message.length > 8,
        length=message.length,
        kind=_kind(spec, message.name, members),
        period_ticks=period_ms(spec, message, members) // spec.tick_ms,
        timeout_ticks=max((entry.spec.timeout_ms for entry in members), default=0) // spec.tick_ms,
        fields=fields,
        counter_modulus=_modulus(protection, signals, roles["counter"]),
        channel=channel,
        allow_truncated=any(one.allow_truncated for one in declarations),
        bywire=_bywire(fields, states),
        states=states,
        signals=signals,
        plan=make_plan(signals, fields, raw, constants),
        unproven_frames=1 if protection else 0,
        e2e=protection,
        e2e_max_delta=e2e.max_delta if e2e else 1,
        **roles,
    )


def _e2e(declarations: Iterable[FieldSpec | ExtraSpec]) -> E2eSpec | None:
    """A message's protection: as declared by any of its fields, or its [extra] entry. None: none."""
    declared = [one.e2e for one in declarations]
    chosen = [one for one in declared if one.profile != "none"] or [one for one in declared if one.counter]
    return chosen[0] if chosen else None


def _protection(e2e: E2eSpec | None, signals: Mapping[str, SignalMap], length: int) -> Protection | None:
    if e2e is None or e2e.profile == "none":
        return None

    def nibble(name: str) -> Nibble:
        byte, bit = _lowest_bit(signals[name], length)
        return Nibble(byte, bit)

    id_mode = (e2e.id_mode or "both") if e2e.profile == "P01" else ""
    return Protection(
        e2e.profile,
        tuple(e2e.data_ids),
        id_mode,
        _lowest_bit(signals[e2e.crc], length)[0],
        nibble(e2e.counter),
        nibble(e2e.nibble) if id_mode == "nibble" else None,
    )


def _lowest_bit(signal: SignalMap, length: int) -> tuple[int, int]:
    """(byte, bit in it) of a signal's lowest bit."""
    byte = signal.shift // 8
    return (length - 1 - byte if signal.big_endian else byte), signal.shift % 8


def _modulus(protection: Protection | None, signals: Mapping[str, SignalMap], counter: str) -> int:
    """The value at which the counter rolls over; 0 where there is none."""
    if protection is not None:
        return protection.modulus
    if not counter:
        return 0
    signal = signals[counter]
    declared = signal.raw_low == 0 and signal.raw_high >= LEAST_COUNTER
    return signal.raw_high + 1 if declared else 1 << signal.bits


def _first(names: Iterable[str]) -> str:
    return next((name for name in names if name), "")


def _kind(spec: VehicleSpec, name: str, members: list[Entry]) -> str:
    if members:
        return COMMAND if members[0].group == "command" else TELEMETRY
    return spec.extra[name].kind if name in spec.extra else TELEMETRY


def period_ms(spec: VehicleSpec, message: Message, members: list[Entry]) -> int:
    """A message's period: its fields', its [extra] entry's, the DBC's GenMsgCycleTime, or one tick."""
    if members:
        return members[0].spec.period_ms
    if message.name in spec.extra:
        return spec.extra[message.name].period_ms
    return message.cycle_time or spec.tick_ms


def _field(entry: Entry, signals: Mapping[str, SignalMap]) -> FieldMap:
    field = entry.spec
    terms = sort_terms(Term(signals[name], scale) for name, scale in entry.parts)
    index = GROUPS[entry.group]._fields.index(entry.name)
    turn = heading_turn(terms, field.scale, field.offset) if entry.name == "heading_rad" else Turn()
    return FieldMap(entry.group, entry.name, index, terms, field.scale, field.offset, turn)


def _states(spec: VehicleSpec, name: str) -> tuple[StateMap, ...]:
    return tuple(
        StateMap(condition, state.signal, state.active, state.effect, state.bywire, state.cause)
        for condition, states in spec.state.items()
        for state in states
        if state.message == name
    )


def _bywire(fields: Iterable[FieldMap], states: Iterable[StateMap]) -> tuple[str, ...]:
    """The channels of the message's fields; of its states where it has no field."""
    bywire: set[str] = set()
    for field in fields:
        for prefix, channels in BYWIRE_PREFIXES.items():
            if f"{field.group}.{field.name}".startswith(prefix):
                bywire.update(channels)
    return tuple(sorted((bywire or {state.bywire for state in states}) - {""}))
