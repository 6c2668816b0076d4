"""The age of a command at the report that echoes it, and its effect on a calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tunefree_hil.learn.actuators.command_age import COMMAND_AGE, changed_echo_ages, measure_command_ages
from tunefree_hil.learn.actuators.samples import collect_samples
from tunefree_hil.learn.drives.decode import FieldSamples
from tunefree_hil.learn.drives.drive import Drive, DrivePart

DT_S = 0.01
PERIOD_S = 0.02
ECHO = "report.steer_command_rad"


def command_and_echo(phase_s: float, period_s: float = PERIOD_S, seed: int = 1) -> tuple[FieldSamples, FieldSamples]:
    """Half a minute of commands every tick, and of reports phase_s later that echo the newest command."""
    sent_s = DT_S * np.arange(3000)
    values = np.round(0.5 + 0.4 * np.sin(1.7 * sent_s + seed), 4)
    said_s = np.arange(0.1, 29.0, period_s) + phase_s
    said_s += 1e-5 * np.random.default_rng(seed).standard_normal(len(said_s))
    return FieldSamples(sent_s, values), FieldSamples(said_s, values[np.searchsorted(sent_s, said_s, side="right") - 1])


@settings(deadline=None)
@given(st.floats(0.0005, 0.0095), st.sampled_from([0.01, 0.02, 0.05]))
def test_the_age_of_a_command_is_found_wherever_reports_come(phase_s: float, period_s: float) -> None:
    ages_s = changed_echo_ages(*command_and_echo(phase_s, period_s))
    assert len(ages_s) > 400 and np.median(ages_s) == pytest.approx(phase_s, abs=2e-4)
    assert np.percentile(np.abs(ages_s - phase_s), 95) < 5e-4


def test_a_log_whose_frames_are_not_in_order_says_the_same() -> None:
    command, echo = command_and_echo(0.004)
    mixed = np.random.default_rng(2).permutation(len(command.time_s))
    assert np.array_equal(changed_echo_ages(command, echo), changed_echo_ages(_of(command, mixed), echo))


def test_a_command_that_hardly_changes_or_is_another_tells_nothing() -> None:
    command, echo = command_and_echo(0.004)
    few, still = (
        _of(echo, np.arange(COMMAND_AGE.min_changes // 2)),
        FieldSamples(echo.time_s, np.full(len(echo.values), 0.3)),
    )
    for bad_echo in (few, still, FieldSamples(echo.time_s, echo.values + 1.0)):
        assert measure_command_ages({"command.steer_rad": command, ECHO: bad_echo}) == {}


def test_an_echo_whose_command_is_long_gone_tells_nothing() -> None:
    """The echo is older than the search goes back, so it matches any other command of that value."""
    sent, _ = command_and_echo(0.004)
    said_s = np.arange(1.0, 29.0, PERIOD_S)
    swings = FieldSamples(sent.time_s, np.round(np.random.default_rng(5).uniform(0.1, 0.9, len(sent.time_s)), 2))
    late = FieldSamples(said_s, swings.values[np.searchsorted(sent.time_s, said_s - 0.3, side="right") - 1])
    assert (
        len(changed_echo_ages(swings, late)) > COMMAND_AGE.min_changes
        and measure_command_ages({"command.steer_rad": swings, ECHO: late}) == {}
    )


def test_each_channel_has_its_own_where_both_sides_are_heard() -> None:
    (command, echo), (pedal, _) = command_and_echo(0.003), command_and_echo(0.006)
    columns = {"command.steer_rad": command, ECHO: echo, "command.brake_frac": pedal}
    assert measure_command_ages(columns).keys() == {ECHO}


@pytest.mark.parametrize(("phases_s", "apart_s"), [((0.004, 0.004), 0.0), ((0.001, 0.009), 0.004)])
def test_where_it_differs_from_log_to_log_the_pairs_say_so(phases_s: Sequence[float], apart_s: float) -> None:
    parts = [_part(phase_s) for phase_s in phases_s]
    samples = collect_samples(parts, "steer")
    assert samples.command_age_std_s == pytest.approx(apart_s, abs=3e-4)
    assert ("deviation 4.0 ms" in samples.description) == (apart_s > 0.0)


def _part(phase_s: float) -> DrivePart:
    ages = measure_command_ages(dict(zip(("command.steer_rad", ECHO), command_and_echo(phase_s), strict=True)))
    turned = np.sin(0.03 * np.arange(2000))
    fields = {"command.steer_rad": turned, ECHO: turned, "report.steer_rad": turned}
    always = np.ones(2000, dtype=bool)
    drive = Drive("made", "", DT_S, fields, dict.fromkeys(fields, always), always, None, ages)
    return DrivePart(drive, 0, 2000)


def _of(column: FieldSamples, rows: np.ndarray) -> FieldSamples:
    return FieldSamples(column.time_s[rows], column.values[rows])
