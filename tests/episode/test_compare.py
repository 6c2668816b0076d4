"""Where two logs part, by tick, id and signal."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.episode.candump import FD, LogFrame
from tunefree_hil.episode.compare import compare_logs, first_divergence
from tunefree_hil.episode.frame_hash import frame_hash, place_frames

TICK_S = 0.01
BRAKE = SimpleNamespace(key=0x60, name="BRAKE_CMD", fits=lambda data: len(data) >= 2)
REPORT = SimpleNamespace(key=0x61, name="BRAKE_REPORT", fits=BRAKE.fits)
# byte 0 is LEVEL, byte 1 COUNT; the third byte is in no signal
CODEC: Any = SimpleNamespace(
    commands=[BRAKE],
    by_id={0x60: BRAKE, 0x61: REPORT},
    decode=lambda message, data: {"LEVEL": float(data[0]), "COUNT": float(data[1])},
)
BASE = [(k, can_id, (can_id, k, 0)) for k in range(4) for can_id in (0x60, 0x61)]


def text(rows: list[tuple[int, int, tuple[int, ...]]]) -> str:
    return "".join(f"({k * TICK_S:.6f}) vcan0 {can_id:03X}#{bytes(data).hex()}\n" for k, can_id, data in rows)


def compare(folder: Path, other: list[tuple[int, int, tuple[int, ...]]]) -> Any:
    (folder / "a.log").write_text(text(BASE))
    (folder / "b.log").write_text(text(other))
    return compare_logs(folder / "a.log", folder / "b.log", CODEC, TICK_S)


def changed(k: int, can_id: int, *data: int) -> list[tuple[int, int, tuple[int, ...]]]:
    return [(k, can_id, data) if row[:2] == (k, can_id) else row for row in BASE]


def test_equal_logs(tmp_path: Path) -> None:
    assert compare(tmp_path, BASE) is None
    assert compare(tmp_path, BASE[::-1]) is None


def test_the_first_signal_that_differs(tmp_path: Path) -> None:
    found = compare(tmp_path, changed(2, 0x61, 0x61, 9, 0))
    assert found == (2, 0, 0x61, "BRAKE_REPORT", "COUNT", 2.0, 9.0)
    assert found.sentence() == "tick 2, BRAKE_REPORT (0x61), COUNT: 2.0 in the first log, 9.0 in the second"


@pytest.mark.parametrize(
    ("data", "signal", "values"),
    [((0x61, 2, 7), "data", ("610200", "610207")), ((0x61,), "data", ("610200", "61"))],
)
def test_no_signal_differs(tmp_path: Path, data: tuple[int, ...], signal: str, values: tuple[str, str]) -> None:
    assert compare(tmp_path, changed(2, 0x61, *data))[4:] == (signal, *values)


def test_a_frame_that_one_log_lacks(tmp_path: Path) -> None:
    without = [row for row in BASE if row[:2] != (1, 0x60)]
    assert compare(tmp_path, without) == (1, 1, 0x60, "BRAKE_CMD", "frame", "sent", "missing")
    assert compare(tmp_path, BASE[:-1])[:3] == (3, 0, 0x61)
    assert compare(tmp_path, [*BASE, (9, 0x60, (0, 0, 0))]) == (9, 1, 0x60, "BRAKE_CMD", "frame", "missing", "sent")


frames = st.builds(
    lambda k, can_id, data, flags: LogFrame(k * TICK_S, "vcan0", can_id, data, flags),
    st.integers(0, 3),
    st.sampled_from([0x60, 0x61]),
    st.binary(max_size=3),
    st.sampled_from([0, FD]),
)


@given(st.lists(frames, max_size=6), st.lists(frames, max_size=6))
def test_no_divergence_exactly_when_the_hashes_are_equal(a: list[LogFrame], b: list[LogFrame]) -> None:
    hashes = [frame_hash(items, TICK_S, {0x60}, {0x61}).hex for items in (a, b)]
    placed = [place_frames(items, TICK_S, {0x60}, {0x61})[0] for items in (a, b)]
    assert (first_divergence(placed[0], placed[1], CODEC) is None) == (hashes[0] == hashes[1])
    assert first_divergence(placed[0], placed[0], CODEC) is None
