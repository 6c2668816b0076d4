"""How long before its report a by-wire unit had got the command that it echoes, in a recording of real time.

Who sends commands and who reports have clocks of their own, so that a report comes anywhere between two commands, in
each recording elsewhere, and by and by elsewhere in one. The rows of a tick grid do not show that: there a command
acts for the whole tick that ends with the report that echoes it first, so that a dead time comes out longer by what is
left of the tick, and as much less sure as that differs.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tunefree_hil.learn.actuators.samples import CHANNELS, ECHOES, tolerance
from tunefree_hil.learn.drives.decode import Column

Array = np.ndarray

EARLIER = 15  # commands before a report: what came before those is another one of the same value
FEWEST = 20  # changed echoes that tell it
NEAR, AGREEING = 1.5, 0.8  # periods of the commands from the middle age; the share of ages that are so near to it
PLAIN = 2.0  # times what two roundings differ by: a change


def command_ages(columns: Mapping[str, Column]) -> dict[str, Array]:
    """By the field of the echo, 'report.steer_command_rad': seconds [m] of reports whose echo has just changed, where
    the wire's commands and their echo tell enough of them.
    """
    found = {}
    for channel, echo in ECHOES.items():
        sent, said = columns.get(f"command.{CHANNELS[channel]}"), columns.get(f"report.{echo}")
        if sent is not None and said is not None and len(sent.time_s) > 1:
            ages_s = changed_ages(sent, said)
            near = _of_one(ages_s, NEAR * float(np.median(np.diff(np.sort(sent.time_s)))))
            if near.sum() >= max(FEWEST, AGREEING * len(ages_s)):
                found[f"report.{echo}"] = ages_s[near]
    return found


def _of_one(ages_s: Array, within_s: float) -> Array:
    """Which of some ages [m] are about the middle one: an echo of which the command is long gone finds any other."""
    return np.abs(ages_s - np.median(ages_s)) <= within_s if len(ages_s) else np.zeros(0, dtype=bool)


def changed_ages(sent: Column, said: Column) -> Array:
    """Seconds [m] from the newest command of its value to each report whose echo has just changed."""
    sent, said = _in_order(sent), _in_order(said)
    slack = tolerance(said.values)
    changed = np.flatnonzero(np.abs(np.diff(said.values)) > PLAIN * slack) + 1
    at_s, values = said.time_s[changed], said.values[changed]
    newest = np.searchsorted(sent.time_s, at_s, side="right") - 1
    ages_s = np.full(len(changed), np.nan)
    for back in range(EARLIER):
        place = np.maximum(newest - back, 0)
        same = (newest >= back) & np.isnan(ages_s) & (np.abs(sent.values[place] - values) <= slack)
        ages_s[same] = at_s[same] - sent.time_s[place[same]]
    return ages_s[np.isfinite(ages_s)]


def _in_order(column: Column) -> Column:
    order = np.argsort(column.time_s, kind="stable")
    return Column(column.time_s[order], column.values[order])
