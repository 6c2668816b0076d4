"""Rolling counters: what follows what. Protected messages: what a receiver makes of frames over time."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.e2e import Nibble, Protection, protect
from tunefree_hil.bus.dbc.integrity import (
    CounterStep,
    E2eStatus,
    Order,
    Receiver,
    check_counter,
)
from tunefree_hil.bus.dbc.message_map import MessageMap
from tunefree_hil.config.load import load_vehicle

CODEC = Codec(load_vehicle("mkz_bywire"))
BRAKE = CODEC.by_name["BRAKE_CMD"]


@given(st.integers(2, 256), st.integers(0, 600))
def test_a_counter_in_order_is_always_ok(modulus: int, frames: int) -> None:
    last = None
    for i in range(frames):
        assert check_counter(last, i % modulus, modulus).order is (Order.FIRST if i == 0 else Order.OK)
        last = i % modulus


@given(st.integers(3, 256), st.data())
def test_what_is_missing_is_counted(modulus: int, data: st.DataObject) -> None:
    last, lost = data.draw(st.integers(0, modulus - 1)), data.draw(st.integers(1, modulus - 2))
    heard = (last + lost + 1) % modulus
    assert check_counter(last, heard, modulus, max_delta=1) == CounterStep(Order.WRONG, lost)
    assert check_counter(last, heard, modulus, max_delta=lost + 1) == CounterStep(Order.SOME_LOST, lost)


def test_a_stuck_or_restarted_counter_is_noticed() -> None:
    assert check_counter(9, 9, 256).order is Order.REPEATED
    assert check_counter(200, 0, 256).order is Order.WRONG


def test_it_rolls_over_at_the_modulus() -> None:
    assert check_counter(255, 0, 256).order is Order.OK


def van_like(profile: str = "P02", max_delta: int = 1, period_ticks: int = 1) -> MessageMap:
    """A protected message of eight bytes."""
    ids = tuple(range(60, 76)) if profile == "P02" else (0x1D0,)
    return replace(
        BRAKE,
        e2e=Protection(profile, ids, "both" if profile == "P01" else "", 0, Nibble(1, 0)),
        e2e_max_delta=max_delta,
        counter_modulus=16 if profile == "P02" else 15,
        period_ticks=period_ticks,
        allow_truncated=False,
    )


def frame(message: MessageMap, counter: int) -> bytes:
    assert message.e2e is not None
    return protect(message.e2e, bytes(8), counter % message.counter_modulus)


PROFILE = pytest.mark.parametrize("profile", ["P01", "P02"])


@PROFILE
@given(data=st.data())
def test_a_receiver_names_what_happened(profile: str, data: st.DataObject) -> None:
    """From any state of good reception: repeated, n lost, wrong CRC; values are taken only where it may be."""
    max_delta = data.draw(st.integers(1, 6))
    message = van_like(profile, max_delta)
    receiver = Receiver(message)
    start = data.draw(st.integers(0, 40))
    assert receiver.receive(0, frame(message, start)) is E2eStatus.INITIAL and not receiver.is_valid
    good = data.draw(st.integers(1, 20))
    for n in range(1, good + 1):
        assert receiver.receive(n, frame(message, start + n)) is E2eStatus.OK and receiver.is_valid
    step = data.draw(st.integers(0, message.counter_modulus - 1))
    status = receiver.receive(good + 1, frame(message, start + good + step))
    if step == 0:
        assert status is E2eStatus.REPEATED
    elif step == 1:
        assert status is E2eStatus.OK
    else:
        assert status is (E2eStatus.SOME_LOST if step <= max_delta else E2eStatus.WRONG_SEQUENCE)
    assert receiver.is_valid == (status in (E2eStatus.OK, E2eStatus.SOME_LOST))


@PROFILE
@given(bit=st.integers(0, 63), before=st.integers(0, 20))
def test_any_flipped_bit_is_a_wrong_crc_and_the_next_frame_is_believed(profile: str, bit: int, before: int) -> None:
    message = van_like(profile)
    receiver = Receiver(message)
    for n in range(before + 1):
        receiver.receive(n, frame(message, n))
    broken = bytearray(frame(message, before + 1))
    broken[bit // 8] ^= 1 << bit % 8
    assert receiver.receive(before + 1, bytes(broken)) is E2eStatus.WRONG_CRC and not receiver.is_valid
    # one period without a believed frame: the counter may have moved by one more
    status = receiver.receive(before + 2, frame(message, before + 2))
    assert status is E2eStatus.SOME_LOST and receiver.is_valid


@PROFILE
@given(gap=st.integers(1, 40), period=st.sampled_from([1, 2, 4]))
def test_silence_is_told_and_a_long_one_must_be_proven_anew(profile: str, gap: int, period: int) -> None:
    message = van_like(profile, period_ticks=period)
    receiver, heard, tick = Receiver(message), [], 0
    for n in range(3):
        receiver.receive(n * period, frame(message, n))
    for tick in range(2 * period + 1, (3 + gap) * period):
        if receiver.end_tick(tick):
            heard.append(tick)
            assert receiver.status is E2eStatus.NO_NEW_DATA and not receiver.is_valid
    overdue = gap * period - 3  # ticks after the first one that is not grace any more
    assert len(heard) == (overdue // period + 1 if overdue >= 0 else 0)
    status = receiver.receive(tick + 1, frame(message, 3 + gap))
    long = 1 + gap >= message.counter_modulus - 1
    assert status is (E2eStatus.INITIAL if long else E2eStatus.SOME_LOST)
    assert receiver.receive(tick + 1 + period, frame(message, 4 + gap)) is E2eStatus.OK


def test_a_wrong_sequence_is_a_new_start() -> None:
    message = van_like()
    receiver = Receiver(message)
    for n in range(5):
        receiver.receive(n, frame(message, n))
    assert receiver.receive(5, frame(message, 11)) is E2eStatus.WRONG_SEQUENCE
    assert receiver.receive(6, frame(message, 12)) is E2eStatus.OK


def test_a_frozen_counter_is_not_believed_and_not_forgotten() -> None:
    message = van_like("P01")
    receiver = Receiver(message)
    for n in range(3):
        receiver.receive(n, frame(message, n))
    for n in range(3, 9):
        assert receiver.receive(n, frame(message, 2)) is E2eStatus.REPEATED
    assert receiver.receive(9, frame(message, 9)) is E2eStatus.SOME_LOST, "it went on counting meanwhile"
    assert receiver.counts == [2, 1, 6, 0, 0, 0, 1]


def test_counter_15_of_profile_1_is_nobodys() -> None:
    message = van_like("P01")
    receiver = Receiver(message)
    receiver.receive(0, frame(message, 14))
    assert message.e2e is not None
    assert receiver.receive(1, protect(message.e2e, bytes(8), 15)) is E2eStatus.WRONG_SEQUENCE
    assert receiver.receive(2, frame(message, 15)) is E2eStatus.OK, "0 follows 14"


def test_a_short_protected_frame_has_a_wrong_crc() -> None:
    receiver = Receiver(van_like())
    assert receiver.receive(0, frame(van_like(), 0)[:7]) is E2eStatus.WRONG_CRC


def test_an_unprotected_counter_is_watched_and_its_values_are_taken() -> None:
    receiver = Receiver(BRAKE)
    for tick, (count, status) in enumerate(
        [(250, E2eStatus.INITIAL), (251, E2eStatus.OK), (251, E2eStatus.REPEATED), (9, E2eStatus.WRONG_SEQUENCE)]
    ):
        assert receiver.receive(tick, bytes(7) + bytes((count,))) is status and receiver.is_valid
    assert receiver.receive(4, bytes(4)) is E2eStatus.OK, "a clear frame ends before the counter"
    assert receiver.receive(5, bytes(7) + b"\x0a") is E2eStatus.OK


def test_a_message_without_anything_is_believed() -> None:
    receiver = Receiver(CODEC.by_name["GYRO"])
    assert receiver.receive(0, bytes(4)) is E2eStatus.OK and receiver.is_valid
    assert receiver.receive(0, bytes(4)) is E2eStatus.OK
