"""End-to-end protection by AUTOSAR's profiles 1 and 2: the CRC's coverage, and the places of CRC and counter.

From AUTOSAR's E2E protocol specification. Profile 1: CRC-8 of polynomial 0x1D over the data id's bytes (which of
them: the id mode) and all data but the CRC byte; the library's start and final values cancel out, so both are 0, not
the 0xFF of catalogue CRC-8/SAE-J1850. Counter 0..14. Profile 2: polynomial 0x2F, start and final value 0xFF, over all
data but the CRC byte and then the one of 16 data ids that the counter chooses. Counter 0..15.

The places come from vehicle.toml (`e2e.crc`, `e2e.counter`, `e2e.nibble` name signals of the DBC).
"""

from __future__ import annotations

from typing import NamedTuple

ID_MODES = ("both", "alternating", "low", "nibble")  # profile 1: which bytes of the data id the CRC takes in
MODULI = {"P01": 15, "P02": 16}  # counters 0..14 and 0..15
PROFILES = ("none", *MODULI)  # what vehicle.toml may name
DATA_IDS = {"P01": (1, 0xFFFF), "P02": (16, 0xFF)}  # how many, and the largest


def crc_table(polynomial: int) -> bytes:
    """The 256 steps of a CRC-8, most significant bit first."""
    table = bytearray(256)
    for value in range(256):
        crc = value
        for _ in range(8):
            crc = crc << 1 ^ polynomial if crc & 0x80 else crc << 1
        table[value] = crc & 0xFF
    return bytes(table)


TABLE_1D = crc_table(0x1D)
TABLE_2F = crc_table(0x2F)


def crc8(table: bytes, data: bytes, crc: int) -> int:
    """Run `data` through a CRC that stands at `crc`."""
    for byte in data:
        crc = table[crc ^ byte]
    return crc


class Nibble(NamedTuple):
    """Four bits of a payload."""

    byte: int
    shift: int  # 0: the low ones, 4: the high ones


class Protection(NamedTuple):
    """How a message is protected; the places as bytes and nibbles of the payload."""

    profile: str  # of MODULI
    data_ids: tuple[int, ...]
    id_mode: str  # of ID_MODES; '' in profile 2
    crc_at: int
    counter_at: Nibble
    id_nibble_at: Nibble | None = None  # profile 1, id mode nibble: where bits 8..11 of the data id stand

    @property
    def modulus(self) -> int:
        return MODULI[self.profile]


def read_nibble(data: bytes, place: Nibble) -> int:
    """The four bits, 0 to 15."""
    return data[place.byte] >> place.shift & 0xF


def put_nibble(data: bytearray, place: Nibble, value: int) -> None:
    """Set the four bits, leave their neighbours."""
    data[place.byte] = data[place.byte] & (0xF0 >> place.shift) | (value & 0xF) << place.shift


def crc_of(protection: Protection, data: bytes) -> int:
    """The CRC that a payload must carry, whatever its CRC byte is."""
    index, counter = protection.crc_at, read_nibble(data, protection.counter_at)
    covered = data[:index] + data[index + 1 :]
    if protection.profile == "P02":
        return crc8(TABLE_2F, covered + bytes((protection.data_ids[counter],)), 0xFF) ^ 0xFF
    return crc8(TABLE_1D, _id_bytes(protection, counter) + covered, 0)


def _id_bytes(protection: Protection, counter: int) -> bytes:
    """What profile 1 puts before the data: both bytes, one of them in turn, the low one, or the low one and a 0."""
    low, high = protection.data_ids[0] & 0xFF, protection.data_ids[0] >> 8
    if protection.id_mode == "both":
        return bytes((low, high))
    if protection.id_mode == "alternating":
        return bytes((high if counter % 2 else low,))
    return bytes((low, 0)) if protection.id_mode == "nibble" else bytes((low,))


def protect(protection: Protection, payload: bytes, counter: int) -> bytes:
    """The payload with counter, data id nibble (where there is one) and CRC put in."""
    data = bytearray(payload)
    put_nibble(data, protection.counter_at, counter)
    if protection.id_nibble_at is not None:
        put_nibble(data, protection.id_nibble_at, protection.data_ids[0] >> 8)
    return with_crc(protection, data)


def with_crc(protection: Protection, payload: bytes | bytearray) -> bytes:
    """The payload as it is, with the CRC that fits it."""
    data = bytearray(payload)
    data[protection.crc_at] = crc_of(protection, bytes(data))
    return bytes(data)


def is_intact(protection: Protection, data: bytes) -> bool:
    """Whether CRC (and data id nibble) fit. A payload that ends before them does not."""
    if len(data) <= max(protection.crc_at, protection.counter_at.byte):
        return False
    if data[protection.crc_at] != crc_of(protection, data):
        return False
    place = protection.id_nibble_at
    if place is None:
        return True
    return len(data) > place.byte and read_nibble(data, place) == protection.data_ids[0] >> 8 & 0xF
