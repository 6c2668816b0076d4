"""Scripted faults at the bus: frames of a node, disturbed between encode and send.

So they work on every bus, DONE counts the frames really sent, and a drive with faults is reproducible: random numbers
depend on (the fault's seed, tick) alone. A disturbed counter carries the CRC that fits it, a disturbed CRC the right
counter, as in CANoe.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import NamedTuple

from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.dbc.e2e import protect, put_nibble, read_nibble, with_crc
from tunefree_hil.bus.dbc.message_map import MessageMap
from tunefree_hil.bus.recording.frame_attribution import can_key

SEED_STEP = 1 << 32  # seed and tick in one number


class ScriptedFault(NamedTuple):
    """One [[faults]] entry of a bench file, resolved. Active at ticks from_tick <= k < to_tick."""

    index: int  # its number in the bench file
    code: int  # its kind's number
    kind: str
    from_tick: int
    to_tick: int
    value: int = 0
    seed: int = 1
    message: MessageMap | None = None  # None: peer_stop, driver_override

    def active(self, k: int) -> bool:
        return self.from_tick <= k < self.to_tick

    def chance(self, k: int) -> random.Random:
        """The same draws at the same tick, whatever came before."""
        return random.Random(self.seed * SEED_STEP + k)


class FaultFilter:
    """The faults of one node in one episode."""

    def __init__(self, faults: Sequence[ScriptedFault] = ()) -> None:
        self.faults = tuple(faults)
        self._by_key: dict[int, list[ScriptedFault]] = {}
        for fault in self.faults:
            if fault.message is not None:
                self._by_key.setdefault(fault.message.key, []).append(fault)
        self._stops = [fault for fault in self.faults if fault.kind == "peer_stop"]
        self._last: dict[int, bytes] = {}  # by id: the payload last sent without a fault
        self._held: dict[int, list[CanFrame]] = {}  # by the tick at which they go out

    def begun(self, k: int) -> list[ScriptedFault]:
        """Faults that begin at tick k."""
        return [fault for fault in self.faults if fault.from_tick == k]

    def apply(self, k: int, frames: list[CanFrame], dt_s: float) -> list[CanFrame]:
        """What is sent at tick k instead of `frames`. Frames held back go out first, stamped with tick k."""
        if not self.faults:
            return frames
        sent = [frame._replace(time_s=k * dt_s) for frame in self._held.pop(k, ())]
        for frame in frames:
            sent += self._disturb(k, frame)
        return [] if any(fault.active(k) for fault in self._stops) else sent

    def _disturb(self, k: int, frame: CanFrame) -> list[CanFrame]:
        key = can_key(frame)
        mine = self._by_key.get(key)
        if mine is None:
            return [frame]
        active = [fault for fault in mine if fault.active(k)]
        if not active:
            self._last[key] = frame.data
            return [frame]
        before = self._last.setdefault(key, frame.data)
        copies = 1
        for fault in active:
            if fault.kind == "drop":
                return []
            if fault.kind == "delay":
                self._held.setdefault(k + fault.value, []).append(frame)
                return []
            if fault.kind in ("duplicate", "burst"):
                copies += fault.value if fault.kind == "burst" else 1
            else:
                frame = frame._replace(data=CHANGES[fault.kind](fault, k, frame.data, before))
        return [frame] * copies


Change = Callable[[ScriptedFault, int, bytes, bytes], bytes]  # fault, tick, payload, payload before the fault


def _corrupt(fault: ScriptedFault, k: int, data: bytes, before: bytes) -> bytes:
    changed = bytearray(data)
    for bit in fault.chance(k).sample(range(8 * len(data)), min(fault.value, 8 * len(data))):
        changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def _stale(fault: ScriptedFault, k: int, data: bytes, before: bytes) -> bytes:
    return before


def _crc(choose: Callable[[ScriptedFault, int, int, int], int]) -> Change:
    """choose(fault, tick, right CRC, CRC before the fault) -> the CRC that is sent."""

    def change(fault: ScriptedFault, k: int, data: bytes, before: bytes) -> bytes:
        assert fault.message is not None and fault.message.e2e is not None  # bench/faults.py refuses others
        offset, changed = fault.message.e2e.crc_at, bytearray(data)
        changed[offset] = choose(fault, k, data[offset], before[offset]) & 0xFF
        return bytes(changed)

    return change


def _counter(choose: Callable[[ScriptedFault, int, int, int], int]) -> Change:
    """choose(fault, tick, right counter, counter before the fault) -> the counter that is sent."""

    def change(fault: ScriptedFault, k: int, data: bytes, before: bytes) -> bytes:
        assert fault.message is not None  # bench/faults.py refuses a message without a counter
        message = fault.message
        counter = choose(fault, k, read_counter(message, data), read_counter(message, before))
        return put_counter(message, data, counter)

    return change


def read_counter(message: MessageMap, data: bytes) -> int:
    """The counter of a payload; 0 where it ends before it."""
    if message.e2e is not None:
        return read_nibble(data, message.e2e.counter_at)
    return message.read_raw(message.counter, data)


def put_counter(message: MessageMap, data: bytes, counter: int) -> bytes:
    """The payload with another counter, and with the CRC that fits it. A short one is left as it is."""
    if message.e2e is not None:
        if counter >= message.counter_modulus:  # a value that no sender counts to, its CRC all the same right
            changed = bytearray(data)
            put_nibble(changed, message.e2e.counter_at, counter)
            return with_crc(message.e2e, changed)
        return protect(message.e2e, data, counter)
    if len(data) < message.length:
        return data
    mask, shift, others, big = message.plan.raws[message.counter]
    order = "big" if big else "little"
    return (int.from_bytes(data, order) & others | (counter & mask) << shift).to_bytes(len(data), order)


def _wrong(fault: ScriptedFault, k: int, right: int, count: int) -> int:
    """Any of `count` values but the right one."""
    return (right + fault.chance(k).randrange(1, count)) % count


def _modulus(fault: ScriptedFault) -> int:
    return fault.message.counter_modulus if fault.message is not None else 0


CHANGES: dict[str, Change] = {
    "corrupt": _corrupt,
    "stale": _stale,
    "crc_value": _crc(lambda fault, k, right, before: fault.value),
    "crc_freeze": _crc(lambda fault, k, right, before: before),
    "crc_random": _crc(lambda fault, k, right, before: _wrong(fault, k, right, 256)),
    "crc_offset": _crc(lambda fault, k, right, before: right + fault.value),
    "counter_value": _counter(lambda fault, k, right, before: fault.value),
    "counter_freeze": _counter(lambda fault, k, right, before: before),
    "counter_random": _counter(lambda fault, k, right, before: _wrong(fault, k, right, _modulus(fault))),
    "counter_offset": _counter(lambda fault, k, right, before: (right + fault.value) % _modulus(fault)),
}
