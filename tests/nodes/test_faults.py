"""Scripted faults at the sender: what is sent instead, and that nothing but (seed, tick) decides it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.bus.e2e_car import write_car
from tunefree_hil.base.records import CanFrame, Command
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.dbc.e2e import is_intact
from tunefree_hil.bus.dbc.integrity import E2eStatus, Receiver
from tunefree_hil.bus.recording.frame_writer import FrameWriter
from tunefree_hil.config.fault_check import CRC_KINDS, FRAME_KINDS
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.nodes.faults import FaultFilter, ScriptedFault, put_counter, read_counter

DT_S = 0.01
MKZ = Codec(load_vehicle("mkz_bywire"))
FIRST, AFTER = 5, 12


@pytest.fixture(scope="module")
def codec(tmp_path_factory: pytest.TempPathFactory) -> Codec:
    return Codec(load_vehicle(write_car(tmp_path_factory.mktemp("car"))))


def scripted(codec: Codec, kind: str, value: int = 1, seed: int = 1, message: str = "DRIVE") -> ScriptedFault:
    return ScriptedFault(0, 0, kind, FIRST, AFTER, value, seed, codec.by_name.get(message))


def send(codec: Codec, *faults: ScriptedFault, ticks: int = 30) -> list[list[CanFrame]]:
    """What goes out tick by tick of a sender of DRIVE, whose wish moves all the time."""
    writer, filtered = FrameWriter(codec), FaultFilter(faults)
    sent = []
    for k in range(ticks):
        records = {"command": Command(0.01 * k, 0.0, -0.02 * k)}
        sent.append(filtered.apply(k, [writer.write(codec.by_name["DRIVE"], records, {}, k * DT_S)], DT_S))
    return sent


def test_without_faults_nothing_is_touched(codec: Codec) -> None:
    frames = [CanFrame(1, b"1")]
    assert FaultFilter().apply(0, frames, DT_S) is frames
    other = FaultFilter([scripted(codec, "drop")])
    assert other.apply(7, frames, DT_S) == frames, "another message"


@pytest.mark.parametrize("kind", FRAME_KINDS)
def test_a_fault_has_a_beginning_and_an_end(codec: Codec, kind: str) -> None:
    clean, sent = send(codec), send(codec, scripted(codec, kind, 1))
    assert sent[:FIRST] == clean[:FIRST]
    assert sent[AFTER + 1 :] == clean[AFTER + 1 :], "one tick later a delay of one tick is over too"
    assert sent[FIRST:AFTER] != clean[FIRST:AFTER]


@pytest.mark.parametrize("kind", FRAME_KINDS)
def test_seed_and_tick_alone_decide(codec: Codec, kind: str) -> None:
    assert send(codec, scripted(codec, kind)) == send(codec, scripted(codec, kind))
    random = kind in ("corrupt", "crc_random", "counter_random")
    assert (send(codec, scripted(codec, kind, seed=2)) != send(codec, scripted(codec, kind))) == random


def test_drop_and_peer_stop(codec: Codec) -> None:
    for fault in (scripted(codec, "drop"), scripted(codec, "peer_stop", message="")):
        assert [len(frames) for frames in send(codec, fault)] == [1] * 5 + [0] * 7 + [1] * 18


@given(ticks=st.integers(1, 9))
def test_a_delayed_frame_goes_out_whole_with_a_later_ticks_stamp(codec: Codec, ticks: int) -> None:
    clean, sent = send(codec), send(codec, scripted(codec, "delay", ticks))
    assert sum(map(len, sent)) == 30
    for k in range(FIRST, AFTER):
        assert sent[k + ticks][0].data == clean[k][0].data
        assert sent[k + ticks][0].time_s == (k + ticks) * DT_S


@given(copies=st.integers(1, 20))
def test_copies_follow_their_frame(codec: Codec, copies: int) -> None:
    sent = send(codec, scripted(codec, "burst", copies))
    assert [len(frames) for frames in sent] == [1] * 5 + [copies + 1] * 7 + [1] * 18
    assert all(len(set(frames)) == 1 for frames in sent)
    assert send(codec, scripted(codec, "duplicate")) == send(codec, scripted(codec, "burst", 1))


@given(bits=st.integers(1, 96), seed=st.integers(0, 65535))
def test_corrupt_flips_so_many_bits(codec: Codec, bits: int, seed: int) -> None:
    clean, sent = send(codec), send(codec, scripted(codec, "corrupt", bits, seed))
    for k in range(FIRST, AFTER):
        difference = int.from_bytes(clean[k][0].data) ^ int.from_bytes(sent[k][0].data)
        assert difference.bit_count() == bits


def test_stale_is_the_last_good_frame_counter_and_all(codec: Codec) -> None:
    clean, sent = send(codec), send(codec, scripted(codec, "stale"))
    assert {frames[0].data for frames in sent[FIRST:AFTER]} == {clean[FIRST - 1][0].data}
    assert [frames[0].time_s for frames in sent] == [frames[0].time_s for frames in clean]


@pytest.mark.parametrize("kind", CRC_KINDS)
def test_crc_faults_change_the_crc_alone(codec: Codec, kind: str) -> None:
    at = 2
    clean, sent = send(codec), send(codec, scripted(codec, kind, 7))
    message = codec.by_name["DRIVE"]
    assert message.e2e is not None and message.e2e.crc_at == at
    for k in range(FIRST, AFTER):
        right, wrong = clean[k][0].data, sent[k][0].data
        assert right[:at] + right[at + 1 :] == wrong[:at] + wrong[at + 1 :]
        expected = {"crc_value": 7, "crc_freeze": clean[FIRST - 1][0].data[at], "crc_offset": (right[at] + 7) % 256}
        assert wrong[at] == expected.get(kind, wrong[at])
        assert is_intact(message.e2e, wrong) == (wrong[at] == right[at])
        assert kind != "crc_random" or wrong[at] != right[at]


@pytest.mark.parametrize(
    ("kind", "value", "counters"),
    [
        ("counter_value", 3, [3] * 7),
        ("counter_value", 15, [15] * 7),
        ("counter_freeze", 0, [4] * 7),
        ("counter_offset", 13, [3, 4, 5, 6, 7, 8, 9]),
    ],
)
def test_a_disturbed_counter_carries_the_crc_that_fits(
    codec: Codec, kind: str, value: int, counters: list[int]
) -> None:
    message = codec.by_name["DRIVE"]
    sent = send(codec, scripted(codec, kind, value))[FIRST:AFTER]
    assert [read_counter(message, frames[0].data) for frames in sent] == counters
    assert message.e2e is not None and all(is_intact(message.e2e, frames[0].data) for frames in sent)


def test_a_random_counter_is_never_the_right_one(codec: Codec) -> None:
    message = codec.by_name["DRIVE"]
    clean, sent = send(codec), send(codec, scripted(codec, "counter_random"))
    pairs = [tuple(read_counter(message, frames[k][0].data) for frames in (clean, sent)) for k in range(FIRST, AFTER)]
    assert all(right != wrong and 0 <= wrong < 15 for right, wrong in pairs)


@given(data=st.binary(min_size=8, max_size=8), counter=st.integers(0, 255))
def test_an_unprotected_counter_is_changed_alone(data: bytes, counter: int) -> None:
    message = MKZ.by_name["BRAKE_CMD"]
    changed = put_counter(message, data, counter)
    assert read_counter(message, changed) == counter and changed[:7] == data[:7]
    assert put_counter(message, data[:4], counter) == data[:4], "a clear frame has none"


def test_two_faults_of_one_message_apply_in_the_order_of_the_file(codec: Codec) -> None:
    both = send(codec, scripted(codec, "corrupt", 3), scripted(codec, "duplicate"))
    corrupted = send(codec, scripted(codec, "corrupt", 3))
    assert both[FIRST] == corrupted[FIRST] * 2


@pytest.mark.parametrize(
    ("kind", "value", "status"),
    [
        ("drop", 1, E2eStatus.NO_NEW_DATA),
        ("duplicate", 1, E2eStatus.REPEATED),
        ("corrupt", 1, E2eStatus.WRONG_CRC),
        ("crc_value", 3, E2eStatus.WRONG_CRC),
        ("crc_random", 1, E2eStatus.WRONG_CRC),
        ("counter_freeze", 1, E2eStatus.REPEATED),
        ("counter_offset", 4, E2eStatus.WRONG_SEQUENCE),
        ("stale", 1, E2eStatus.REPEATED),
        ("burst", 3, E2eStatus.REPEATED),
    ],
)
def test_a_receiver_names_it(codec: Codec, kind: str, value: int, status: E2eStatus) -> None:
    receiver, seen = Receiver(codec.by_name["DRIVE"]), set()
    for k, frames in enumerate(send(codec, scripted(codec, kind, value))):
        seen |= {receiver.receive(k, frame.data) for frame in frames}
        if receiver.end_tick(k):
            seen.add(receiver.status)
    assert status in seen
    assert receiver.status is E2eStatus.OK, "and it recovers"


def test_faults_begin_once(codec: Codec) -> None:
    filtered = FaultFilter([scripted(codec, "drop"), scripted(codec, "peer_stop", message="")])
    assert [len(filtered.begun(k)) for k in range(20)] == [0] * 5 + [2] + [0] * 14
