"""Checks a message's end-to-end protection: profile, data ids, and the signals that carry it."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING, NamedTuple

from tunefree_hil.bus.dbc.e2e import DATA_IDS, ID_MODES, MODULI, PROFILES
from tunefree_hil.bus.dbc.network import nearest

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

    from tunefree_hil.config.schema import E2eSpec

BITS = {"crc": 8, "counter": 4, "nibble": 4}


class ProtectionProblem(NamedTuple):
    """A key of an `e2e` table that does not fit its message."""

    key: str
    message: str
    hint: str
    code: str = "vehicle"


def check_protection(key: str, e2e: E2eSpec, message: Message, used: Collection[str]) -> Iterator[ProtectionProblem]:
    """Every problem of one `e2e` table. `used`: signals of the message that hold values of their own."""
    if e2e.profile not in PROFILES:
        known = ", ".join(PROFILES)
        yield ProtectionProblem(
            f"{key}.profile", f"unknown E2E profile {e2e.profile!r}", f"there is {known}", "unknown_e2e_profile"
        )
        return
    roles = ("crc", "counter", "nibble") if e2e.id_mode == "nibble" else ("crc", "counter")
    for role in roles:
        yield from _role(key, role, e2e, message, used)
    if e2e.profile != "none":
        yield from _data_ids(key, e2e)
        yield from _modes(key, e2e)


def _role(key: str, role: str, e2e: E2eSpec, message: Message, used: Collection[str]) -> Iterator[ProtectionProblem]:
    name, where = getattr(e2e, role), f"{key}.{role}"
    if not name:
        if e2e.profile != "none":
            yield ProtectionProblem(
                where, f"profile {e2e.profile} needs it", f"name the signal of {message.name} that holds it"
            )
        return
    signals = {signal.name: signal for signal in message.signals}
    if name not in signals:
        yield ProtectionProblem(where, f"message {message.name} has no signal {name!r}", nearest(name, signals))
    elif name in used:
        yield ProtectionProblem(where, f"{name} holds a value of its own", "name the signal that has this role")
    elif e2e.profile != "none":
        yield from _place(where, role, signals[name])


def _place(where: str, role: str, signal: Signal) -> Iterator[ProtectionProblem]:
    bits = BITS[role]
    if signal.length != bits or signal.is_signed or signal.conversion.is_float:
        sign = "signed, " if signal.is_signed else ""
        yield ProtectionProblem(
            where, f"{signal.name} is {sign}{signal.length} bits wide", f"it is unsigned, of {bits} bits"
        )
        return
    low = signal.start if signal.byte_order == "little_endian" else signal.start % 8 - bits + 1
    if low % bits:
        unit = "a byte" if bits == 8 else "half a byte"
        yield ProtectionProblem(
            where, f"{signal.name} is not {unit} by itself", f"its lowest bit is one of {_starts(bits)}"
        )


def _starts(bits: int) -> str:
    return "0, 8, 16, ..." if bits == 8 else "0, 4, 8, ..."


def _data_ids(key: str, e2e: E2eSpec) -> Iterator[ProtectionProblem]:
    count, largest = DATA_IDS[e2e.profile]
    if e2e.id_mode == "nibble":
        largest = 0xFFF
    if len(e2e.data_ids) != count:
        expected = "one data id" if count == 1 else f"{count} data ids, by counter"
        yield ProtectionProblem(
            f"{key}.data_ids", f"{len(e2e.data_ids)} given", f"profile {e2e.profile} has {expected}"
        )
    for i, data_id in enumerate(e2e.data_ids):
        if not 0 <= data_id <= largest:
            yield ProtectionProblem(f"{key}.data_ids[{i}]", f"{data_id} does not fit", f"give 0 to {largest}")


def _modes(key: str, e2e: E2eSpec) -> Iterator[ProtectionProblem]:
    allowed = ("", *ID_MODES) if e2e.profile == "P01" else ("",)
    if e2e.id_mode not in allowed:
        hint = f"there is {', '.join(ID_MODES)}" if e2e.profile == "P01" else "profile 2 has no id mode: remove the key"
        yield ProtectionProblem(f"{key}.id_mode", f"no id mode {e2e.id_mode!r}", hint)
    most = MODULI[e2e.profile] - 2
    if not 1 <= e2e.max_delta <= most:
        yield ProtectionProblem(f"{key}.max_delta", f"{e2e.max_delta} is no step", f"give 1 to {most}")
