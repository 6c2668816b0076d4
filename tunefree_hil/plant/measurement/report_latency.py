"""Frames that are late as a whole: what they say beside the measurement is as late (interfaces 4, report_latency).

The measurement's own delay is the effect's (a Block on Report); here are the status bits of the by-wire unit, which
travel in the same frames. Between two ticks a bit is what it was: a part of a tick counts as a whole one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Latency, Port
from tunefree_hil.base.kernel import Block, buffer, kernel
from tunefree_hil.plant.actuation.bywire_types import ByWireStatus, ChannelStatus
from tunefree_hil.plant.ports import Effects

BITS, OTHERS = 6, 8  # of a channel; of the status beside the three channels
WIDTH = 3 * BITS + OTHERS


class LateState(NamedTuple):
    """Rows of WIDTH numbers, one a tick, and the place of the oldest."""

    rows: Any
    oldest: int


def latency_of(effects: Effects) -> tuple[bool, float]:
    """(whether there are effects that make the reports late, by how much in s all together)."""
    blocks = [made for port, made in effects if port is Port.REPORT and isinstance(made, Block)]
    delays = [block.params.delay_s for block in blocks if isinstance(block.params, Latency)]
    return bool(delays), sum(delays)


def init_late(delay_s: float, dt_s: float) -> LateState:
    """Nothing has been said before tick 0: every bit is 0, as in ByWireStatus()."""
    ticks = math.ceil(delay_s / dt_s - 1e-9)
    return LateState(buffer((ticks + 1) * WIDTH), 0)


@kernel
def channel_at(rows: Any, at: int) -> ChannelStatus:
    """A channel's bits."""
    return ChannelStatus(
        float(rows[at]), float(rows[at + 1]), float(rows[at + 2]), float(rows[at + 3]), float(rows[at + 4]),
        float(rows[at + 5]),
    )  # fmt: skip


@kernel
def step_late(state: LateState, x: ByWireStatus) -> tuple[LateState, ByWireStatus]:
    """The status of as many ticks ago as there are rows, less one."""
    rows, at = state.rows, state.oldest
    for i in range(BITS):
        rows[at + i] = x.throttle[i]
        rows[at + BITS + i] = x.brake[i]
        rows[at + 2 * BITS + i] = x.steer[i]
    last = at + 3 * BITS
    rows[last] = x.gear_override
    rows[last + 1] = x.watchdog_braking
    rows[last + 2] = x.watchdog_cause
    rows[last + 3] = x.light_input
    rows[last + 4] = x.light_command
    rows[last + 5] = x.light_output
    rows[last + 6] = x.gear_wish
    rows[last + 7] = x.gear_reject
    at = at + WIDTH
    if at == len(rows):
        at = 0
    last = at + 3 * BITS
    status = ByWireStatus(
        channel_at(rows, at), channel_at(rows, at + BITS), channel_at(rows, at + 2 * BITS), float(rows[last]),
        float(rows[last + 1]), float(rows[last + 2]), float(rows[last + 3]), float(rows[last + 4]),
        float(rows[last + 5]), float(rows[last + 6]), float(rows[last + 7]),
    )  # fmt: skip
    return LateState(rows, at), status


def with_late_status(delay_step: Callable[..., Any], said: Callable[..., Any]) -> Callable[..., Any]:
    """The step of a delay of what is `said` (a record of measurement and status), the status late before it.

    Its state is (LateState, the delay's own).
    """

    @kernel
    def step(params: Any, state: Any, x: Any, dt_s: float) -> tuple[Any, Any]:
        late, status = step_late(state[0], x.status)
        reports, now = delay_step(params, state[1], said(x.measurement, status), dt_s)
        return (late, reports), now

    return step
