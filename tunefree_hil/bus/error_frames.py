"""Error frames of SocketCAN (linux/can/error.h): bus states that the kernel or an adapter reports, by name."""

from __future__ import annotations

from collections import Counter

from tunefree_hil.base.errors import BenchError

BUS_OFF, CONTROLLER = 0x40, 0x04
# classes of an error frame, in its id
ERROR_CLASSES = {
    0x001: "tx_timeout",
    0x002: "lost_arbitration",
    CONTROLLER: "controller",
    0x008: "protocol",
    0x010: "transceiver",
    0x020: "no_ack",
    BUS_OFF: "bus_off",
    0x080: "bus_error",
    0x100: "restarted",
    0x200: "counters",
}
# what the class `controller` means, in data byte 1
CONTROLLER_STATES = {
    0x01: "rx_overflow",
    0x02: "tx_overflow",
    0x04: "rx_warning",
    0x08: "tx_warning",
    0x10: "rx_passive",
    0x20: "tx_passive",
    0x40: "error_active",
}
STATE_AT = 1


def error_names(classes: int, data: bytes) -> list[str]:
    """The classes in an error frame's id, and the states of the controller in its data; ['no_class'] for none."""
    names = [name for bit, name in ERROR_CLASSES.items() if classes & bit]
    if classes & CONTROLLER and len(data) > STATE_AT:
        names += [name for bit, name in CONTROLLER_STATES.items() if data[STATE_AT] & bit]
    return names or ["no_class"]


def note_error(errors: Counter[str], classes: int, data: bytes, bus: str) -> None:
    """Count an error frame under each of its names. BenchError for bus-off."""
    errors.update(error_names(classes, data))
    require_bus_on(classes, bus)


def require_bus_on(classes: int, bus: str) -> None:
    """Raise BenchError for the error frame of bus-off."""
    if classes & BUS_OFF:
        raise BenchError(f"{bus} is bus-off", code="bus_off", hint="wiring, bit rate, another node that disturbs?")


def error_words(errors: Counter[str]) -> str:
    """'bus_error 1, tx_passive 2': the counts; '' for none."""
    return ", ".join(f"{name} {count}" for name, count in sorted(errors.items()))
