"""Held-out rows are never next to training rows, whole drives are held out if possible, and parts have no gaps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.drives.drive import Drive, DrivePart
from tunefree_hil.learn.drives.split import SPLIT, find_complete_parts, split_drives

DT_S = 0.01


def made(name: str, seconds: float, *, period: int = 1, log_hash: str = "") -> Drive:
    ticks = round(seconds / DT_S)
    fresh = np.arange(ticks) % period == 0
    values = np.floor(np.arange(ticks) / period).astype(float)
    return Drive(name, log_hash or name, DT_S, {"a": values}, {"a": fresh}, np.ones(ticks, dtype=bool))


def seconds_of(parts: tuple[DrivePart, ...]) -> float:
    return sum((part.end - part.begin) * part.drive.dt_s for part in parts)


def marked(parts: tuple[DrivePart, ...], drive: Drive) -> np.ndarray:
    rows = np.zeros(drive.n_rows, dtype=int)
    for part in parts:
        if part.drive.name == drive.name:
            rows[part.begin : part.end] += 1
    return rows


@given(st.lists(st.floats(5.0, 90.0), min_size=3, max_size=15), st.integers(0, 5))
def test_whole_drives_are_held_out(lengths: list[float], seed: int) -> None:
    drives = [made(f"d{i}", length) for i, length in enumerate(lengths)]
    split = split_drives(drives, seed=seed)
    held_out_names = {part.drive.name for part in split.held_out}
    assert held_out_names and held_out_names.isdisjoint(part.drive.name for part in split.training)
    assert all((part.begin, part.end) == (0, part.drive.n_rows) for part in (*split.training, *split.held_out))
    assert seconds_of(split.training) + seconds_of(split.held_out) == pytest.approx(
        sum(d.n_rows for d in drives) * DT_S
    )
    share = seconds_of(split.held_out) / sum(lengths)
    assert abs(share - 0.2) <= max(0.2, min(lengths) / sum(lengths)) + 1e-3
    assert f"{len(held_out_names)} of {len(drives)} drives" in split.description and f"seed {seed}" in split.description
    assert split_drives(drives, seed=seed).description == split.description


def test_the_seed_decides_and_the_share_is_kept() -> None:
    drives = [made(f"d{i}", 20.0) for i in range(20)]
    splits = [split_drives(drives, seed=seed) for seed in range(5)]
    assert all(len(split.held_out) == 4 for split in splits)
    assert len({tuple(part.drive.name for part in split.held_out) for split in splits}) > 1


def test_the_same_recording_stays_on_one_side() -> None:
    drives = [made(f"d{i}", 20.0, log_hash=f"h{i // 2}") for i in range(10)]
    for seed in range(6):
        split = split_drives(drives, seed=seed)
        held_out_hashes = {part.drive.log_hash for part in split.held_out}
        assert held_out_hashes.isdisjoint(part.drive.log_hash for part in split.training)


@given(st.lists(st.floats(16.0, 400.0), min_size=1, max_size=2), st.integers(0, 9))
def test_blocks_have_a_guard(lengths: list[float], seed: int) -> None:
    drives = [made(f"d{i}", length) for i, length in enumerate(lengths)]
    split = split_drives(drives, seed=seed)
    for drive in drives:
        training, judging = marked(split.training, drive), marked(split.held_out, drive)
        assert training.max() == judging.max() == 1
        rows = np.flatnonzero(judging)
        for row in np.flatnonzero(training)[:: max(1, drive.n_rows // 200)].tolist():
            assert np.abs(rows - row).min() > SPLIT.guard_s / DT_S
        unused = int((training + judging == 0).sum()) * DT_S
        edges = int((np.abs(np.diff(judging)) == 1).sum())
        assert unused <= SPLIT.guard_s * edges + 1.0 + 1e-6
    long = [length for length in lengths if length >= 100.0]
    if len(long) == len(lengths):
        assert 0.12 < seconds_of(split.held_out) / sum(lengths) < 0.32
    assert "not used" in split.description


def test_blocks_of_twenty_seconds() -> None:
    split = split_drives([made("one", 300.0)], seed=4)
    assert "3 of 15 blocks of 20 s" in split.description and "one drive only" in split.description
    assert all((part.end - part.begin) % 2000 == 0 for part in split.held_out) and seconds_of(split.held_out) == 60.0
    begins = {split_drives([made("one", 300.0)], seed=seed).held_out[0].begin for seed in range(6)}
    assert len(begins) > 1


@pytest.mark.parametrize(("drives", "words"), [([made("d", 10.0)], "too short"), ([], "no data is left")])
def test_too_little(drives: list[Drive], words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        split_drives(drives, seed=1)
    assert caught.value.code == "too_short"


def test_a_share_that_is_none() -> None:
    with pytest.raises(InputError, match="must be above 0"):
        split_drives([made("d", 100.0)], held_out=0.9, seed=1)


@pytest.mark.parametrize("period", [1, 2, 10])
def test_a_gap_ends_a_part(period: int) -> None:
    """A gap begins 20 ms after a missing frame was due; the last value counts for its period."""
    drive = made("d", 10.0, period=period)
    fresh = drive.fresh["a"]
    fresh[400 : 400 + period + 3] = False  # the next one comes 30 ms late or later
    spans = [(part.begin, part.end) for part in find_complete_parts(drive, ["a"])]
    last = int(np.flatnonzero(fresh[:400])[-1])
    following = 400 + period + 3 + int(np.flatnonzero(fresh[400 + period + 3 :])[0])
    assert spans == [(0, last + period), (following, 1000)]
    fresh[:] = np.arange(1000) % period == 0
    fresh[400] = False  # one frame lost
    expected = [(0, 1000)] if period <= 2 else [(0, 400), (410, 1000)]
    assert [(part.begin, part.end) for part in find_complete_parts(drive, ["a"])] == expected


def test_what_is_no_number_or_never_comes() -> None:
    drive = made("d", 10.0)
    drive.fields["a"][300:305] = np.nan  # type: ignore[index]
    assert [(part.begin, part.end) for part in find_complete_parts(drive, ["a"])] == [(0, 300), (305, 1000)]
    assert [(part.begin, part.end) for part in find_complete_parts(drive, ["a"], min_part_s=5.0)] == [(305, 1000)]
    assert find_complete_parts(drive, ["a", "b"]) == [] and len(find_complete_parts(drive, [])) == 1
    drive.fresh["a"][:] = False  # type: ignore[index]
    assert find_complete_parts(drive, ["a"]) == []


def test_gaps_cut_both_sides_of_a_split() -> None:
    drives = [made(f"d{i}", 30.0) for i in range(5)]
    for drive in drives:
        drive.fresh["a"][1000:1100] = False  # type: ignore[index]
    split = split_drives(drives, seed=2, needed=["a"])
    spans = {(part.begin, part.end) for part in (*split.training, *split.held_out)}
    assert spans == {(0, 1000), (1100, 3000)}
    with pytest.raises(InputError, match="have no gap"):
        split_drives(drives, seed=2, needed=["b"])
