"""How long before its report a by-wire unit had got the command that it echoes, in a recording of real time.

Who sends commands and who reports have clocks of their own, so that a report comes anywhere between two commands, in
each recording elsewhere. The rows of a tick grid do not show that: a command would seem to act for the whole tick that
ends with the report that echoes it first, and dead times would come out longer by what is left of the tick.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tunefree_hil.learn.heard import Column
from tunefree_hil.learn.pairs import CHANNELS, ECHOES, tolerance

Array = np.ndarray

LONGEST_S = 0.15  # before a report: what came earlier is another command of the same value
FEWEST, MOST = 20, 2000  # changed echoes that tell it; more say no more
PLAIN = 2.0  # times what two roundings differ by: a change


def command_ages(columns: Mapping[str, Column]) -> dict[str, float]:
    """By the field of the echo, 'report.steer_command_rad': seconds, in the middle; where the wire's commands and their
    echo tell it.
    """
    found = {}
    for channel, echo in ECHOES.items():
        sent, said = columns.get(f"command.{CHANNELS[channel]}"), columns.get(f"report.{echo}")
        age_s = None if sent is None or said is None else command_age_s(sent, said)
        if age_s is not None:
            found[f"report.{echo}"] = age_s
    return found


def command_age_s(sent: Column, said: Column) -> float | None:
    """From the newest command of the same value to a report whose echo has just changed, the middle of all; None where
    too few have.
    """
    slack, order = tolerance(said.values), np.argsort(sent.time_s, kind="stable")
    times_s, values = sent.time_s[order], sent.values[order]
    changed = np.flatnonzero(np.abs(np.diff(said.values)) > PLAIN * slack) + 1
    ages = []
    for i in changed[:: max(1, len(changed) // MOST)]:
        begin, end = np.searchsorted(times_s, [said.time_s[i] - LONGEST_S, said.time_s[i]], side="right")
        same = np.flatnonzero(np.abs(values[begin:end] - said.values[i]) <= slack)
        if len(same):
            ages.append(said.time_s[i] - times_s[begin + same[-1]])
    return float(np.median(ages)) if len(ages) >= FEWEST else None
