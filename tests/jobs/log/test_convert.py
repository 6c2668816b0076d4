"""log convert: what it writes, what it says is lost, what it refuses."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Sequence
from pathlib import Path

import pytest

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bus.formats.rows import ERROR, EXTENDED_BIT, FD, RTR, SENT, Row, survey
from tunefree_hil.episode import candump
from tunefree_hil.episode.candump import read_rows, write_candump
from tunefree_hil.jobs.log import convert as log_convert
from tunefree_hil.jobs.log.convert import convert
from tunefree_hil.jobs.log.files import load_log, open_log
from tunefree_hil.jobs.log.options import LogConvertOptions

ROWS = [
    Row(0.0, "can0", 0x123, b"\x01", SENT),
    Row(0.01, "can1", 0x7FF, bytes(64), FD),
    Row(0.02, "can0", 0x44, bytes(8), ERROR),
    Row(0.03, "can0", 0x124, b"\x02"),
]


PLAIN = [  # what every format holds, and every kind but CAN FD
    Row(1724850000.123456, "can0", 0x123, b"\x01\x02"),
    Row(1724850000.133457, "can12", 0x123 | EXTENDED_BIT, b""),
    Row(1724850000.143456, "can1", 0x7FF, bytes(range(8))),
    Row(1724850000.153456, "can0", 0x11, b"", RTR, 4),
    Row(1724850000.163456, "can0", 0, b"", ERROR),
    Row(1724850000.173456, "can0", 0x1FFFFFFF | EXTENDED_BIT, b"\xff"),
]
PAIRED = ("log", "blf", "asc", "csv", "mf4", "bag", "ros2")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    write_candump(tmp_path / "in.log", ROWS)
    return tmp_path / "in.log"


def ended(events: Sequence[Event]) -> tuple[dict, list[str]]:
    return events[-1].data, [event.message for event in events if event.kind == "warning"]


@pytest.mark.parametrize("name", ["a.blf", "a.csv", "a.mf4", "a.log"])
def test_everything_is_kept(source: Path, name: str, tmp_path: Path) -> None:
    data, warnings = ended(list(convert(LogConvertOptions(source, tmp_path / name))))
    assert warnings == [] and data["losses"] == [] and data["written"] == data["read"] == 4
    assert list(open_log(tmp_path / name).rows()) == ROWS
    list(convert(LogConvertOptions(tmp_path / name, tmp_path / "back.log")))
    assert (tmp_path / "back.log").read_text() == source.read_text()


def test_each_loss_is_said_with_its_count(source: Path, tmp_path: Path) -> None:
    data, warnings = ended(list(convert(LogConvertOptions(source, tmp_path / "a.bag"))))
    assert warnings == [
        "ros1: 1 frame: a CAN FD frame is left out: ROS 1 has no message for it",
        "ros1: 1 frame: the direction (sent) is not kept in a ROS bag",
    ]
    assert data["read"] == 4 and data["written"] == 3 and [one["frames"] for one in data["losses"]] == [1, 1]


def test_rounded_stamps_are_counted(tmp_path: Path) -> None:
    write_candump(tmp_path / "fine.log", [Row(0.1234564, "can0", 1, b""), Row(0.2, "can0", 2, b"")])
    _, warnings = ended(list(convert(LogConvertOptions(tmp_path / "fine.log", tmp_path / "a.asc"))))
    assert warnings == ["asc: 1 frame: the stamp is rounded, by at most 0.400 us"]


def test_frames_of_one_stamp_that_change_places_are_counted(tmp_path: Path) -> None:
    rows = [Row(0.0, "can0", 4, bytes(8), ERROR), Row(0.0, "can0", 1, b"a"), Row(0.5, "can0", 2, b"b")]
    write_candump(tmp_path / "x.log", rows)
    data, warnings = ended(list(convert(LogConvertOptions(tmp_path / "x.log", tmp_path / "a.mf4"))))
    assert len(warnings) == 1 and warnings[0].startswith("mf4: 2 frames: comes in another place")
    assert data["written"] == 3


@pytest.mark.parametrize("there", PAIRED)
def test_every_pair_there_and_back(there: str, tmp_path: Path) -> None:
    """What the first format holds comes back from each other one, but for what that said it would lose."""
    write_candump(tmp_path / "all.log", PLAIN)
    list(convert(LogConvertOptions(tmp_path / "all.log", tmp_path / f"a.{there}")))
    held = list(open_log(tmp_path / f"a.{there}").rows())
    for other in PAIRED:
        list(convert(LogConvertOptions(tmp_path / f"a.{there}", tmp_path / f"b.{other}", to="")))
        list(convert(LogConvertOptions(tmp_path / f"b.{other}", tmp_path / f"back_{other}.{there}")))
        found = list(open_log(tmp_path / f"back_{other}.{there}").rows())
        assert [row[1:] for row in found] == [row[1:] for row in held], other
        assert [row.time_s for row in found] == pytest.approx([row.time_s for row in held], abs=1e-6, rel=0.0)
    assert not list(tmp_path.glob("part-*"))


def test_a_ros2_bag_has_its_own_name_inside(source: Path, tmp_path: Path) -> None:
    list(convert(LogConvertOptions(source, tmp_path / "drive.ros2")))
    assert sorted(path.name for path in (tmp_path / "drive.ros2").iterdir()) == ["drive.ros2.db3", "metadata.yaml"]
    assert list(open_log(tmp_path / "drive.ros2" / "drive.ros2.db3").rows()), "one file of it named"


def peak_bytes(frames: int, folder: Path, suffix: str) -> int:
    """The most memory that Python holds while a log of so many frames is converted."""
    rows = (Row(k / 1000.0, "can0", 0x100 + k % 50, k.to_bytes(8, "big")) for k in range(frames))
    source = folder / f"{frames}.in.log"
    write_candump(source, rows, survey([Row(0.0, "can0", 1, b"")]))
    gc.collect()
    tracemalloc.start()
    try:
        list(convert(LogConvertOptions(source, folder / f"{frames}.{suffix}")))
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["log", "blf"])
def test_memory_does_not_grow_with_the_log(suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Held as a whole, the 15000 further frames would take some 3 MB."""
    monkeypatch.setattr(candump, "BLOCK_BYTES", 1 << 16)
    peak_bytes(1000, tmp_path, suffix)  # imports and caches
    assert peak_bytes(20_000, tmp_path, suffix) - peak_bytes(5_000, tmp_path, suffix) < 1e6


def test_chosen_channels(source: Path, tmp_path: Path) -> None:
    data, _ = ended(list(convert(LogConvertOptions(source, tmp_path / "a.log", channels=["can1"]))))
    assert data["written"] == 1 and data["not_chosen"] == 3
    assert list(read_rows(tmp_path / "a.log")) == [ROWS[1]]
    with pytest.raises(InputError, match="no channel 'can7'") as caught:
        list(convert(LogConvertOptions(source, tmp_path / "b.log", channels=["can7"])))
    assert caught.value.hint == "its channels are can0, can1"


def test_an_existing_file_is_not_overwritten(source: Path, tmp_path: Path) -> None:
    (tmp_path / "a.blf").write_text("mine")
    with pytest.raises(InputError, match="already exists"):
        list(convert(LogConvertOptions(source, tmp_path / "a.blf")))
    assert (tmp_path / "a.blf").read_text() == "mine"


def test_a_target_that_can_hold_nothing(tmp_path: Path) -> None:
    write_candump(tmp_path / "fd.log", [ROWS[1]])
    with pytest.raises(InputError, match="can store none of the 1 frames"):
        list(convert(LogConvertOptions(tmp_path / "fd.log", tmp_path / "a.bag")))
    assert [path.name for path in tmp_path.iterdir()] == ["fd.log"]


def test_a_writer_that_loses_a_frame_is_caught(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The proof by reading back is one: a silent loss is an error, and nothing is left behind."""
    real = log_convert._load_format("csv")
    broken = real._replace(write=lambda path, rows, seen: real.write(path, list(rows)[1:], seen))
    monkeypatch.setattr(log_convert, "_load_format", lambda name: broken)
    with pytest.raises(BenchError, match="does not read back: of frame 0x123 on can0 1 went in and did not come back"):
        list(convert(LogConvertOptions(source, tmp_path / "a.csv")))
    assert [path.name for path in tmp_path.iterdir()] == ["in.log"]


@pytest.mark.parametrize(
    ("text", "code"),
    [("", "empty_log"), ("(0.0) can0 123#00\n(0.1) can", "truncated_log"), ("a,b\n1,2\n", "foreign_log")],
)
def test_empty_truncated_and_foreign_logs(text: str, code: str, tmp_path: Path) -> None:
    (tmp_path / "x.log").write_text(text)
    with pytest.raises(InputError) as caught:
        list(convert(LogConvertOptions(tmp_path / "x.log", tmp_path / "a.blf")))
    assert caught.value.code == code and not (tmp_path / "a.blf").exists()


def test_any_format_can_be_looked_into(source: Path, tmp_path: Path) -> None:
    list(convert(LogConvertOptions(source, tmp_path / "a.blf")))
    assert load_log(tmp_path / "a.blf") == load_log(source)


@pytest.mark.parametrize("suffix", ["blf", "asc", "mf4", "csv"])
def test_the_rav4_minute_goes_round(suffix: str, shared_data: Path, tmp_path: Path) -> None:
    log = shared_data / "comma2k19_rav4" / "drive.candump.log"
    short = tmp_path / "short.log"
    short.write_text("".join(log.read_text().splitlines(keepends=True)[:4000]))
    data, warnings = ended(list(convert(LogConvertOptions(short, tmp_path / f"a.{suffix}"))))
    assert warnings == [] and data["written"] == 4000
    list(convert(LogConvertOptions(tmp_path / f"a.{suffix}", tmp_path / "back.log")))
    assert (tmp_path / "back.log").read_text() == short.read_text()
