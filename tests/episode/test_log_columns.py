"""A log in columns is the log frame by frame, whatever stands in it; what is wrong is said in the reader's words."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.episode.candump_text import read_text
from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.find import load_format
from tunefree_hil.bus.formats.rows import survey
from tunefree_hil.episode.candump import LogFrame, read_candump, read_rows
from tunefree_hil.episode.log_columns import Piece, parse_lines, read_pieces

KEPT = 1 | 8 | 16  # FD, remote, error


def frames_of(piece: Piece) -> list[LogFrame]:
    """The piece's frames one by one, without the flags that it leaves out."""
    found = []
    for i, number in enumerate(piece.name.tolist()):
        data = piece.payloads.data[i, : piece.payloads.size[i]].tobytes()
        assert (piece.payloads.data[i, piece.payloads.size[i] :] == 0xFF).all()
        found.append(LogFrame(float(piece.time_s[i]), *piece.names[number], data, int(piece.flags[i])))
    return found


def kept(frames: list[LogFrame]) -> list[LogFrame]:
    return [frame._replace(flags=frame.flags & KEPT) for frame in frames]


HEX = "0123456789ABCDEFabcdef"


@st.composite
def lines(draw: st.DrawFn) -> str:
    seconds = draw(st.sampled_from(["0.0", "0.010000", "12.340000", "1650000000.123456", "1650000000.123456789"]))
    channel = draw(st.sampled_from(["can0", "vcan12", "a#b", "(x)", "can128"]))
    name = draw(st.sampled_from(["123", "7FF", "00000123", "18DAF110", "20000004", "9abcdef0"]))
    data = draw(st.text(HEX, max_size=16))
    data = data[: len(data) // 2 * 2]
    kind = draw(st.sampled_from(["data", "data", "data", "fd", "remote"]))
    rest = {"data": f"#{data}", "fd": f"##{draw(st.sampled_from(HEX))}{data * 4}", "remote": "#R"}[kind]
    rest += draw(st.sampled_from(["", "4", "8"])) if kind == "remote" else ""
    return f"({seconds}) {channel} {name}{rest}{draw(st.sampled_from(['', '', ' R', ' T', '  T', chr(13)]))}"


@given(st.lists(lines(), min_size=1, max_size=8))
def test_any_lines(some: list[str]) -> None:
    """Channels with signs in them are left to the careful reader; the rest is parsed at once, and the same."""
    text = "\n".join(some) + "\n"
    piece = parse_lines(text.encode())
    if piece is None:
        assert any(word in text for word in ("a#b", "(x)", "  T")) or any(len(one) > 150 for one in some)
    else:
        assert frames_of(piece) == kept(read_text(text))


@given(st.lists(st.tuples(lines(), st.integers(0, 60), st.sampled_from("() #.RTx\t\0\r5")), min_size=1, max_size=3))
def test_what_the_careful_reader_refuses_is_not_taken(some: list[tuple[str, int, str]]) -> None:
    """One sign of each line replaced: either nobody takes it, or both read the same."""
    text = "\n".join(line[:at] + sign + line[at + 1 :] for line, at, sign in some) + "\n"
    piece = parse_lines(text.encode())
    if piece is not None:
        assert frames_of(piece) == kept(read_text(text))


@pytest.mark.parametrize(
    "bad", ["(1.0) can0 12#00", "(1.0) can0 123#0", "(1.0) can0 123#0G", "hello", "(1) can0 123#00"]
)
def test_a_bad_line_is_named_by_its_number(tmp_path: Path, bad: str) -> None:
    path = tmp_path / "a.log"
    path.write_text("(1.0) can0 123#00\n" * 40_000 + bad + "\n")
    with pytest.raises(InputError) as careful:
        read_candump(path)
    with pytest.raises(InputError) as fast:
        for _ in read_pieces(path):
            pass
    assert str(fast.value) == str(careful.value) and ":40001" in fast.value.file


def test_a_blank_line_in_the_middle_is_no_fault_and_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    some = [f"({k}.000000) can0 {k % 5:03X}#{k % 256:02X}" for k in range(60_000)]
    path.write_text("\n".join([*some[:55_000], "", *some[55_000:]]) + "\n(9.0) can0 1")
    pieces = list(read_pieces(path))
    assert len(pieces) >= 2
    assert [one for piece in pieces for one in frames_of(piece)] == kept(read_candump(path, allow_cut=True))


@pytest.mark.parametrize("text", ["", "\n", "(1.0) can0 123#00"])
def test_nothing_in_it(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.log").write_text(text)
    with pytest.raises(InputError, match="empty"):
        list(read_pieces(tmp_path / "a.log"))


def test_other_formats_come_for_free(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text("".join(f"({k}.5) can{k % 2} {0x100 + k % 3:03X}#{k:04X}\n" for k in range(50)))
    rows = list(read_rows(path))
    csv = load_format("csv")
    csv.write(tmp_path / "a.csv", rows, survey(rows))
    found = [one for piece in read_pieces(tmp_path / "a.csv") for one in frames_of(piece)]
    assert found == kept(read_candump(path))
