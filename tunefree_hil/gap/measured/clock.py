"""What the clocks say: commands on the wire against their echoes, tick by tick, without any model of the car.

An echo is the command that the by-wire unit obeys. Delayed and held commands are still commands: each echo must lie
between those that were sent about a transport earlier. One that does not was never sent, or its frame was lost.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.measured.chain import Opened
from tunefree_hil.gap.measured.observability import OUTPUTS
from tunefree_hil.gap.model.graph import CHANNELS
from tunefree_hil.learn.actuators.samples import ECHOES, tolerance
from tunefree_hil.learn.drives.runs import every_of, throughout

Array = np.ndarray

LONGEST_S = 0.8
SLACK = 2  # ticks to either side of the transport: bus, queue and phase of the frames; of slow commands more
MOST_STRANGE = 0.01  # of the echoes
LEAST_MOVED = 20  # echoes that changed: fewer say nothing of a delay


class Echo(NamedTuple):
    """A channel's echo. late_s: from wire to echo; strange: share of echoes that no sent command explains."""

    channel: str
    late_s: float
    strange: float
    rows: int

    @property
    def broken(self) -> bool:
        """Whether commands were lost or changed on their way."""
        return self.strange > MOST_STRANGE


def echoes(opened: Opened) -> list[Echo]:
    """Of all channels that are commanded on the wire and echoed, and that moved."""
    found = []
    for i, channel in enumerate(CHANNELS):
        wire = opened.signals.get(f"command.{OUTPUTS[channel]}")
        echo = opened.signals.get(f"report.{ECHOES[channel]}")
        if wire is None or echo is None:
            continue
        # until the next command an echo stands, while the straight line between commands goes on
        slack = SLACK + round(every_of(wire.fresh)) - 1
        # what was sent in a gap of the recording nobody knows, and whether it was obeyed
        sure = throughout(wire.there, round(LONGEST_S / opened.dt_s) + slack, slack)
        rows = np.flatnonzero(echo.fresh & opened.follows[:, i] & sure)
        values = echo.values[rows]
        moved = np.abs(np.diff(values, prepend=values[:1])) > tolerance(echo.values)
        if moved.sum() >= LEAST_MOVED:
            found.append(_echo(channel, wire.values, values, rows, moved, slack, opened.dt_s))
    return found


def _echo(channel: str, wire: Array, values: Array, rows: Array, moved: Array, slack: int, dt_s: float) -> Echo:
    shifts = np.arange(round(LONGEST_S / dt_s))
    missed = [float(np.mean(np.abs(wire[rows[moved] - s] - values[moved]))) for s in shifts]
    best = int(np.argmin(missed))
    at = np.clip(rows[:, None] - best + np.arange(-slack, slack + 1), 0, len(wire) - 1)
    near, off = wire[at], tolerance(values)
    strange = (values < near.min(axis=1) - off) | (values > near.max(axis=1) + off)
    return Echo(channel, best * dt_s, float(np.mean(strange)), len(rows))
