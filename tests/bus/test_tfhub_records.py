"""Records: what goes in comes out, and it lies there as Linux lays it out."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.tfhub import records


@st.composite
def can_frames(draw: st.DrawFn, fd: bool | None = None) -> CanFrame:
    extended, is_fd = draw(st.booleans()), draw(st.booleans()) if fd is None else fd
    identifier = draw(st.integers(0, records.EFF_MASK if extended else records.SFF_MASK))
    data = draw(st.binary(max_size=64 if is_fd else 8))
    micros = draw(st.integers(0, 10**10))
    return CanFrame(identifier, data, extended, is_fd, micros / 1e6)


@given(st.lists(can_frames(), max_size=20))
def test_frames_survive(frames: list[CanFrame]) -> None:
    packed = records.pack_frames(frames)
    found, at = [], 0
    while at < len(packed):
        raw = records.unpack_raw(packed, at)
        found.append(raw.data_frame())
        at += struct.unpack_from("<H", packed, at)[0]
    assert found == frames


@given(st.lists(can_frames(fd=False), min_size=1, max_size=20), st.lists(can_frames(), max_size=20))
def test_the_fast_reader_agrees(classic: list[CanFrame], others: list[CanFrame]) -> None:
    for frames in (classic, classic + others, others + classic):
        packed, second = records.pack_frames(frames), records.pack_frames(frames, records.SECOND_FRAME)
        assert second == records.mark_second_channel(packed, len(frames))
        assert records.plain_frames(packed) == (frames, [])
        assert records.plain_frames(packed + second) == (frames, frames)


@pytest.mark.parametrize(
    "odd",
    [
        records.pack_raw(records.Raw(5 | records.RTR_FLAG, b"", length=3)),
        records.pack_raw(records.Raw(5 | records.ERR_FLAG, bytes(8))),
        records.pack_control(records.PEER_GONE, {"name": "ecu"}),
        records.pack_frames([CanFrame(5, b"")])[:-1],
    ],
)
def test_the_fast_reader_leaves_what_is_not_plain(odd: bytes) -> None:
    assert records.plain_frames(records.pack_frames([CanFrame(1, b"x")]) + odd) is None
    assert records.plain_frames(b"") is None


def test_a_record_holds_struct_can_frame() -> None:
    record = records.pack_raw(records.Raw(0x123, b"\x01\x02\x03"))
    assert record[records.HEAD.size :] == struct.pack("<IB3x8s", 0x123, 3, b"\x01\x02\x03")
    record = records.pack_raw(records.Raw(0x123 | records.EFF_FLAG, bytes(range(12)), fd=True, flags=records.BRS))
    assert record[records.HEAD.size :] == struct.pack(
        "<IBBxx64s", 0x123 | records.EFF_FLAG, 12, records.BRS, bytes(range(12))
    )


@pytest.mark.parametrize(
    "bad",
    [
        CanFrame(0x800, b""),
        CanFrame(0x20000000, b"", True),
        CanFrame(-1, b""),
        CanFrame(1, bytes(9)),
        CanFrame(1, b"", time_s=-0.01),
        CanFrame(1, b"", time_s=float("nan")),
        CanFrame(1, bytes(65), False, True),
    ],
)
def test_what_no_bus_carries_is_refused(bad: CanFrame) -> None:
    with pytest.raises(InputError):
        records.pack_frames([bad])


def test_control_records() -> None:
    record = records.pack_control(records.HELLO, {"role": "member"}, sequence=7)
    assert records.body_of(record) == {"role": "member"}
    assert records.HEAD.unpack_from(record) == (len(record), records.HELLO, 0, 7, 0)
    assert records.body_of(records.pack_control(records.BYE)) == {}
    for text in (b"[]", b"{", b"\xff"):
        with pytest.raises(records.RecordError):
            records.body_of(records.HEAD.pack(records.HEAD.size + len(text), records.HELLO, 0, 0, 0) + text)
    with pytest.raises(records.RecordError):
        records.pack_control(records.REPLY, {"text": "x" * 70_000})
