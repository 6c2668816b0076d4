"""Two recordings of one bus: what counts as the same, and which difference is named."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from tests.vcan.same_frames import same_frames
from tunefree_hil.episode.candump import ERROR, EXTENDED_BIT, LogFrame

FRAMES = st.lists(
    st.builds(LogFrame, st.floats(0, 9), st.just("a"), st.integers(1, 3), st.binary(max_size=2), st.integers(0, 7)),
    max_size=30,
)


def frame(can_id: int, data: bytes = b"", flags: int = 0) -> LogFrame:
    return LogFrame(0.0, "vcan0", can_id, data, flags)


@given(FRAMES)
def test_stamps_and_channels_do_not_count(frames: list[LogFrame]) -> None:
    others = [one._replace(time_s=one.time_s + 100.0, channel="b") for one in frames]
    assert same_frames(frames, others) == (len(frames), "", 0)


@given(FRAMES, st.data())
def test_a_lost_frame_is_found(frames: list[LogFrame], data: st.DataObject) -> None:
    frames = [*frames, frame(1)]
    i = data.draw(st.integers(0, len(frames) - 1))
    assert same_frames(frames, frames[:i] + frames[i + 1 :]).difference


def test_neighbours_of_different_ids_may_be_exchanged_and_are_counted() -> None:
    a, b, c = frame(1, b"a"), frame(2, b"b"), frame(3, b"c")
    assert same_frames([a, b, c], [b, a, c]) == (3, "", 2)


def test_frames_of_one_id_keep_their_order() -> None:
    found = same_frames([frame(1, b"\1"), frame(1, b"\2")], [frame(1, b"\2"), frame(1, b"\1")])
    assert found.difference == "0x1, frame 0: 01 here, 02 there"


def test_flags_count_and_kinds_of_frames_are_apart() -> None:
    assert same_frames([frame(1, flags=1)], [frame(1, flags=3)]).difference
    assert same_frames([frame(1)], [frame(1, flags=ERROR)]).difference == "0x1: 1 frames here, 0 there"
    found = same_frames([frame(5 | EXTENDED_BIT)], [])
    assert found.difference == "0x5 (extended): 1 frames here, 0 there"
