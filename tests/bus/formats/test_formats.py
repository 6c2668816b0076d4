"""Every format gives back what it was given, or has said what it does not hold; with python-can as the other reader."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.bus.formats.made import ROWS, SUFFIX, Held, hold, shifted, write
from tunefree_hil.bus.formats.find import load_format
from tunefree_hil.bus.formats.rows import BRS, ERROR, EXTENDED_BIT, FD, RTR, SENT, Format, Row

BASES_S = (0.0, 46408.58493, 1724850000.123456)
SAID = {
    "blf": {},
    "csv": {},
    "mf4": {},
    "asc": {"an error frame is kept without its class, its data and its direction": 1},
    "ros1": {
        "a CAN FD frame is left out: ROS 1 has no message for it": 3,
        "the direction (sent) is not kept in a ROS bag": 2,
    },
    "ros2": {
        "the direction (sent) is not kept in a ROS bag": 3,
        "the CAN FD bits BRS and ESI are not kept in a ROS bag": 1,
    },
}


def there_and_back(form: Format, rows: list[Row], folder: Path) -> tuple[Held, list[Row]]:
    held = hold(form, rows)
    path = folder / f"x{SUFFIX[form.name]}"
    write(form, path, held.rows)
    return held, list(form.read(path))


@pytest.mark.parametrize("base_s", BASES_S)
def test_what_is_held_comes_back(form: Format, base_s: float, tmp_path: Path) -> None:
    held, found = there_and_back(form, shifted(base_s), tmp_path)
    assert [row[1:] for row in found] == [row[1:] for row in held.rows]
    assert [row.time_s for row in found] == pytest.approx([row.time_s for row in held.rows], abs=3e-7, rel=0.0)
    assert held.losses == SAID[form.name]


def test_only_what_is_said_is_lost(form: Format) -> None:
    """Frames that no loss speaks of are held as they are."""
    held = hold(form, ROWS)
    assert len(held.rows) == len(ROWS) - sum(count for what, count in held.losses.items() if "left out" in what)
    changed = sum(row not in ROWS for row in held.rows)
    assert changed <= sum(held.losses.values())
    if not held.losses:
        assert held.rows == list(ROWS)


def test_channels_with_names_are_numbered_or_kept(form: Format, tmp_path: Path) -> None:
    rows = [Row(0.0, "vcan0", 1, b"a"), Row(0.001, "can0", 2, b"b"), Row(0.002, "bench", 3, b"c")]
    held, found = there_and_back(form, rows, tmp_path)
    assert found == held.rows
    if form.name in ("csv", "ros1", "ros2"):
        assert [row.channel for row in found] == ["vcan0", "can0", "bench"] and not held.losses
    else:
        assert len({row.channel for row in found}) == 3, "three channels stay three"
        assert list(held.losses.values()) == [1, 1] and "vcan0" in next(iter(held.losses))


def test_a_later_frame_with_an_earlier_stamp_keeps_it(form: Format, tmp_path: Path) -> None:
    rows = shifted(1724850000.0, [Row(0.5, "can0", 1, b"a"), Row(0.25, "can0", 2, b"b"), Row(0.75, "can0", 3, b"c")])
    _, found = there_and_back(form, rows, tmp_path)
    assert sorted(found) == sorted(rows)


frames = st.builds(
    lambda time, channel, can_id, fd, data: Row(time / 1e6, channel, can_id, data if fd else data[:8], fd),
    st.integers(0, 10**8),
    st.sampled_from(["can0", "can3"]),
    st.integers(0, 0x7FF) | st.integers(0, 0x1FFFFFFF).map(lambda number: number | EXTENDED_BIT),
    st.sampled_from([0, FD, FD | BRS]),
    st.sampled_from([0, 1, 7, 8, 12, 20, 48, 64]).flatmap(lambda size: st.binary(min_size=size, max_size=size)),
)


@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows=st.lists(frames, min_size=1, max_size=12, unique_by=lambda row: row.time_s))
def test_any_frames(form: Format, rows: list[Row], tmp_path_factory: pytest.TempPathFactory) -> None:
    rows = sorted(rows)
    if not hold(form, rows).rows:
        return
    held, found = there_and_back(form, rows, tmp_path_factory.mktemp("any"))
    assert [row[1:] for row in found] == [row[1:] for row in held.rows]
    assert all(abs(a.time_s - b.time_s) < 1e-6 for a, b in zip(found, held.rows, strict=True))


def mf4_reader() -> type:
    """python-can's own, loaded anew: bus/python_can.py let asammdf look absent when this process first imported it."""
    return importlib.reload(sys.modules["can.io.mf4"]).MF4Reader


@pytest.mark.parametrize(("name", "reader"), [("blf", can.BLFReader), ("asc", can.ASCReader), ("mf4", mf4_reader())])
def test_python_can_reads_our_files(name: str, reader: type, tmp_path: Path) -> None:
    form = load_format(name)
    rows = [row for row in shifted(1724850000.0) if not row.flags & (ERROR | FD)]
    path = tmp_path / f"x{SUFFIX[name]}"
    write(form, path, hold(form, rows).rows)
    options = {"relative_timestamp": False} if name == "asc" else {}
    with reader(path, **options) as messages:
        found = [(m.timestamp, m.arbitration_id, bytes(m.data), m.is_rx, m.channel) for m in messages]
    for (time_s, can_id, data, is_rx, channel), row in zip(found, rows, strict=True):
        assert abs(time_s - row.time_s) < 1e-6 and can_id == row.can_id & ~EXTENDED_BIT
        assert data == row.data and is_rx == (not row.flags & SENT) and f"can{channel}" == row.channel


def test_python_cans_csv_is_read(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    with can.CSVWriter(path) as writer:
        writer.on_message_received(can.Message(1.25, 0x123, data=b"\x01\xff", is_extended_id=False))
        writer.on_message_received(can.Message(1.5, 0x1234567, dlc=3, is_remote_frame=True))
    assert list(load_format("csv").read(path)) == [
        Row(1.25, "can0", 0x123, b"\x01\xff"),
        Row(1.5, "can0", 0x1234567 | EXTENDED_BIT, b"", RTR, 3),
    ]
