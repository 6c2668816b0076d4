"""Delay of the by-wire unit's status bits when an effect delays the report frames: they travel in the same frames.

The delay of the measurement is the effect's own (effects/_latency.py). A bit has no value between two ticks, so a
fraction of a tick counts as a whole tick.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Latency, Port
from tunefree_hil.base.kernel import Block, buffer, kernel
from tunefree_hil.base.rows import next_row, pack_row
from tunefree_hil.plant.actuation.bywire_types import ByWireStatus, ChannelStatus
from tunefree_hil.plant.ports import Effects

CHANNEL_WIDTH = len(ChannelStatus._fields)
STATUS_WIDTH = 3 * CHANNEL_WIDTH + len(ByWireStatus._fields) - 3


class StatusDelayState(NamedTuple):
    """A ring of status rows, one a tick, and where the oldest begins."""

    rows: Any
    oldest: int


def report_latency(effects: Effects) -> tuple[bool, float]:
    """Whether there are effects that delay the reports, and their total delay, s."""
    blocks = [block for port, block in effects if port is Port.REPORT and isinstance(block, Block)]
    delays = [block.params.delay_s for block in blocks if isinstance(block.params, Latency)]
    return bool(delays), sum(delays)


def init_status_delay(delay_s: float, dt_s: float) -> StatusDelayState:
    """The state before tick 0: every bit is 0, as in ByWireStatus()."""
    ticks = math.ceil(delay_s / dt_s - 1e-9)
    return StatusDelayState(buffer((ticks + 1) * STATUS_WIDTH), 0)


@kernel
def pack_status(rows: Any, start: int, status: ByWireStatus) -> int:
    """Write a status to the row that begins at `start`; returns the index behind it."""
    i = pack_row(rows, start, status.throttle)
    i = pack_row(rows, i, status.brake)
    i = pack_row(rows, i, status.steer)
    rows[i] = status.gear_override
    rows[i + 1] = status.watchdog_braking
    rows[i + 2] = status.watchdog_cause
    rows[i + 3] = status.light_input
    rows[i + 4] = status.light_command
    rows[i + 5] = status.light_output
    rows[i + 6] = status.gear_wish
    rows[i + 7] = status.gear_reject
    return i + 8


@kernel
def unpack_channel(rows: Any, i: int) -> ChannelStatus:
    """The bits of a channel that begin at `i`."""
    return ChannelStatus(
        enabled=float(rows[i]),
        override=float(rows[i + 1]),
        driver=float(rows[i + 2]),
        timeout=float(rows[i + 3]),
        counter_fault=float(rows[i + 4]),
        e2e=float(rows[i + 5]),
    )


@kernel
def unpack_status(rows: Any, start: int) -> ByWireStatus:
    """The status in the row that begins at `start`."""
    i = start + 3 * CHANNEL_WIDTH
    return ByWireStatus(
        throttle=unpack_channel(rows, start),
        brake=unpack_channel(rows, start + CHANNEL_WIDTH),
        steer=unpack_channel(rows, start + 2 * CHANNEL_WIDTH),
        gear_override=float(rows[i]),
        watchdog_braking=float(rows[i + 1]),
        watchdog_cause=float(rows[i + 2]),
        light_input=float(rows[i + 3]),
        light_command=float(rows[i + 4]),
        light_output=float(rows[i + 5]),
        gear_wish=float(rows[i + 6]),
        gear_reject=float(rows[i + 7]),
    )


@kernel
def delay_status(state: StatusDelayState, status: ByWireStatus) -> tuple[StatusDelayState, ByWireStatus]:
    """Put in the status of this tick; returns the oldest one in the ring."""
    pack_status(state.rows, state.oldest, status)
    oldest = next_row(state.rows, state.oldest, STATUS_WIDTH)
    return StatusDelayState(state.rows, oldest), unpack_status(state.rows, oldest)


def delay_with_status(delay_step: Callable[..., Any], make_reports: Callable[..., Any]) -> Callable[..., Any]:
    """The step of a report delay whose status bits are delayed by StatusDelayState as well.

    Args:
        delay_step: the step of the delay.
        make_reports: the record of measurement and status that is delayed.

    Returns:
        The step; its state is (StatusDelayState, the delay's own state).
    """

    @kernel
    def step(params: Any, state: Any, x: Any, dt_s: float) -> tuple[Any, Any]:
        status_state, status = delay_status(state[0], x.status)
        delay_state, reports = delay_step(params, state[1], make_reports(x.measurement, status), dt_s)
        return (status_state, delay_state), reports

    return step
