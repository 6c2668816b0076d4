"""The frame hash: its bytes as docs/reference/bench_channel.md prints them, and what it does and does not depend on."""

from __future__ import annotations

import hashlib

from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.episode.candump import BRS, ERROR, EXTENDED_BIT, FD, RTR, LogFrame
from tunefree_hil.episode.frame_hash import frame_hash, place_frames

TICK_S = 0.01
COMMANDS, VEHICLE = {0x62}, {0x62, 0x63, 0x10, 0x63 | EXTENDED_BIT}


def frame(k: float, can_id: int, data: str = "", flags: int = 0) -> LogFrame:
    return LogFrame(k * TICK_S, "vcan0", can_id, bytes.fromhex(data), flags)


def digest(*frames: LogFrame, **more: float) -> str:
    return frame_hash(frames, TICK_S, COMMANDS, VEHICLE, **more).hex


def test_bytes_by_hand() -> None:
    frames = [
        frame(0, 0x62, "AA"),
        frame(0, 0x63, "0102"),
        frame(1, 0x63 | EXTENDED_BIT, "FF" * 12, FD | BRS),
        frame(258, 0x10),
    ]
    expected = bytes.fromhex(
        "00000000 00 00 63000000 00 02 0102"
        "00000000 01 00 62000000 00 01 AA"
        "01000000 00 00 63000080 03 0C FFFFFFFFFFFFFFFFFFFFFFFF"
        "02010000 00 00 10000000 00 00"
    )
    assert digest(*frames) == hashlib.sha256(expected).hexdigest()


def test_no_frames_is_the_hash_of_nothing() -> None:
    assert digest() == hashlib.sha256(b"").hexdigest()


@given(st.permutations([frame(0, 0x10), frame(0, 0x62, "01"), frame(0, 0x63, "02"), frame(1, 0x10, "03")]))
def test_order_on_the_wire_does_not_matter(frames: list[LogFrame]) -> None:
    assert digest(*frames) == digest(frame(0, 0x10), frame(0, 0x62, "01"), frame(0, 0x63, "02"), frame(1, 0x10, "03"))


def test_order_within_an_id_matters() -> None:
    assert digest(frame(0, 0x10, "01"), frame(0, 0x10, "02")) != digest(frame(0, 0x10, "02"), frame(0, 0x10, "01"))


def test_tick_and_data_matter() -> None:
    assert digest(frame(0, 0x10, "01")) != digest(frame(1, 0x10, "01"))
    assert digest(frame(0, 0x10, "01")) != digest(frame(0, 0x10, "02"))
    assert digest(frame(0.4, 0x10)) == digest(frame(0, 0x10))


def test_other_frames_are_counted_and_named() -> None:
    asked = frame(1, 0x63, "", RTR)  # a node of this vehicle asks for nothing
    frames = [frame(0, 0x10, "01"), frame(0, 0x700), frame(1, 0x700), frame(2, 4, "00", ERROR), asked]
    found = frame_hash(frames, TICK_S, COMMANDS, VEHICLE)
    assert found == (digest(frames[0]), 1, {0x700: 2, 0x63: 1}, 1)


def test_time_zero_may_be_anywhere() -> None:
    frames = [frame(-1, 0x10, "00"), frame(0, 0x10, "01"), frame(3, 0x62, "02")]
    later = [item._replace(time_s=item.time_s + 46408.5) for item in frames]
    assert digest(*later, zero_s=46408.5) == digest(*frames) == digest(*frames[1:])


def test_placed_in_the_order_of_the_hash() -> None:
    placed, _, _ = place_frames(
        [frame(1, 0x10), frame(0, 0x62), frame(0, 0x63 | EXTENDED_BIT), frame(0, 0x63)], TICK_S, COMMANDS, VEHICLE
    )
    assert [(item.k, item.phase, item.can_id) for item in placed] == [
        (0, 0, 0x63),
        (0, 0, 0x63 | EXTENDED_BIT),
        (0, 1, 0x62),
        (1, 0, 0x10),
    ]
