"""Commands that come within a tick: how long before their report, and what a channel was asked on average."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tunefree_hil.learn.command_age import FEWEST, Rows, changed_ages, command_ages
from tunefree_hil.learn.heard import Column
from tunefree_hil.learn.pairs import as_held

DT_S = 0.01
PERIOD_S = 0.02


def told(phase_s: float, period_s: float = PERIOD_S, seed: int = 1) -> tuple[Column, Column]:
    """Half a minute of commands every tick, and of reports that echo the newest one, phase_s behind it."""
    sent_s = DT_S * np.arange(3000)
    values = np.round(0.5 + 0.4 * np.sin(1.7 * sent_s + seed), 4)
    said_s = np.arange(0.1, 29.0, period_s) + phase_s
    said_s += 1e-5 * np.random.default_rng(seed).standard_normal(len(said_s))
    return Column(sent_s, values), Column(said_s, values[np.searchsorted(sent_s, said_s, side="right") - 1])


@settings(deadline=None)
@given(st.floats(0.0005, 0.0095), st.sampled_from([0.01, 0.02, 0.05]))
def test_the_age_of_a_command_is_found_wherever_reports_come(phase_s: float, period_s: float) -> None:
    at_s, ages_s = changed_ages(*told(phase_s, period_s))
    assert len(at_s) > 400 and np.median(ages_s) == pytest.approx(phase_s, abs=2e-4)
    assert np.percentile(np.abs(ages_s - phase_s), 95) < 5e-4


def test_a_log_whose_frames_are_not_in_order_says_the_same() -> None:
    sent, said = told(0.004)
    mixed = np.random.default_rng(2).permutation(len(sent.time_s))
    for one, other in zip(changed_ages(sent, said), changed_ages(_of(sent, mixed), said), strict=True):
        assert np.array_equal(one, other)


def test_each_row_has_its_own_where_a_clock_drifts() -> None:
    """The reports' clock gains a tick in half a minute: by and by another command is the newest."""
    sent, _ = told(0.0)
    said_s = np.arange(0.1, 29.0, PERIOD_S) * (1.0 + DT_S / 29.0)
    newest = np.searchsorted(sent.time_s, said_s, side="right") - 1
    columns = {"command.steer_rad": sent, "report.steer_command_rad": Column(said_s, sent.values[newest])}
    (found,) = command_ages(columns, Rows(2900, DT_S, 0.0, 1)).values()
    rows = np.rint(said_s / DT_S).astype(int) + 1
    inside = (rows > 20) & (rows < 2850)
    assert np.median(np.abs(found[rows[inside]] - (said_s - sent.time_s[newest])[inside])) < 2e-4
    assert found[100] < 0.002 and found[2700] > 0.008 and len(found) == 2900


def test_a_command_that_hardly_changes_or_is_another_tells_nothing() -> None:
    sent, said = told(0.004)
    few, still = _of(said, np.arange(FEWEST // 2)), Column(said.time_s, np.full(len(said.values), 0.3))
    for one in (few, still, Column(said.time_s, said.values + 1.0)):
        columns = {"command.steer_rad": sent, "report.steer_command_rad": one}
        assert command_ages(columns, Rows(100, DT_S, 0.0, 1)) == {}


def test_each_channel_has_its_own_where_both_sides_are_heard() -> None:
    (sent, said), (pedal, _) = told(0.003), told(0.006)
    columns = {"command.steer_rad": sent, "report.steer_command_rad": said, "command.brake_frac": pedal}
    found = command_ages(columns, Rows(2900, DT_S, 0.0, 1))
    assert found.keys() == {"report.steer_command_rad"}


def _of(column: Column, rows: np.ndarray) -> Column:
    return Column(column.time_s[rows], column.values[rows])


@pytest.mark.parametrize("age_s", [0.0, 0.002, 0.0075, 0.0115])
def test_a_tick_was_asked_what_it_was_on_average(age_s: float) -> None:
    """Against the mean over the ten milliseconds before each report; of the last age a unit echoes late what it got."""
    sent_s = DT_S * np.arange(400)
    values = np.random.default_rng(3).standard_normal(400)
    fine_s = np.arange(0.0, 4.0, 1e-5) + 0.5e-5
    asked = values[np.searchsorted(sent_s, fine_s, side="right") - 1]
    ends = sent_s[5:395] + age_s
    whole = [asked[(fine_s > end - DT_S) & (fine_s < end)].mean() for end in ends]
    assert as_held(values, np.full(400, age_s), DT_S)[5:395] == pytest.approx(np.array(whole), abs=2e-3)


def test_commands_that_come_with_the_ticks_stay() -> None:
    command = np.array([0.0, 1.0, np.nan, 2.0])
    assert as_held(command, None, DT_S) is command
    assert as_held(command, np.full(4, DT_S), DT_S) == pytest.approx(command, nan_ok=True)
