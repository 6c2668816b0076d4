"""The hub's log: candump text that python-can reads back as what was sent; a full disk is told, not raised."""

from __future__ import annotations

import re
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import BenchError
from tunefree_hil.bus.tfhub import records
from tunefree_hil.bus.tfhub.server.log import CandumpLog, id_text, time_text

CANPLAYER = re.compile(r"^\(\d+\.\d{6}\) \w+ ([0-9A-F]{3}|[0-9A-F]{8})#(#[0-9A-F]([0-9A-F]{2})*|R\d?|([0-9A-F]{2})*)$")

messages = st.builds(
    dict,
    can_id=st.one_of(
        st.integers(0, 0x7FF),
        st.integers(0, 0x7FF).map(lambda i: i | records.RTR_FLAG),
        st.integers(0, 0x1FFFFFFF).map(lambda i: i | records.EFF_FLAG),
        st.integers(0, 0x1FFFFFFF).map(lambda i: i | records.EFF_FLAG | records.RTR_FLAG),
    ),
    data=st.binary(max_size=8),
    time_ns=st.integers(0, 10**13).map(lambda micros: micros * 1000),
    fd=st.booleans(),
    flags=st.integers(0, 3),
)


def packed(can_id: int, data: bytes, time_ns: int, fd: bool, flags: int) -> bytes:
    if can_id & records.RTR_FLAG:
        return records.pack_raw(records.Raw(can_id, b"", time_ns, length=len(data)))
    return records.pack_raw(records.Raw(can_id, data * (8 if fd else 1), time_ns, fd, flags if fd else 0))


@given(st.lists(messages, max_size=20))
def test_python_can_reads_it_back(tmp_path_factory: pytest.TempPathFactory, sent: list[dict]) -> None:
    path = tmp_path_factory.mktemp("log") / "vehicle.log"
    log = CandumpLog(str(path), "can0", 0)
    for message in sent:
        log.add(packed(**message), 1)
    log.close()
    assert all(CANPLAYER.match(line) for line in path.read_text().splitlines())
    found = list(can.LogReader(str(path)))
    assert len(found) == len(sent) == log.frames
    for message, read in zip(sent, found, strict=True):
        raw = records.unpack_raw(packed(**message))
        assert read.arbitration_id == raw.can_id & records.EFF_MASK
        assert read.is_extended_id == bool(raw.can_id & records.EFF_FLAG)
        assert read.is_remote_frame == bool(raw.can_id & records.RTR_FLAG)
        assert (read.is_fd, read.bitrate_switch, read.error_state_indicator) == (
            raw.fd,
            bool(raw.flags & records.BRS),
            bool(raw.flags & records.ESI),
        )
        assert read.dlc == raw.length and bytes(read.data) == raw.data
        assert read.timestamp == raw.time_ns / 1e9 and read.channel == "can0"


def test_error_frames_are_error_frames(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    log = CandumpLog(str(path), "can0", 0)
    for classes in (0, 0x80, 0x80 | 0x40):
        log.add(records.pack_raw(records.Raw(records.ERR_FLAG | classes, bytes(8))), 1)
    log.close()
    assert [message.is_error_frame for message in can.LogReader(str(path))] == [True] * 3
    assert [line.split()[2][:9] for line in path.read_text().splitlines()] == ["20000080#", "20000080#", "200000C0#"]


def test_texts() -> None:
    assert id_text(0x1A) == "01A" and id_text(0x1A | records.EFF_FLAG) == "0000001A"
    assert time_text(0) == "(0.000000)" and time_text(1_999_999_600) == "(2.000000)"
    assert time_text(1_436_509_052_249_713_000) == "(1436509052.249713)"


def test_it_has_its_name_only_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    log = CandumpLog(str(path), "can0", 1_000_000_000)
    chunk = records.pack_frames([_frame(i) for i in range(10)])
    for _ in range(500):
        log.add(chunk, 10)
        log.work(100)
    assert not path.exists() and Path(log.part).stat().st_size > 0
    log.close()
    assert len(path.read_text().splitlines()) == 5000 == log.frames and not Path(log.part).exists()
    assert path.read_text().startswith("(1.000000) can0 100#0000000000000000\n")


def test_a_log_that_was_cut_off_is_readable_but_keeps_the_other_name(tmp_path: Path) -> None:
    log = CandumpLog(str(tmp_path / "x.log"), "can0", 0)
    log.add(records.pack_frames([_frame(1)]), 1)
    log.abandon()
    assert Path(log.part).read_text() == "(0.000000) can0 101#0100000000000000\n"
    assert not (tmp_path / "x.log").exists()


def test_many_ids_do_not_fill_the_memory(tmp_path: Path) -> None:
    log = CandumpLog(str(tmp_path / "x.log"), "can0", 0)
    for identifier in range(10_000):
        log.add(records.pack_raw(records.Raw(identifier | records.EFF_FLAG, b"")), 1)
    log.close()
    assert len(log._prefixes) <= 4097
    assert (tmp_path / "x.log").read_text().endswith(f"{9999:08X}#\n")


def test_no_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="No such file") as raised:
        CandumpLog(str(tmp_path / "nowhere" / "x.log"), "can0", 0)
    assert raised.value.file.endswith("x.log")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_full_disk_is_told_at_the_end(tmp_path: Path) -> None:
    (tmp_path / "x.log.part").symlink_to("/dev/full")
    log = CandumpLog(str(tmp_path / "x.log"), "can0", 0)
    chunk = records.pack_frames([_frame(i) for i in range(100)])
    for _ in range(100):
        log.add(chunk, 100)
        log.work(100)
    assert "No space left" in log.failure and log.waiting == 0
    with pytest.raises(BenchError, match="No space left") as raised:
        log.close()
    assert raised.value.file == str(tmp_path / "x.log") and not (tmp_path / "x.log").exists()


def _frame(number: int) -> records.CanFrame:
    return records.CanFrame(0x100 + number, number.to_bytes(8, "little"))
