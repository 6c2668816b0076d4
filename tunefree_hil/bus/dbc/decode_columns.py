"""Decodes all frames of one message at once into columns, bit for bit as Codec.decode and Codec.values do.

An hour of log has about six million frames: too many to decode one by one in Python.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.bus.dbc.e2e import TABLE_1D, TABLE_2F, Nibble, Protection, is_intact
from tunefree_hil.bus.dbc.message_map import MessageMap, SignalMap

Array = np.ndarray

PAD = 0xFF  # Codec.decode pads a short payload with it
EXACT_BITS = 52  # integers below 2 to this are the same number in a double, and stay so through one multiplication
_TABLES = {"P01": np.frombuffer(TABLE_1D, dtype=np.uint8), "P02": np.frombuffer(TABLE_2F, dtype=np.uint8)}
_FLOATS = {16: (np.uint16, np.float16), 32: (np.uint32, np.float32), 64: (np.uint64, np.float64)}


class Payloads(NamedTuple):
    """Payloads as rows. data: uint8 [n, width], PAD beyond a payload's end; size: int [n], its bytes."""

    data: Array
    size: Array

    def of(self, rows: Array) -> Payloads:
        """Some of the rows, by mask or number."""
        return Payloads(self.data[rows], self.size[rows])


class Fields(NamedTuple):
    """values: float64 [n, fields] in SI, in the order of message.fields; is_present: bool [n, fields], in the frame."""

    values: Array
    is_present: Array


def payloads_of(frames: Sequence[bytes]) -> Payloads:
    """Payloads one by one as rows."""
    size = np.array([len(one) for one in frames], dtype=np.int64)
    width = max(1, int(size.max(initial=0)))
    joined = b"".join([one.ljust(width, b"\xff") for one in frames])
    return Payloads(np.frombuffer(joined, dtype=np.uint8).reshape(len(frames), width), size)


def fit(message: MessageMap, payloads: Payloads) -> Payloads:
    """The same payloads, each with the length of the DBC: excess bytes cut off, missing ones PAD."""
    data, length = payloads.data, message.length
    if data.shape[1] < length:
        wide = np.full((len(data), length), PAD, dtype=np.uint8)
        wide[:, : data.shape[1]] = data
        data = wide
    return Payloads(data[:, :length], np.minimum(payloads.size, length))


def are_long_enough(message: MessageMap, payloads: Payloads) -> Array:
    """bool [n]: MessageMap.fits of each."""
    return (payloads.size >= message.length) | message.allow_truncated


def are_intact(message: MessageMap, payloads: Payloads) -> Array:
    """bool [n]: whether end-to-end protection lets a payload of `fit` pass; all True where there is none."""
    whole = payloads.size >= message.length
    good = np.ones(len(whole), dtype=bool)
    if message.e2e is None:
        return good
    if whole.any():
        good[whole] = _fits_crc(message.e2e, payloads.data[whole])
    for i in np.flatnonzero(~whole).tolist():
        good[i] = is_intact(message.e2e, payloads.data[i, : payloads.size[i]].tobytes())
    return good


def decode_fields(message: MessageMap, payloads: Payloads) -> Fields:
    """The record fields of payloads of `fit`, as in Codec.values; where `is_present` is False a value is undefined."""
    shape = (len(payloads.size), len(message.fields))
    fields = Fields(np.empty(shape), np.ones(shape, dtype=bool))
    for place, (_, _, terms, scale, offset) in enumerate(message.plan.values):
        total = np.zeros(shape[0])
        with np.errstate(all="ignore"):  # floats on the wire may be infinite
            for name, term_scale in terms:
                total = total + decode_signal(message, name, payloads) * term_scale
                fields.is_present[:, place] &= is_there(message, name, payloads)
            fields.values[:, place] = total * scale + offset
    return fields


def is_there(message: MessageMap, name: str, payloads: Payloads) -> Array:
    """bool [n]: whether a signal's bits are all in the payload."""
    whole = payloads.size >= message.length
    return whole | (message.signals[name].end_bit <= 8 * payloads.size)


def decode_signal(message: MessageMap, name: str, payloads: Payloads) -> Array:
    """float64 [n]: the value of a signal as in Codec.decode, raw where it has a role or a state."""
    signal = message.signals[name]
    if signal.is_float:
        return _float_values(signal, payloads.data)
    steps = (*message.plan.reads_little, *message.plan.reads_big)
    factor, offset = next((step.factor, step.offset) for step in steps if step.name == name)
    if signal.bits + abs(int(factor)).bit_length() > EXACT_BITS:
        return _long_values(signal, factor, offset, payloads.data)
    raw = _raw(signal, payloads.data).astype(np.int64)
    if signal.signed:
        sign = 1 << (signal.bits - 1)
        raw = (raw ^ sign) - sign
    return raw.astype(np.float64) * factor + offset


def _raw(signal: SignalMap, data: Array) -> Array:
    """The bits of a signal of at most 64, uint64 [n]."""
    low, rest = divmod(signal.shift, 8)
    raw = np.zeros(len(data), dtype=np.uint64)
    for place in range((rest + signal.bits + 7) // 8):
        byte = data.shape[1] - 1 - (low + place) if signal.big_endian else low + place
        column = data[:, byte].astype(np.uint64)
        raw |= column >> np.uint64(rest) if place == 0 else column << np.uint64(8 * place - rest)
    return raw & np.uint64(signal.mask)


def _float_values(signal: SignalMap, data: Array) -> Array:
    whole, form = _FLOATS[signal.bits]
    with np.errstate(all="ignore"):  # any bits are a float: infinite, no number
        values = _raw(signal, data).astype(whole).view(form).astype(np.float64)
        return values * signal.factor + signal.offset


def _long_values(signal: SignalMap, factor: float, offset: float, data: Array) -> Array:
    """Integers that a double does not hold: as the codec reads them, one by one."""
    order = "big" if signal.big_endian else "little"
    sign = 1 << (signal.bits - 1) if signal.signed else 0
    numbers = (int.from_bytes(row.tobytes(), order) >> signal.shift & signal.mask for row in data)
    return np.array([float(((raw ^ sign) - sign) * factor + offset) for raw in numbers], dtype=np.float64)


def _fits_crc(protection: Protection, data: Array) -> Array:
    """bus/e2e.is_intact of payloads of full length."""
    counter = _nibble(data, protection.counter_at)
    covered = [data[:, i] for i in range(data.shape[1]) if i != protection.crc_at]
    table = _TABLES[protection.profile]
    if protection.profile == "P02":
        crc = _crc(table, [*covered, np.array(protection.data_ids, dtype=np.uint8)[counter]], 0xFF) ^ 0xFF
    else:
        crc = _crc(table, [*_id_columns(protection, counter), *covered], 0)
    good = crc == data[:, protection.crc_at]
    place = protection.id_nibble_at
    return good if place is None else good & (_nibble(data, place) == (protection.data_ids[0] >> 8 & 0xF))


def _crc(table: Array, columns: Iterable[Array], start: int) -> Array:
    crc = np.uint8(start)
    for column in columns:
        crc = table[crc ^ column]
    return np.asarray(crc)


def _nibble(data: Array, place: Nibble) -> Array:
    return data[:, place.byte] >> np.uint8(place.shift) & np.uint8(0xF)


def _id_columns(protection: Protection, counter: Array) -> list[Array]:
    """What profile 1 puts before the data (bus/dbc/e2e.py), a column a byte."""
    low, high = (np.full(len(counter), byte, dtype=np.uint8) for byte in divmod(protection.data_ids[0], 256)[::-1])
    if protection.id_mode == "both":
        return [low, high]
    if protection.id_mode == "alternating":
        return [np.where(counter % 2 == 1, high, low)]
    return [low, np.zeros_like(low)] if protection.id_mode == "nibble" else [low]
