"""Checks a vehicle.toml against its DBC and lists all problems (`doctor --vehicle`, and every codec).

config/check_vehicle.py checks vehicle.toml by itself when it is loaded.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.dbc.build_map import ROLES, Entry, by_message, entries, period_ms
from tunefree_hil.bus.dbc.check_protection import check_protection
from tunefree_hil.bus.dbc.check_units import check_unit
from tunefree_hil.bus.dbc.network import bit_range, declared_raw, nearest, overlaps, raw_range, read_network, signal_map

if TYPE_CHECKING:
    from cantools.database.can import Message

    from tunefree_hil.config.schema import E2eSpec, VehicleSpec

MOST_BITS = 52  # a raw value stays exact in binary64


def check_vehicle(spec: VehicleSpec, network: Mapping[str, Message] | None = None) -> list[InputError]:
    """Every problem of a folder, each with key and hint; an empty list means that a Codec can be made of it."""
    if network is None:
        network = read_network(spec)
    unique = {(problem.key, problem.message): problem for problem in _Check(spec, network).run()}
    return list(unique.values())  # a mistake in a field of four wheels is one


def one_error(problems: list[InputError]) -> InputError:
    """One error that lists all of them."""
    if len(problems) == 1:
        return problems[0]
    listed = "\n".join(f"  {problem.key}: {problem.message} ({problem.hint})" for problem in problems)
    return InputError(
        f"{len(problems)} things do not fit:\n{listed}", code="vehicle", file=problems[0].file, hint="correct them all"
    )


class _Check:
    """One run over one folder."""

    def __init__(self, spec: VehicleSpec, network: Mapping[str, Message]) -> None:
        self.spec = spec
        self.network = network
        self.file = str(Path(spec.folder) / "vehicle.toml")
        self.entries = entries(spec)

    def run(self) -> Iterator[InputError]:
        for entry in self.entries:
            yield from self._entry(entry)
        for name, extra in self.spec.extra.items():
            if (yield from self._message(f"extra.{name}", name)):
                yield from self._constants(f"extra.{name}", name, extra.constants)
                yield from self._protection(f"extra.{name}", name, extra.e2e, extra.constants)
        yield from self._states()
        for (name, _), members in by_message(self.entries).items():
            if name in self.network:
                yield from self._together(name, members)
        for name in sorted(self._used()):
            yield from self._layout(self.network[name])
        yield from self._identifiers()

    def problem(self, key: str, message: str, hint: str, code: str = "vehicle") -> InputError:
        return InputError(message, code=code, file=self.file, key=key, hint=hint)

    def _used(self) -> set[str]:
        names = {entry.spec.message for entry in self.entries} | set(self.spec.extra)
        names |= {state.message for states in self.spec.state.values() for state in states}
        return names & self.network.keys()

    def _message(self, key: str, name: str) -> Generator[InputError, None, bool]:
        """Yields a problem and gives False where the DBC has no such message."""
        if name in self.network:
            return True
        yield self.problem(f"{key}.message", f"the DBC has no message {name!r}", nearest(name, self.network))
        return False

    def _signal(self, key: str, message: str, name: str) -> Generator[InputError, None, bool]:
        known = {signal.name for signal in self.network[message].signals}
        if name in known:
            return True
        yield self.problem(key, f"message {message} has no signal {name!r}", nearest(name, known))
        return False

    def _entry(self, entry: Entry) -> Iterator[InputError]:
        message = entry.spec.message
        if not (yield from self._message(entry.key, message)):
            return
        for name, scale in entry.parts:
            if (yield from self._signal(f"{entry.key}.signal", message, name)):
                yield from self._value_signal(entry, name)
                unit = self.network[message].get_signal_by_name(name).unit
                wrong = check_unit(entry.name, unit, scale * entry.spec.scale)
                if wrong:
                    yield self.problem(f"{entry.key}.scale", f"{name}: {wrong[0]}", wrong[1])
        for role in ROLES:
            name = getattr(entry.spec, role)
            if name and (yield from self._signal(f"{entry.key}.{role}", message, name)):
                yield from self._role_signal(entry, role, name)
        yield from self._constants(entry.key, message, entry.spec.constants)
        used = [*(part for part, _ in entry.parts), *entry.spec.constants]
        yield from self._protection(entry.key, message, entry.spec.e2e, used)

    def _value_signal(self, entry: Entry, name: str) -> Iterator[InputError]:
        message = self.network[entry.spec.message]
        signal = signal_map(message.get_signal_by_name(name), message.length)
        key = f"{entry.key}.signal"
        if signal.is_float or signal.bits > MOST_BITS:
            defect = "is a floating-point signal" if signal.is_float else f"has {signal.bits} bits"
            yield self.problem(
                key, f"{name} {defect}", f"record fields are read from integers of up to {MOST_BITS} bits"
            )
        elif signal.factor == 0 or signal.raw_low >= signal.raw_high:
            yield self.problem(key, f"{name} has one value only", "correct its factor or range in the DBC")
        elif entry.name == "heading_rad":
            steps = (signal.raw_high - signal.raw_low + 1.5) * abs(signal.factor * entry.spec.scale)
            if steps < 2.0 * math.pi:
                yield self.problem(key, f"{name} reaches {steps:.3f} rad, less than one turn", "correct range or scale")

    def _role_signal(self, entry: Entry, role: str, name: str) -> Iterator[InputError]:
        signal = self.network[entry.spec.message].get_signal_by_name(name)
        key = f"{entry.key}.{role}"
        if name in [part for part, _ in entry.parts]:
            yield self.problem(key, f"{name} is the field's own value", "name the signal that has this role")
        elif role == "counter" and (signal.length < 2 or signal.length > 16 or signal.is_signed):
            sign = "signed, " if signal.is_signed else ""
            yield self.problem(
                key, f"{name} is {sign}{signal.length} bits wide", "a counter is unsigned, of 2 to 16 bits"
            )
        elif role in ("enable", "clear", "ignore") and signal.conversion.is_float:
            yield self.problem(key, f"{name} is a floating-point signal", "name a bit or a whole number")

    def _constants(self, key: str, message: str, constants: Mapping[str, float]) -> Iterator[InputError]:
        for name, value in constants.items():
            where = f"{key}.constants.{name}"
            if not (yield from self._signal(where, message, name)):
                continue
            signal = self.network[message].get_signal_by_name(name)
            if signal.conversion.is_float:
                yield self.problem(
                    where, f"{name} is a floating-point signal", "leave it out: constants are whole numbers"
                )
                continue
            low, high = raw_range(signal)
            raw = (value - signal.offset) / signal.scale if signal.scale else math.nan
            if not low - 0.5 <= raw <= high + 0.5:
                ends = f"{low * signal.scale + signal.offset:g} to {high * signal.scale + signal.offset:g}"
                yield self.problem(where, f"{value:g} is outside the range of {name}", f"its range is {ends}")

    def _protection(self, key: str, name: str, e2e: E2eSpec, used: Iterable[str]) -> Iterator[InputError]:
        for problem in check_protection(f"{key}.e2e", e2e, self.network[name], set(used)):
            yield self.problem(*problem)

    def _states(self) -> Iterator[InputError]:
        for condition, states in self.spec.state.items():
            for i, state in enumerate(states):
                key = f"state.{condition}[{i}]"
                if not (yield from self._message(key, state.message)):
                    continue
                if not (yield from self._signal(f"{key}.signal", state.message, state.signal)):
                    continue
                yield from self._cycle(key, state.message)
                low, high = bit_range(self.network[state.message].get_signal_by_name(state.signal))
                if not low <= state.active <= high or state.active != int(state.active):
                    yield self.problem(
                        f"{key}.active", f"{state.signal} never reads {state.active:g}", f"it reads {low} to {high}"
                    )

    def _cycle(self, key: str, name: str) -> Iterator[InputError]:
        """The DBC's period of a message that only a state reads."""
        mapped = {entry.spec.message for entry in self.entries} | set(self.spec.extra)
        cycle_ms = self.network[name].cycle_time or 0
        if name not in mapped and cycle_ms % max(self.spec.tick_ms, 1):
            hint = f"[extra.{name}] with a period_ms, or a tick_ms that divides it"
            yield self.problem(key, f"the DBC sends {name} every {cycle_ms} ms, no multiple of the tick", hint)

    def _together(self, name: str, members: list[Entry]) -> Iterator[InputError]:
        """What the fields of one message must agree on."""
        first = members[0]
        for attribute in ("period_ms", *ROLES):
            values = {getattr(entry.spec, attribute): entry.key for entry in members if getattr(entry.spec, attribute)}
            if len(values) > 1:
                listed = " and ".join(f"{value} by [{key}]" for value, key in values.items())
                yield self.problem(f"{first.key}.{attribute}", f"{name} has {listed}", "a message has one")
        protected = [entry for entry in members if entry.spec.e2e.profile != "none"]
        for entry in protected[1:]:
            if entry.spec.e2e != protected[0].spec.e2e:
                hint = f"give both the same, or leave it to [{protected[0].key}]"
                yield self.problem(f"{entry.key}.e2e", f"[{protected[0].key}] protects {name} otherwise", hint)
        if len({entry.group == "command" for entry in members}) > 1:
            yield self.problem(first.key, f"{name} is both command and report", "a message goes one way")
        cycle_ms, period = self.network[name].cycle_time, period_ms(self.spec, self.network[name], members)
        if cycle_ms and period and cycle_ms != period:
            yield self.problem(
                f"{first.key}.period_ms", f"{period}, but the DBC has {cycle_ms} for {name}", "give both the same"
            )
        yield from self._shared_signals(name, members)

    def _shared_signals(self, name: str, members: list[Entry]) -> Iterator[InputError]:
        users: dict[str, str] = {}
        for entry in members:
            for signal, _ in entry.parts:
                user = users.setdefault(signal, f"{entry.group}.{entry.name}")
                if user != f"{entry.group}.{entry.name}":
                    yield self.problem(
                        entry.key,
                        f"{signal} of {name} is also {user}",
                        "a signal is one field: list one as absent",
                    )
            for constant in entry.spec.constants:
                if constant in users:
                    yield self.problem(
                        f"{entry.key}.constants.{constant}", f"it is {users[constant]} too", "remove the constant"
                    )
        yield from self._two_meanings(name, members, users)

    def _two_meanings(self, name: str, members: list[Entry], users: Mapping[str, str]) -> Iterator[InputError]:
        """A signal that is a field's value is read as one; a counter or a state is read as bare bits."""
        roles = {
            signal: f"{entry.key}.{role}"
            for entry in members
            for role in ROLES
            if (signal := getattr(entry.spec, role)) and users.get(signal) != f"{entry.group}.{entry.name}"
        }  # its own value as a role is reported already
        states = {
            state.signal: f"state.{condition}[{i}]"
            for condition, listed in self.spec.state.items()
            for i, state in enumerate(listed)
            if state.message == name
        }
        for signal, key in {**states, **roles}.items():
            if signal in users:
                yield self.problem(key, f"{signal} of {name} is also {users[signal]}", "a signal has one meaning")
        constants: dict[str, tuple[float, str]] = {}
        for entry in members:
            for constant, value in entry.spec.constants.items():
                before, key = constants.setdefault(constant, (value, entry.key))
                if before != value:
                    message = f"{constant} is {value:g} here and {before:g} in [{key}]"
                    yield self.problem(f"{entry.key}.constants.{constant}", message, "a message has one")

    def _layout(self, message: Message) -> Iterator[InputError]:
        where = f"message {message.name}"
        if message.is_multiplexed():
            yield self.problem(where, "it is multiplexed", "multiplexed messages are not supported; map another one")
            return
        for first, second in overlaps(message):
            yield self.problem(where, f"{first} and {second} overlap in the DBC", "correct their start bits or lengths")
        for signal in message.signals:
            end = signal_map(signal, message.length).end_bit
            if end > 8 * message.length:
                yield self.problem(
                    where,
                    f"{signal.name} ends in byte {(end - 1) // 8}, the message has {message.length}",
                    "correct the DBC",
                )
            declared, (low, high) = declared_raw(signal), bit_range(signal)
            if signal.scale and declared is not None and (declared[0] > high or declared[1] < low):
                yield self.problem(where, f"{signal.name} can never be in its [min|max]", "correct them in the DBC")
        if (message.length > 8 or message.is_fd) and self.spec.data_bitrate is None:
            yield self.problem("data_bitrate", f"{message.name} is a CAN FD message", "give the bus's data bit rate")

    def _identifiers(self) -> Iterator[InputError]:
        channels: dict[str, set[str]] = {}
        for name, channel in by_message(self.entries):
            channels.setdefault(name, set()).add(channel)
        seen: dict[tuple[bool, int, str], str] = {}
        for name in sorted(self._used()):
            message = self.network[name]
            for channel in channels.get(name, {""}):
                place = (message.is_extended_frame, message.frame_id, channel)
                holder = seen.setdefault(place, name)
                if holder != name:
                    yield self.problem(
                        f"message {name}", f"it has the id of {holder}, 0x{message.frame_id:X}", "give one a `channel`"
                    )
