"""Commands on the bus compared with their echoes, tick by tick, without any model of the car.

An echo is the command that the by-wire unit obeys. A delayed or held command is still one that was sent, so each echo
has to lie between the commands that were sent about one transport delay before. Where it does not, its frame was lost
or changed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.measured.chain import MeasuredDrive
from tunefree_hil.gap.measured.observability import OUTPUT_FIELDS
from tunefree_hil.gap.model.graph import CHANNELS
from tunefree_hil.learn.actuators.samples import ECHOES, rounding_tolerance
from tunefree_hil.learn.drives.runs import sample_interval_ticks, true_throughout

Array = np.ndarray


class EchoCriteria(NamedTuple):
    """How an echo is checked (docs/results/criteria.md)."""

    max_delay_s: float = 0.8  # largest delay that is searched
    slack_ticks: int = 2  # to either side of the delay: bus, queue, phase of the frames; of slow commands more
    max_unexplained_share: float = 0.01  # of the echoes, that are outside the commands near the delay
    min_changes: int = 20  # echoes that changed: fewer do not determine a delay


ECHO_CRITERIA = EchoCriteria()


class CommandEcho(NamedTuple):
    """The echo of a channel's commands.

    Args:
        channel: name.
        delay_s: from command to echo.
        unexplained_share: share of the echoes that no sent command explains.
        rows: number of echoes.
    """

    channel: str
    delay_s: float
    unexplained_share: float
    rows: int

    @property
    def is_broken(self) -> bool:
        """Whether commands are lost or changed on their way."""
        return self.unexplained_share > ECHO_CRITERIA.max_unexplained_share


def check_echoes(drive: MeasuredDrive) -> list[CommandEcho]:
    """The echoes of all channels that are commanded on the bus and echoed, and that move."""
    echoes = []
    for i, channel in enumerate(CHANNELS):
        command = drive.signals.get(f"command.{OUTPUT_FIELDS[channel]}")
        echo = drive.signals.get(f"report.{ECHOES[channel]}")
        if command is None or echo is None:
            continue
        # an echo holds its value until the next command, while the straight line between commands moves on
        slack = ECHO_CRITERIA.slack_ticks + round(sample_interval_ticks(command.fresh)) - 1
        # in a gap of the recording it is not known what was sent, nor whether it was obeyed
        max_delay = round(ECHO_CRITERIA.max_delay_s / drive.dt_s)
        is_known = true_throughout(command.is_valid, max_delay + slack, slack)
        rows = np.flatnonzero(echo.fresh & drive.command_active[:, i] & is_known)
        values = echo.values[rows]
        has_changed = np.abs(np.diff(values, prepend=values[:1])) > rounding_tolerance(echo.values)
        if has_changed.sum() < ECHO_CRITERIA.min_changes:
            continue
        delays = np.arange(max_delay)
        delay = _find_delay(command.values, values[has_changed], rows[has_changed], delays)
        window = np.clip(rows[:, None] - delay + np.arange(-slack, slack + 1), 0, len(command.values) - 1)
        sent, tolerance = command.values[window], rounding_tolerance(values)
        is_unexplained = (values < sent.min(axis=1) - tolerance) | (values > sent.max(axis=1) + tolerance)
        echoes.append(CommandEcho(channel, delay * drive.dt_s, float(np.mean(is_unexplained)), len(rows)))
    return echoes


def _find_delay(command: Array, changed: Array, rows: Array, delays: Array) -> int:
    """The delay, ticks, at which the commands are closest to the changed echoes at `rows`."""
    errors = [float(np.mean(np.abs(command[rows - delay] - changed))) for delay in delays]
    return int(np.argmin(errors))
