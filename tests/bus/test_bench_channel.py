"""The bench channel's frames against dbc/bench.dbc as cantools reads it, and against what is no frame of it."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus import bench_channel as bc

DBC: Any = cantools.database.load_file(Path(__file__).resolve().parents[2] / "dbc" / "bench.dbc")
U8, U16, U32 = st.integers(0, 255), st.integers(0, 65535), st.integers(0, 2**32 - 1)
PLAIN = st.one_of(
    st.builds(bc.Tick, U32),
    st.builds(bc.Done, U32, U8, U8, U16),
    st.builds(bc.Status, U8, U8, U16, U32),
    st.builds(bc.Param, U8, U8, st.floats(width=32, allow_nan=False)),
    st.builds(bc.Fault, U8, U8, U16, U32),
)
EPISODE = st.builds(bc.Episode, st.binary(min_size=6, max_size=6), U16)
PARTS = st.integers(1, 4095).flatmap(lambda n: st.tuples(st.integers(0, n - 1), st.just(n)))
HELLO = st.builds(lambda r, p, t: bc.Hello(r, p[0], p[1], t), U8, PARTS, st.binary(min_size=4, max_size=4))
SIGNALS = {
    bc.Tick: ("K",),
    bc.Done: ("K", "PHASE", "N_TX", "DIGEST"),
    bc.Status: ("ROLE", "STATE", "ERROR", "TICK"),
    bc.Param: ("INDEX", "COUNT", "VALUE"),
    bc.Fault: ("ROLE", "INDEX", "CODE", "TICK"),
}


@given(st.one_of(PLAIN, EPISODE, HELLO))
def test_a_message_comes_back(message: Any) -> None:
    frame = bc.encode(message)
    assert bc.decode(frame) == message and len(frame.data) <= 8


@given(PLAIN)
def test_bytes_are_those_of_the_dbc(message: Any) -> None:
    frame = bc.encode(message)
    described = DBC.get_message_by_frame_id(frame.id)
    values = dict(zip(SIGNALS[type(message)], message, strict=True))
    assert described.name == type(message).__name__.upper()
    assert frame.data == described.encode(values)
    assert described.decode(frame.data, decode_choices=False) == values


@given(EPISODE)
def test_an_episode_shows_its_hash_as_people_write_it(episode: bc.Episode) -> None:
    described = DBC.decode_message("EPISODE", bc.encode(episode).data)
    assert described == {"SCENARIO": int(episode.scenario.hex(), 16), "SEED": episode.seed}


@given(HELLO)
def test_a_hello_is_as_the_dbc_says(hello: bc.Hello) -> None:
    described = DBC.decode_message("HELLO", bc.encode(hello).data, decode_choices=False)
    text = int.from_bytes(hello.text, "big")
    assert described == {"ROLE": hello.role, "PART": hello.part, "PARTS": hello.parts, "TEXT": text}


def test_every_message_of_the_dbc_is_ours() -> None:
    ids = {message.frame_id for message in DBC.messages}
    assert ids == {bc.TICK_ID, bc.DONE_ID, bc.STATUS_ID, bc.EPISODE_ID, bc.PARAM_ID, bc.FAULT_ID, bc.HELLO_ID}
    assert ids <= set(range(0x6E0, 0x6F0))
    choices = DBC.get_message_by_name("STATUS").get_signal_by_name("STATE").choices
    assert {int(value): str(name) for value, name in choices.items()} == {int(s): s.name for s in bc.State}


@given(st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans())
def test_a_foreign_frame_is_none(can_id: int, data: bytes, extended: bool) -> None:
    frame = CanFrame(can_id, data, extended)
    sizes = {message.frame_id: message.length for message in DBC.messages}
    if extended or sizes.get(can_id) != len(data):
        assert bc.decode(frame) is None
    else:
        assert bc.decode(frame) is not None


@pytest.mark.parametrize("data", [b"\0\0\0\0abcd", b"\2\3\x30\0abcd", b"\2\4\x30\0abcd"])
def test_a_chunk_beyond_its_text_is_none(data: bytes) -> None:
    """Parts 0 of 0, 3 of 3, 4 of 3: nobody sends that, and it would never be complete."""
    assert bc.decode(CanFrame(bc.HELLO_ID, data)) is None


def test_a_parameter_is_rounded_to_binary32() -> None:
    heard = bc.decode(bc.encode(bc.Param(3, 16, 0.1)))
    assert heard.value == struct.unpack("<f", struct.pack("<f", 0.1))[0] != 0.1


@pytest.mark.parametrize(
    "message",
    [
        bc.Tick(2**32),
        bc.Done(1, 0, 256, 0),
        bc.Episode(b"123456", 65536),
        bc.Param(0, 1, 1e39),
        bc.Hello(1, 3, 3, b"abcd"),
    ],
)
def test_what_does_not_fit_is_said(message: Any) -> None:
    with pytest.raises(InputError, match="does not fit"):
        bc.encode(message)


NAMES = st.text(st.characters(exclude_characters="\0\n", exclude_categories=["Cs"]), min_size=1, max_size=30)


OWN = st.lists(NAMES.filter(str.strip), max_size=12, unique=True).flatmap(
    lambda names: st.lists(
        st.integers(bc.FIRST_OWN_INDEX, 255), min_size=len(names), max_size=len(names), unique=True
    ).map(lambda indices: dict(zip(indices, names, strict=True)))
)


@given(NAMES, OWN)
def test_names_of_any_length_arrive(name: str, parameters: dict[int, str]) -> None:
    collector = bc.HelloCollector()
    frames = bc.hello_frames(bc.Role.CONTROLLER, name, parameters)
    for i, frame in enumerate(frames):
        assert not collector.complete(bc.Role.CONTROLLER) or i == 0
        collector.add(bc.decode(frame))
    assert collector.complete(bc.Role.CONTROLLER)
    assert collector.name(bc.Role.CONTROLLER) == name
    assert collector.parameters(bc.Role.CONTROLLER) == parameters


@pytest.mark.parametrize(
    "lines",
    ["pi.kp 16", "15 pi.kp", "256 pi.kp", "16", "16 ", "-16 pi.kp", "1\u0666 pi.kp", "16 a\n16 b", "16 a\n17 a"],
)
def test_a_parameter_that_is_not_announced_as_it_should_is_said(lines: str) -> None:
    collector = bc.HelloCollector()
    for message in bc.hello_messages(bc.Role.CONTROLLER, f"mine\n{lines}"):
        collector.add(message)
    with pytest.raises(InputError, match="the controller's line ") as caught:
        collector.parameters(bc.Role.CONTROLLER)
    assert "INDEX NAME" in caught.value.hint and caught.value.code == "bad_hello"


def test_own_parameters_are_numbered_from_16_on() -> None:
    collector = bc.HelloCollector()
    for message in bc.hello_messages(bc.Role.CONTROLLER, "mine", ["k.one", "k.two\n"]):
        collector.add(message)
    assert collector.parameters(bc.Role.CONTROLLER) == {16: "k.one", 17: "k.two"}


def test_a_node_that_comes_back_is_collected_anew() -> None:
    collector = bc.HelloCollector()
    for message in bc.hello_messages(bc.Role.ECU, "the first name"):
        collector.add(message)
    again = bc.hello_messages(bc.Role.ECU, "other names")
    collector.add(again[0])
    assert not collector.complete(bc.Role.ECU) and collector.name(bc.Role.ECU) == ""
    for message in again[1:]:
        collector.add(message)
    assert collector.name(bc.Role.ECU) == "other names"


def test_too_much_to_announce_is_said() -> None:
    with pytest.raises(InputError, match="HELLO carries"):
        bc.hello_messages(bc.Role.CONTROLLER, "x" * 20_000)


def test_every_error_code_has_a_sentence() -> None:
    for code in bc.ErrorCode:
        assert code.sentence and code == int(code)
    assert bc.ErrorCode(2).name == "LEFT_LANE"


@given(st.integers(1000, 65535))
def test_every_number_from_1000_on_is_a_controllers_own_error(number: int) -> None:
    """docs/how-to/own_controller.md lets a controller number its own errors; what it said stays in the words."""
    assert bc.ErrorCode(number) is bc.ErrorCode.CONTROLLER_OWN
    assert bc.error_text(number) == ("controller_own" if number == 1000 else f"controller_own {number}")


def test_a_number_without_a_meaning_is_said_to_have_none() -> None:
    assert bc.error_text(2) == "left_lane"
    with pytest.raises(BenchError, match="ERROR 500, which has no meaning") as caught:
        bc.ErrorCode(500)
    assert caught.value.code == "unknown_error" and "1000" in caught.value.hint
