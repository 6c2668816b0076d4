"""How long before its report a by-wire unit had got the command that it echoes, in a recording of real time.

Who sends commands and who reports have clocks of their own, so that a report comes anywhere between two commands, in
each recording elsewhere, and by and by elsewhere in one. The rows of a tick grid do not show that: a command would seem
to act for the whole tick that ends with the report that echoes it first, and dead times would come out longer by what
is left of the tick.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from tunefree_hil.learn.heard import Column
from tunefree_hil.learn.pairs import CHANNELS, ECHOES, tolerance

Array = np.ndarray

EARLIER = 15  # commands before a report: what came before those is another one of the same value
FEWEST = 20  # changed echoes that tell it
PLAIN = 2.0  # times what two roundings differ by: a change
FARTHEST = 1.0  # ticks from the middle one: another command of the same value


class Rows(NamedTuple):
    """The grid that ages are laid on: so many rows, a report stamped zero_s + k * dt_s in row k + late_ticks."""

    count: int
    dt_s: float
    zero_s: float
    late_ticks: int


def command_ages(columns: Mapping[str, Column], grid: Rows) -> dict[str, Array]:
    """By the field of the echo, 'report.steer_command_rad': seconds [n], where the wire's commands and their echo tell
    it. Each row has that of the changed echo next to it: where nothing changes it does not matter.
    """
    found = {}
    for channel, echo in ECHOES.items():
        sent, said = columns.get(f"command.{CHANNELS[channel]}"), columns.get(f"report.{echo}")
        if sent is None or said is None:
            continue
        at_s, ages_s = changed_ages(sent, said)
        near = np.abs(ages_s - np.median(ages_s)) < FARTHEST * grid.dt_s if len(ages_s) else np.zeros(0, dtype=bool)
        if near.sum() >= FEWEST:
            rows = np.rint((at_s[near] - grid.zero_s) / grid.dt_s) + grid.late_ticks
            found[f"report.{echo}"] = _nearest(rows, ages_s[near], grid.count)
    return found


def changed_ages(sent: Column, said: Column) -> tuple[Array, Array]:
    """(stamps [m], seconds [m]) of reports whose echo has just changed: from the newest command of its value."""
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
    told = np.isfinite(ages_s)
    return at_s[told], ages_s[told]


def _in_order(column: Column) -> Column:
    order = np.argsort(column.time_s, kind="stable")
    return Column(column.time_s[order], column.values[order])


def _nearest(rows: Array, values: Array, count: int) -> Array:
    """On each of so many rows the value of the nearest of some, which are in order."""
    middles = 0.5 * (rows[1:] + rows[:-1])
    return values[np.searchsorted(middles, np.arange(count))]
