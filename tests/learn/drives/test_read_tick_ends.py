"""Ticks end where no message comes, so that half a millisecond of jitter does not make a message a tick late."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.learn.made_logs import car, rows_of, write_log
from tunefree_hil.learn.drives.read import choose_tick_origin, read_drives

DT_S, FIRST_S = 0.01, 1.7e9


def stamps(*phases_s: float, jitter_s: float = 1e-4, ticks: int = 400) -> list[np.ndarray]:
    chance = np.random.default_rng(1)
    return [FIRST_S + DT_S * np.arange(ticks) + one + jitter_s * chance.uniform(-1.0, 1.0, ticks) for one in phases_s]


def ticks_of(times_s: list[np.ndarray], zero_s: float) -> list[np.ndarray]:
    return [np.rint((one - zero_s) / DT_S) for one in times_s]


@pytest.mark.parametrize("phases_s", [(0.0, 0.0005), (0.0, 0.002, 0.0035), (0.0,)])
def test_messages_that_come_soon_after_the_first_frame_leave_it_where_it_is(phases_s: tuple[float, ...]) -> None:
    assert choose_tick_origin(stamps(*phases_s), DT_S, FIRST_S) == FIRST_S


@pytest.mark.parametrize("phases_s", [(0.0, 0.005), (0.0, 0.004, 0.0062), (0.0, 0.0049, 0.0071)])
def test_messages_of_one_cycle_are_in_one_tick_and_come_once_in_each(phases_s: tuple[float, ...]) -> None:
    times_s = stamps(*phases_s)
    zero_s = choose_tick_origin(times_s, DT_S, FIRST_S)
    assert abs(zero_s - FIRST_S) <= 0.5 * DT_S
    for ticks in ticks_of(times_s, zero_s):
        assert np.array_equal(np.diff(ticks), np.ones(len(ticks) - 1))
    if len(phases_s) > 2:
        late, later = ticks_of(times_s, zero_s)[1:]
        assert np.array_equal(late, later), "two milliseconds apart are no tick"


@given(phases=st.lists(st.floats(0.0, 0.999), min_size=1, max_size=8))
def test_no_message_is_cut_where_there_is_room(phases: list[float]) -> None:
    """Eight messages leave more than a tenth of a tick free."""
    times_s = stamps(*(DT_S * one for one in phases))
    zero_s = choose_tick_origin(times_s, DT_S, FIRST_S)
    assert abs(zero_s - FIRST_S) <= 0.5 * DT_S + 1e-6
    for ticks in ticks_of(times_s, zero_s):
        assert np.array_equal(np.diff(ticks), np.ones(len(ticks) - 1))


def test_messages_at_any_time_leave_it_and_so_does_silence() -> None:
    chance = np.random.default_rng(2)
    anywhere = [FIRST_S + np.sort(chance.uniform(0.0, 100.0, 20000))]
    assert choose_tick_origin(anywhere, DT_S, FIRST_S) == FIRST_S
    assert choose_tick_origin([np.zeros(0)], DT_S, FIRST_S) == FIRST_S


def test_a_report_half_a_tick_after_the_first_frame_comes_in_every_tick(tmp_path: Path) -> None:
    """With ticks from the first frame every second report would share a tick with its neighbour."""
    chance, codec = np.random.default_rng(3), car("mkz_bywire").codec
    late = {one.key for one in codec.telemetry}
    rows = [
        row._replace(time_s=round(row.time_s + (0.005 + 3e-4 * chance.uniform(-1.0, 1.0)) * (row.can_id in late), 6))
        for row in rows_of("mkz_bywire", 4.0, zero_s=1.65e9)
    ]
    (drive,) = read_drives([write_log(tmp_path / "a.log", sorted(rows))], codec)
    for field in ("report.speed_mps", "report.steer_rad"):
        rows_with_report = np.flatnonzero(drive.fresh[field])
        assert len(rows_with_report) > 150 and len(set(np.diff(rows_with_report).tolist())) == 1
