"""The age of a command when a report of the by-wire unit first echoes it, in a recording of real time.

Commands and reports are timed by two clocks, so a report falls anywhere between two commands, at a time that drifts. On
the tick grid a command acts for the whole tick that ends with the report that echoes it first. That adds the rest of
the tick to a dead time, and the spread of the ages to its uncertainty.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from tunefree_hil.learn.actuators.samples import CHANNELS, ECHOES, rounding_tolerance
from tunefree_hil.learn.drives.decode import FieldSamples

Array = np.ndarray


class CommandAgeCriteria(NamedTuple):
    """When echoes show the ages of their commands; every value is an engineering choice."""

    max_commands_back: int = 15  # that are searched before a report; older ones of this value are not its command
    min_changes: int = 20  # changed echoes with a known age
    max_deviation_periods: float = 1.5  # of an age from the median, in periods of the commands
    min_agreeing_share: float = 0.8  # of the ages, that deviate by at most this
    min_change_tolerances: float = 2.0  # rounding tolerances that count as a change of the echo


COMMAND_AGE = CommandAgeCriteria()


def measure_command_ages(samples_by_field: Mapping[str, FieldSamples]) -> dict[str, Array]:
    """Ages of commands in s at the reports that echo them first, by the field of the echo.

    Returns:
        'report.steer_command_rad' -> shape (n_changes,); channels whose log does not show the ages are absent.
    """
    ages_by_echo = {}
    for channel, echo_name in ECHOES.items():
        command = samples_by_field.get(f"command.{CHANNELS[channel]}")
        echo = samples_by_field.get(f"report.{echo_name}")
        if command is not None and echo is not None and len(command.time_s) > 1:
            ages_s = changed_echo_ages(command, echo)
            period_s = float(np.median(np.diff(np.sort(command.time_s))))
            agrees = _agrees_with_median(ages_s, COMMAND_AGE.max_deviation_periods * period_s)
            if agrees.sum() >= max(COMMAND_AGE.min_changes, COMMAND_AGE.min_agreeing_share * len(ages_s)):
                ages_by_echo[f"report.{echo_name}"] = ages_s[agrees]
    return ages_by_echo


def _agrees_with_median(ages_s: Array, max_deviation_s: float) -> Array:
    """Which ages are near the median; others come from another command of the same value."""
    return np.abs(ages_s - np.median(ages_s)) <= max_deviation_s if len(ages_s) else np.zeros(0, dtype=bool)


def changed_echo_ages(command: FieldSamples, echo: FieldSamples) -> Array:
    """Seconds from the newest command of its value to each report whose echo has changed, shape (n_changes,)."""
    command, echo = _sort_by_time(command), _sort_by_time(echo)
    tolerance = rounding_tolerance(echo.values)
    changed = np.flatnonzero(np.abs(np.diff(echo.values)) > COMMAND_AGE.min_change_tolerances * tolerance) + 1
    report_s, values = echo.time_s[changed], echo.values[changed]
    newest = np.searchsorted(command.time_s, report_s, side="right") - 1
    ages_s = np.full(len(changed), np.nan)
    for n_back in range(COMMAND_AGE.max_commands_back):
        index = np.maximum(newest - n_back, 0)
        matches = (newest >= n_back) & np.isnan(ages_s) & (np.abs(command.values[index] - values) <= tolerance)
        ages_s[matches] = report_s[matches] - command.time_s[index[matches]]
    return ages_s[np.isfinite(ages_s)]


def _sort_by_time(samples: FieldSamples) -> FieldSamples:
    order = np.argsort(samples.time_s, kind="stable")
    return FieldSamples(samples.time_s[order], samples.values[order])
