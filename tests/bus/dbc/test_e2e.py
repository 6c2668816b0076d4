"""Profiles 1 and 2: golden vectors, cantools' own arithmetic, and that no bit can flip unseen."""

from __future__ import annotations

import pytest
from cantools.autosar.end_to_end import compute_profile2_crc
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.bus.dbc.e2e import (
    ID_MODES,
    MODULI,
    Nibble,
    Protection,
    crc8,
    crc_table,
    is_intact,
    protect,
    put_nibble,
    read_nibble,
    with_crc,
)

IDS = tuple(range(40, 56))


def p01(mode: str, data_id: int = 0x123, crc_at: int = 0) -> Protection:
    nibble = Nibble(crc_at + 1, 4) if mode == "nibble" else None
    return Protection("P01", (data_id,), mode, crc_at, Nibble(crc_at + 1, 0), nibble)


P02 = Protection("P02", IDS, "", 0, Nibble(1, 0))


@pytest.mark.parametrize(
    ("mode", "golden"), [("both", "cc00"), ("alternating", "ce00"), ("low", "ce00"), ("nibble", "2a10")]
)
def test_golden_vectors_of_profile_1(mode: str, golden: str) -> None:
    """Eight zero bytes, data id 0x123, counter 0, by an implementation of others."""
    assert protect(p01(mode), bytes(8), 0).hex() == golden + "00" * 6


def test_the_catalogue_crc_of_that_polynomial_is_another_one() -> None:
    """The trap of A6: with start and final value 0xFF the same bytes give 0xB0."""
    covered = bytes((0x23, 0x01)) + bytes(7)
    assert crc8(crc_table(0x1D), covered, 0xFF) ^ 0xFF == 0xB0


def test_the_catalogue_crcs_have_their_check_values() -> None:
    """CRC-8/SAE-J1850 and CRC-8/AUTOSAR of '123456789': 0x4B and 0xDF."""
    assert crc8(crc_table(0x1D), b"123456789", 0xFF) ^ 0xFF == 0x4B
    assert crc8(crc_table(0x2F), b"123456789", 0xFF) ^ 0xFF == 0xDF


@given(st.binary(min_size=2, max_size=64), st.integers(0, 15))
def test_profile_2_is_what_cantools_computes(data: bytes, counter: int) -> None:
    protected = protect(P02, data, counter)
    assert protected[0] == compute_profile2_crc(protected, IDS[counter])
    assert protected[1] == data[1] & 0xF0 | counter and protected[2:] == data[2:]


def protections() -> st.SearchStrategy[Protection]:
    ids = st.integers(0, 0xFFF)
    first = st.builds(p01, st.sampled_from(ID_MODES), ids, st.integers(0, 6))
    return st.one_of(first, st.just(P02))


@given(protections(), st.binary(min_size=8, max_size=64), st.data())
def test_what_is_protected_is_intact_until_any_bit_flips(
    protection: Protection, data: bytes, draw: st.DataObject
) -> None:
    counter = draw.draw(st.integers(0, MODULI[protection.profile] - 1))
    protected = protect(protection, data, counter)
    assert is_intact(protection, protected) and read_nibble(protected, protection.counter_at) == counter
    bit = draw.draw(st.integers(0, 8 * len(data) - 1))
    flipped = bytearray(protected)
    flipped[bit // 8] ^= 1 << bit % 8
    assert not is_intact(protection, bytes(flipped))


@given(st.sampled_from(ID_MODES), st.binary(min_size=8, max_size=8), st.integers(0, 14))
def test_a_frame_of_another_sender_is_not_intact(mode: str, data: bytes, counter: int) -> None:
    """Masquerading: one bit of another data id, in the byte that the mode takes in at this counter."""
    other = 0x123 ^ (0x100 if mode == "alternating" and counter % 2 else 0x001)
    assert not is_intact(p01(mode, other), protect(p01(mode), data, counter))


def test_modes_take_in_what_they_say() -> None:
    """'low' is blind to the id's high byte, 'nibble' sees it in the payload, 'alternating' at odd counters only."""
    data = bytes(range(8))
    assert is_intact(p01("low", 0x923), protect(p01("low"), data, 3))
    assert not is_intact(p01("nibble", 0x923), protect(p01("nibble"), data, 3))
    assert is_intact(p01("alternating", 0x923), protect(p01("alternating"), data, 2))
    assert not is_intact(p01("alternating", 0x923), protect(p01("alternating"), data, 3))


def test_a_payload_that_ends_before_its_crc_is_not_intact() -> None:
    assert not is_intact(p01("both", crc_at=2), bytes(3))
    assert not is_intact(p01("both"), b"")


@given(st.binary(min_size=2, max_size=4), st.integers(0, 1), st.sampled_from([0, 4]), st.integers(0, 15))
def test_a_nibble_leaves_its_neighbours(data: bytes, byte: int, shift: int, value: int) -> None:
    place, changed = Nibble(byte, shift), bytearray(data)
    put_nibble(changed, place, value)
    assert read_nibble(bytes(changed), place) == value
    assert read_nibble(bytes(changed), Nibble(byte, 4 - shift)) == read_nibble(data, Nibble(byte, 4 - shift))
    assert changed[: place.byte] + changed[place.byte + 1 :] == data[: place.byte] + data[place.byte + 1 :]


@given(protections(), st.binary(min_size=8, max_size=12))
def test_a_crc_alone_can_be_renewed(protection: Protection, data: bytes) -> None:
    assert is_intact(protection, with_crc(protection, protect(protection, data, 3)))
