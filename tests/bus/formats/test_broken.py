"""Cut, torn and foreign files: one error that names the file, never a crash, never a frame that was not there."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.bus.formats.made import SUFFIX, hold, shifted, write
from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.find import load_format
from tunefree_hil.bus.formats.rows import Format, Row

FLIPS = 25


def made(form: Format, folder: Path) -> tuple[list[Row], Path, Path]:
    """(rows, what to read, the file with the bytes)."""
    rows = hold(form, shifted(46408.0)).rows
    path = folder / f"x{SUFFIX[form.name]}"
    write(form, path, rows)
    return rows, path, next(path.glob("*.db3")) if path.is_dir() else path


def test_a_cut_file_is_refused_or_is_a_beginning(form: Format, tmp_path: Path) -> None:
    rows, path, file = made(form, tmp_path)
    whole = file.read_bytes()
    small = len(whole) < 2000  # text, BLF: all cuts of the last two hundred bytes
    last = range(len(whole) - 200, len(whole)) if small else (len(whole) - 20, len(whole) - 1)
    for end in {0, 1, 7, 60, 150, len(whole) // 2, *last}:
        file.write_bytes(whole[:end])
        try:
            found = list(form.read(path))
        except InputError as error:
            assert error.file and error.hint
        else:
            assert found == rows[: len(found)]


def test_torn_bytes_are_no_crash(form: Format, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    _, path, file = made(form, tmp_path)
    whole, chance = file.read_bytes(), random.Random(7)
    for _ in range(FLIPS):
        torn = bytearray(whole)
        for _ in range(3):
            torn[chance.randrange(len(torn))] = chance.randrange(256)
        file.write_bytes(bytes(torn))
        try:
            list(form.read(path))
        except InputError as error:
            assert error.file and error.hint
    assert capfd.readouterr().err == "", "one message, and that is ours"


def test_a_byte_order_mark_changes_no_frame(tmp_path: Path) -> None:
    form = load_format("csv")
    rows, path, file = made(form, tmp_path)
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert list(form.read(path)) == rows


def test_a_byte_order_mark_hides_no_date_of_an_asc_log(tmp_path: Path) -> None:
    """Its stamps would begin at 0."""
    path, read = tmp_path / "x.asc", load_format("asc").read
    text = (
        "date Sat Aug 24 01:00:00.000 pm 2024\nbase hex  timestamps absolute\nno internal events logged\n"
        " 0.100000 1  123             Rx   d 1 AA\n"
    )
    found = []
    for encoding in ("utf-8", "utf-8-sig"):
        path.write_text(text, encoding=encoding)
        found.append(list(read(path)))
    assert found[0] == found[1] and found[0][0].time_s > 1e9


def test_a_cell_without_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes(b"x" * 200_000 + b"\n")
    with pytest.raises(InputError, match="cannot be read as CSV"):
        list(load_format("csv").read(path))


def test_a_channel_outside_its_record_is_refused(tmp_path: Path) -> None:
    """asammdf reads foreign memory there, and crashes."""
    form = load_format("mf4")
    _, path, _ = made(form, tmp_path)
    data = bytearray(path.read_bytes())
    at = data.index(b"##CN") + 24 + 8 * 8 + 4  # header, eight links, four bytes: the byte offset in the record
    data[at + 1] = 0xE3
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match="lies outside its record"):
        list(form.read(path))


def test_garbage_is_refused(form: Format, tmp_path: Path) -> None:
    path = tmp_path / f"x{SUFFIX[form.name]}"
    path.write_bytes(bytes(range(256)) * 40)
    with pytest.raises(InputError) as caught:
        list(form.read(path))
    assert caught.value.code in ("broken_log", "foreign_log", "truncated_log") and str(path) in str(caught.value)


def test_a_channel_number_beyond_the_format_is_refused() -> None:
    rows = [Row(0.0, "can300", 1, b"")]
    with pytest.raises(InputError, match="can300") as caught:
        hold(load_format("mf4"), rows)
    assert caught.value.key == "--channel"


def test_relative_asc_stamps_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.asc"
    path.write_text(
        "date Sat Aug 24 01:00:00.000 pm 2024\nbase hex  timestamps relative\nno internal events logged\n"
        "0.100000 1  123             Rx   d 1 AA\n0.100000 1  123             Rx   d 1 AB\n"
    )
    with pytest.raises(InputError, match="relative to the line before"):
        list(load_format("asc").read(path))


@pytest.mark.parametrize("word", ["nan", "inf", "-inf", ""])
def test_a_stamp_that_is_no_time_is_refused_with_its_line(word: str, tmp_path: Path) -> None:
    form = load_format("csv")
    _, path, file = made(form, tmp_path)
    lines = file.read_text().splitlines()
    lines[2] = word + "," + lines[2].partition(",")[2]
    file.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match="not a frame") as caught:
        list(form.read(path))
    assert caught.value.file == f"{path}:3"


def test_a_csv_with_lengths_beside_its_data_is_converted(tmp_path: Path) -> None:
    form = load_format("csv")
    rows, path, file = made(form, tmp_path)
    lines = [line.split(",") for line in file.read_text().splitlines()]
    dlc, data = lines[0].index("dlc"), lines[0].index("data")
    for line in lines[1:]:
        line[dlc] = line[dlc] if not line[data] else str(len(line[data]) // 2)
    file.write_text("\n".join(",".join(line) for line in lines) + "\n")
    assert list(form.read(path)) == rows
