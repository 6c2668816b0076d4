"""The log reader: every form of a line, python-can as the second opinion, and errors that name the line."""

from __future__ import annotations

import io
from pathlib import Path

import can
import pytest
from can.io.canutils import CanutilsLogReader
from hypothesis import given
from hypothesis import strategies as st

from tests.episode.candump_text import read_text
from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.rows import SENT, Row
from tunefree_hil.episode.candump import (
    BRS,
    ERROR,
    ESI,
    EXTENDED_BIT,
    FD,
    RTR,
    LogFrame,
    read_candump,
    read_rows,
    write_candump,
)

GOOD = "(0.000000) vcan0 062#0011\n(0.010000) vcan0 063#\n"

frames = st.builds(
    LogFrame,
    st.integers(0, 10**9).map(lambda micro: micro / 1e6),
    st.sampled_from(["can0", "vcan0", "can128"]),
    st.integers(0, 0x7FF) | st.integers(0, 0x1FFFFFFF).map(lambda number: number | EXTENDED_BIT),
    st.binary(max_size=64),
    st.sampled_from([0, FD, FD | BRS, FD | BRS | ESI]),
)


def line(frame: LogFrame, end: str = "") -> str:
    number = frame.can_id & ~EXTENDED_BIT
    digits = f"{number:08X}" if frame.can_id & EXTENDED_BIT else f"{number:03X}"
    fd = f"#{frame.flags >> 1:X}" if frame.flags & FD else ""
    return f"({frame.time_s:.6f}) {frame.channel} {digits}#{fd}{frame.data.hex().upper()}{end}\n"


@given(st.lists(frames, min_size=1, max_size=20), st.sampled_from(["", " R", " T"]))
def test_reads_what_was_written(wanted: list[LogFrame], end: str) -> None:
    assert read_text("".join(line(frame, end) for frame in wanted)) == wanted


@given(
    st.lists(frames.map(lambda one: one._replace(channel="can0")).filter(lambda one: one.data), min_size=1, max_size=10)
)
def test_python_can_reads_the_same(wanted: list[LogFrame]) -> None:
    text = "".join(line(frame) for frame in wanted)
    found = read_text(text)
    theirs: list[can.Message] = list(CanutilsLogReader(io.StringIO(text)))
    assert [(f.time_s, f.channel, f.can_id & ~EXTENDED_BIT, bool(f.can_id & EXTENDED_BIT), f.data) for f in found] == [
        (m.timestamp, m.channel, m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in theirs
    ]
    assert [f.flags for f in found] == [
        m.is_fd * FD | m.bitrate_switch * BRS | m.error_state_indicator * ESI for m in theirs
    ]


@pytest.mark.parametrize(
    ("text", "frame"),
    [
        ("(1.5) can0 7FF#R\n", LogFrame(1.5, "can0", 0x7FF, b"", RTR)),
        ("(1.5) can0 123#R4\n", LogFrame(1.5, "can0", 0x123, b"", RTR)),
        ("(1.5) can0 20000004#0000000000000000\n", LogFrame(1.5, "can0", 4, bytes(8), ERROR)),
        ("(1.5) can0 00000123#AB\n", LogFrame(1.5, "can0", 0x123 | EXTENDED_BIT, b"\xab", 0)),
        ("(1.5)  can0  123#ab  \r\n", LogFrame(1.5, "can0", 0x123, b"\xab", 0)),
        ("\n\n(1.5) can0 123##5AABB\n\n", LogFrame(1.5, "can0", 0x123, b"\xaa\xbb", FD | ESI * 0 | BRS)),
    ],
)
def test_special_lines(text: str, frame: LogFrame) -> None:
    assert read_text(text) == [frame]


@pytest.mark.parametrize(
    ("text", "code", "file", "words"),
    [
        ("", "empty_log", "x.log", "not one frame"),
        ("\n \n", "empty_log", "x.log", "not one frame"),
        (GOOD + "(0.02) vcan0 062#00", "truncated_log", "x.log:3", "cut off"),
        (GOOD + "(0.02) vcan0 062#001\n", "bad_line", "x.log:3", "odd number"),
        (GOOD + "(0.02) vcan0 062\n" + GOOD, "bad_line", "x.log:3", "not a frame"),
        (GOOD + "(0.02) vcan0 0062#00\n", "bad_line", "x.log:3", "not a frame"),
        ("time,id,data\n1,2,3\n", "foreign_log", "x.log:1", "not a candump log"),
        ("  vcan0  123   [2]  11 22\n", "foreign_log", "x.log:1", "screen"),
        (" (001.5)  vcan0  123   [2]  11 22\n", "foreign_log", "x.log:1", "screen"),
    ],
)
def test_errors_name_file_and_line(text: str, code: str, file: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        read_text(text)
    assert (caught.value.code, Path(caught.value.file).name) == (code, file)
    assert words in caught.value.message
    assert caught.value.hint


def test_a_cut_line_may_be_left_out() -> None:
    assert len(read_text(GOOD + "(0.02) vca", allow_cut=True)) == 2
    with pytest.raises(InputError, match="empty"):
        read_text("(0.02) vca", allow_cut=True)


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    with pytest.raises(InputError, match="no such log"):
        read_candump(path)
    path.write_bytes(b"\x00\xff\x10MF4")
    with pytest.raises(InputError, match="byte 1 is not ASCII"):
        read_candump(path)
    path.write_text(GOOD)
    assert [frame.can_id for frame in read_candump(path)] == [0x62, 0x63]


def test_a_real_log(shared_data: Path) -> None:
    found = read_candump(shared_data / "comma2k19_rav4" / "drive.candump.log")
    assert len(found) == 37975
    assert sum(frame.can_id == 0x0B4 for frame in found) == 2487
    assert {frame.channel for frame in found} == {"can0", "can1", "can128", "can129"}


ROWS = [
    Row(46408.58493, "can0", 0x123, b"\x01\x02"),
    Row(46408.584943, "can128", 0x123 | EXTENDED_BIT, b"", SENT),
    Row(46408.59, "can0", 0x7FF, bytes(64), FD | BRS | ESI),
    Row(46408.59, "can0", 0x7FF, b"", FD),
    Row(46408.6, "can0", 0x11, b"", RTR, 4),
    Row(46408.6, "can0", 0x11, b"", RTR),
    Row(46408.7, "can0", 0x44, bytes(8), ERROR),
]


def test_rows_come_back_with_direction_and_remote_length(tmp_path: Path) -> None:
    write_candump(tmp_path / "x.log", ROWS)
    assert list(read_rows(tmp_path / "x.log")) == ROWS
    text = (tmp_path / "x.log").read_text()
    assert "(46408.584943) can128 00000123# T\n" in text and "(46408.600000) can0 011#R4 R\n" in text
    with CanutilsLogReader(tmp_path / "x.log") as theirs:
        assert [message.arbitration_id for message in theirs][:2] == [0x123, 0x123]


def test_nine_decimals_only_where_they_are_needed(tmp_path: Path) -> None:
    for text in ("(0.500000)", "(0.123456789)", "(1724850000.123456)"):
        write_candump(tmp_path / "x.log", [Row(float(text.strip("()")), "can0", 1, b"")])
        assert (tmp_path / "x.log").read_text() == f"{text} can0 001#\n"
