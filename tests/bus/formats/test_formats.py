"""Every format gives back what it was given, or has said what it does not hold; with python-can as the other reader."""

from __future__ import annotations

from pathlib import Path

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.find import PLACES, load_format
from tunefree_hil.bus.formats.rows import BRS, ERROR, ESI, EXTENDED_BIT, FD, RTR, SENT, Format, Held, Loss, Row

BASES_S = (0.0, 46408.58493, 1724850000.123456)
NAMES = tuple(PLACES)
SUFFIX = {"blf": ".blf", "asc": ".asc", "csv": ".csv", "mf4": ".mf4", "ros1": ".bag", "ros2": ".ros2"}
ROWS = (
    Row(0.0, "can0", 0x123, b"\x01\x02"),
    Row(0.010001, "can0", 0x123 | EXTENDED_BIT, b"", SENT),
    Row(0.02, "can1", 0x7FF, bytes(range(64)), FD | BRS | ESI),
    Row(0.021, "can1", 0x7FE, b"", FD),
    Row(0.03, "can128", 0x11, b"", RTR, 4),
    Row(0.031, "can0", 0x1FFFFFFE | EXTENDED_BIT, b"", RTR | SENT),
    Row(0.04, "can0", 0x44, bytes(8), ERROR),
    Row(0.05, "can0", 0x1FFFFFFF | EXTENDED_BIT, bytes(range(8))),
    Row(0.05, "can0", 5, bytes(12), FD | SENT),
)
SAID = {
    "blf": [],
    "csv": [],
    "mf4": [],
    "asc": [Loss(1, "an error frame is kept without its class, its data and its direction")],
    "ros1": [
        Loss(3, "a CAN FD frame is left out: ROS 1 has no message for it"),
        Loss(2, "the direction (sent) is not kept in a ROS bag"),
    ],
    "ros2": [
        Loss(3, "the direction (sent) is not kept in a ROS bag"),
        Loss(1, "the CAN FD bits BRS and ESI are not kept in a ROS bag"),
    ],
}


@pytest.fixture(scope="module", params=NAMES)
def form(request: pytest.FixtureRequest) -> Format:
    try:
        return load_format(request.param)
    except InputError as error:
        pytest.skip(str(error))


def shifted(base_s: float, rows: tuple[Row, ...] | list[Row] = ROWS) -> list[Row]:
    return [row._replace(time_s=round(row.time_s + base_s, 6)) for row in rows]


def there_and_back(form: Format, rows: list[Row], folder: Path) -> tuple[Held, list[Row]]:
    held = form.hold(rows)
    path = folder / f"x{SUFFIX[form.name]}"
    form.write(path, held.rows)
    return held, form.read(path)


@pytest.mark.parametrize("base_s", BASES_S)
def test_what_is_held_comes_back(form: Format, base_s: float, tmp_path: Path) -> None:
    held, found = there_and_back(form, shifted(base_s), tmp_path)
    assert [row[1:] for row in found] == [row[1:] for row in held.rows]
    assert [row.time_s for row in found] == pytest.approx([row.time_s for row in held.rows], abs=3e-7, rel=0.0)
    assert held.losses == SAID[form.name]


def test_only_what_is_said_is_lost(form: Format) -> None:
    """Frames that no loss speaks of are held as they are."""
    held = form.hold(list(ROWS))
    assert len(held.rows) == len(ROWS) - sum(one.frames for one in held.losses if "left out" in one.what)
    changed = sum(row not in ROWS for row in held.rows)
    assert changed <= sum(one.frames for one in held.losses)
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
        assert [one.frames for one in held.losses] == [1, 1] and "vcan0" in held.losses[0].what


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
    held = form.hold(rows)
    if not held.rows:
        return
    path = tmp_path_factory.mktemp("any") / f"x{SUFFIX[form.name]}"
    form.write(path, held.rows)
    found = form.read(path)
    assert [row[1:] for row in found] == [row[1:] for row in held.rows]
    assert all(abs(a.time_s - b.time_s) < 1e-6 for a, b in zip(found, held.rows, strict=True))


@pytest.mark.parametrize(("name", "reader"), [("blf", can.BLFReader), ("asc", can.ASCReader), ("mf4", can.MF4Reader)])
def test_python_can_reads_our_files(name: str, reader: type, tmp_path: Path) -> None:
    form = load_format(name)
    rows = [row for row in shifted(1724850000.0) if not row.flags & (ERROR | FD)]
    path = tmp_path / f"x{SUFFIX[name]}"
    form.write(path, form.hold(rows).rows)
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
    assert load_format("csv").read(path) == [
        Row(1.25, "can0", 0x123, b"\x01\xff"),
        Row(1.5, "can0", 0x1234567 | EXTENDED_BIT, b"", RTR, 3),
    ]


def test_every_cut_of_a_file_is_refused_or_is_a_beginning(form: Format, tmp_path: Path) -> None:
    """Never a crash, never frames that were not there."""
    rows = form.hold(shifted(46408.0)).rows
    path = tmp_path / f"x{SUFFIX[form.name]}"
    form.write(path, rows)
    if path.is_dir():
        path = next(path.glob("*.db3"))
    whole = path.read_bytes()
    for end in {0, 1, 7, 60, 150, len(whole) // 2, len(whole) - 20, len(whole) - 1}:
        path.write_bytes(whole[:end])
        target = path.parent if form.name == "ros2" else path
        try:
            found = form.read(target)
        except InputError as error:
            assert error.file and error.hint
        else:
            assert found == rows[: len(found)]


def test_garbage_is_refused(form: Format, tmp_path: Path) -> None:
    path = tmp_path / f"x{SUFFIX[form.name]}"
    path.write_bytes(bytes(range(256)) * 40)
    try:
        assert form.read(path) == []
    except InputError as error:
        assert error.code in ("broken_log", "foreign_log", "truncated_log") and str(path) in str(error)


def test_a_channel_number_beyond_the_format_is_refused() -> None:
    rows = [Row(0.0, "can300", 1, b"")]
    with pytest.raises(InputError, match="can300") as caught:
        load_format("mf4").hold(rows)
    assert caught.value.key == "--channel"


def test_relative_asc_stamps_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.asc"
    path.write_text(
        "date Sat Aug 24 01:00:00.000 pm 2024\nbase hex  timestamps relative\nno internal events logged\n"
        "0.100000 1  123             Rx   d 1 AA\n0.100000 1  123             Rx   d 1 AB\n"
    )
    with pytest.raises(InputError, match="relative to the line before"):
        load_format("asc").read(path)
