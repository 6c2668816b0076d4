"""drives.jsonl is read back as it was written, and after a cut at any byte the whole chunks before it are there."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.jobs.robustness.driving.chunk import DriveRow, FinishedChunk, chunk_from_data
from tunefree_hil.jobs.robustness.driving.drive_file import DriveFile

VALUES = (0.1, None, 1.0 / 3.0)


def chunk(number: int, score: float | None = 0.1) -> FinishedChunk:
    return FinishedChunk(number, [DriveRow(number, car, 0, "finished", score, 0, 100, VALUES) for car in (0, 3)])


@given(st.floats(allow_nan=False, allow_infinity=False) | st.none())
def test_a_chunk_survives_as_data(score: float | None) -> None:
    assert chunk_from_data(chunk(4, score).as_data()) == chunk(4, score)


def test_chunks_in_any_order_are_listed_in_that_of_the_plan(tmp_path: Path) -> None:
    file = DriveFile(tmp_path / "d", "key")
    for number in (2, 0, 1, 2):
        file.append(chunk(number))
    again = DriveFile(tmp_path / "d", "key")
    assert again.chunks == file.chunks
    assert [row.road for row in again.list_rows()] == [0, 0, 1, 1, 2, 2]
    assert len((tmp_path / "d").read_text().splitlines()) == 4


def test_a_cut_at_any_byte_loses_at_most_the_chunk_that_was_written(tmp_path: Path) -> None:
    path = tmp_path / "d"
    file = DriveFile(path, "key")
    ends = [path.stat().st_size]
    for number in range(3):
        file.append(chunk(number))
        ends.append(path.stat().st_size)
    content = path.read_bytes()
    for cut in range(ends[0], len(content) + 1):
        path.write_bytes(content[:cut])
        again = DriveFile(path, "key")
        assert sorted(again.chunks) == [number for number in range(3) if ends[number + 1] <= cut]
        for number in range(3):
            again.append(chunk(number))
        assert path.read_bytes() == content


@pytest.mark.parametrize("content", ["", "{}\n", '{"schema": "tunefree.robustness_drives/1", "key": "other"}\n', "x"])
def test_the_file_of_another_sweep_is_refused_and_not_changed(tmp_path: Path, content: str) -> None:
    (tmp_path / "d").write_text(content)
    with pytest.raises(InputError) as caught:
        DriveFile(tmp_path / "d", "key")
    assert caught.value.code == "changed" and (tmp_path / "d").read_text() == content


def test_a_disk_that_is_full_is_an_error_of_the_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = DriveFile(tmp_path / "d", "key")

    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", refuse)
    with pytest.raises(BenchError) as caught:
        file.append(chunk(0))
    assert caught.value.code == "disk" and 0 not in file.chunks
