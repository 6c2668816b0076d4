"""log convert: what it writes, what it says is lost, what it refuses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bus.formats.rows import ERROR, FD, SENT, Format, Row
from tunefree_hil.episode.candump import read_rows, write_candump
from tunefree_hil.jobs import log_convert
from tunefree_hil.jobs.log_convert import convert
from tunefree_hil.jobs.log_files import load_log, load_rows

ROWS = [
    Row(0.0, "can0", 0x123, b"\x01", SENT),
    Row(0.01, "can1", 0x7FF, bytes(64), FD),
    Row(0.02, "can0", 0x44, bytes(8), ERROR),
    Row(0.03, "can0", 0x124, b"\x02"),
]


@pytest.fixture
def source(tmp_path: Path) -> Path:
    write_candump(tmp_path / "in.log", ROWS)
    return tmp_path / "in.log"


def ended(events: Sequence[Event]) -> tuple[dict, list[str]]:
    return events[-1].data, [event.message for event in events if event.kind == "warning"]


@pytest.mark.parametrize("name", ["a.blf", "a.csv", "a.mf4", "a.log"])
def test_everything_is_kept(source: Path, name: str, tmp_path: Path) -> None:
    data, warnings = ended(list(convert(source, tmp_path / name)))
    assert warnings == [] and data["losses"] == [] and data["written"] == data["read"] == 4
    assert load_rows(tmp_path / name)[0] == ROWS
    list(convert(tmp_path / name, tmp_path / "back.log"))
    assert (tmp_path / "back.log").read_text() == source.read_text()


def test_each_loss_is_said_with_its_count(source: Path, tmp_path: Path) -> None:
    data, warnings = ended(list(convert(source, tmp_path / "a.bag")))
    assert warnings == [
        "ros1: 1 frame: a CAN FD frame is left out: ROS 1 has no message for it",
        "ros1: 1 frame: the direction (sent) is not kept in a ROS bag",
    ]
    assert data["read"] == 4 and data["written"] == 3 and [one["frames"] for one in data["losses"]] == [1, 1]


def test_rounded_stamps_are_counted(tmp_path: Path) -> None:
    write_candump(tmp_path / "fine.log", [Row(0.1234564, "can0", 1, b""), Row(0.2, "can0", 2, b"")])
    _, warnings = ended(list(convert(tmp_path / "fine.log", tmp_path / "a.asc")))
    assert warnings == ["asc: 1 frame: the stamp is rounded, by at most 0.400 us"]


def test_frames_of_one_stamp_that_change_places_are_counted(tmp_path: Path) -> None:
    rows = [Row(0.0, "can0", 4, bytes(8), ERROR), Row(0.0, "can0", 1, b"a"), Row(0.5, "can0", 2, b"b")]
    write_candump(tmp_path / "x.log", rows)
    data, warnings = ended(list(convert(tmp_path / "x.log", tmp_path / "a.mf4")))
    assert len(warnings) == 1 and warnings[0].startswith("mf4: 2 frames: comes in another place")
    assert data["written"] == 3


def test_chosen_channels(source: Path, tmp_path: Path) -> None:
    data, _ = ended(list(convert(source, tmp_path / "a.log", channels=["can1"])))
    assert data["written"] == 1 and data["not_chosen"] == 3
    assert read_rows(tmp_path / "a.log") == [ROWS[1]]
    with pytest.raises(InputError, match="no channel 'can7'") as caught:
        list(convert(source, tmp_path / "b.log", channels=["can7"]))
    assert caught.value.hint == "there are can0, can1"


def test_an_existing_file_is_not_overwritten(source: Path, tmp_path: Path) -> None:
    (tmp_path / "a.blf").write_text("mine")
    with pytest.raises(InputError, match="there already"):
        list(convert(source, tmp_path / "a.blf"))
    assert (tmp_path / "a.blf").read_text() == "mine"


def test_a_target_that_can_hold_nothing(tmp_path: Path) -> None:
    write_candump(tmp_path / "fd.log", [ROWS[1]])
    with pytest.raises(InputError, match="can hold none of the 1 frames"):
        list(convert(tmp_path / "fd.log", tmp_path / "a.bag"))
    assert [path.name for path in tmp_path.iterdir()] == ["fd.log"]


def test_a_writer_that_loses_a_frame_is_caught(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The proof by reading back is one: a silent loss is an error, and nothing is left behind."""
    real = log_convert._format("csv")
    broken = Format("csv", real.read, lambda path, rows: real.write(path, rows[1:]), real.hold)
    monkeypatch.setattr(log_convert, "_format", lambda name: broken)
    with pytest.raises(BenchError, match="does not read back: 1 frames 0x123 on can0 went in, 0 came back"):
        list(convert(source, tmp_path / "a.csv"))
    assert [path.name for path in tmp_path.iterdir()] == ["in.log"]


@pytest.mark.parametrize(
    ("text", "code"),
    [("", "empty_log"), ("(0.0) can0 123#00\n(0.1) can", "truncated_log"), ("a,b\n1,2\n", "foreign_log")],
)
def test_empty_truncated_and_foreign_logs(text: str, code: str, tmp_path: Path) -> None:
    (tmp_path / "x.log").write_text(text)
    with pytest.raises(InputError) as caught:
        list(convert(tmp_path / "x.log", tmp_path / "a.blf"))
    assert caught.value.code == code and not (tmp_path / "a.blf").exists()


def test_any_format_can_be_looked_into(source: Path, tmp_path: Path) -> None:
    list(convert(source, tmp_path / "a.blf"))
    assert load_log(tmp_path / "a.blf") == load_log(source)


@pytest.mark.parametrize("suffix", ["blf", "asc", "mf4", "csv"])
def test_the_rav4_minute_goes_round(suffix: str, shared_data: Path, tmp_path: Path) -> None:
    log = shared_data / "comma2k19_rav4" / "drive.candump.log"
    short = tmp_path / "short.log"
    short.write_text("".join(log.read_text().splitlines(keepends=True)[:4000]))
    data, warnings = ended(list(convert(short, tmp_path / f"a.{suffix}")))
    assert warnings == [] and data["written"] == 4000
    list(convert(tmp_path / f"a.{suffix}", tmp_path / "back.log"))
    assert (tmp_path / "back.log").read_text() == short.read_text()
