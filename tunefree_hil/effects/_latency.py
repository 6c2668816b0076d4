"""Delay lines for whole records (Report, Ins), with linear interpolation between two ticks.

Before the first record the car rolled straight with the values of that record. A gear is not interpolated: for a delay
with a fraction of a tick the earlier gear is used.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Block, Latency
from tunefree_hil.base.kernel import buffer, kernel
from tunefree_hil.base.records import Ins, Report
from tunefree_hil.base.rows import (
    INS_WIDTH,
    REPORT_WIDTH,
    interpolate_ins,
    interpolate_report,
    next_row,
    pack_ins,
    pack_report,
)
from tunefree_hil.effects._signals import positive


class DelayLineState(NamedTuple):
    """A delay line.

    Args:
        rows: a ring of records, one a tick.
        place: where the next record goes in, which is where the oldest is.
        share: fraction of a tick in the delay.
        filled: 0 until the first record has come, then 1.
    """

    rows: Any
    place: int
    share: float
    filled: int


def _init(width: int) -> Any:
    def init(params: Latency, dt_s: float) -> DelayLineState:
        ticks = params.delay_s / dt_s
        whole = math.floor(ticks + 1e-9)
        share = ticks - whole if ticks - whole > 1e-9 else 0.0  # 0.07 / 0.01 is not exactly 7
        return DelayLineState(buffer((whole + 2) * width), 0, share, 0)

    return init


@kernel
def step_report(params: Latency, state: DelayLineState, x: Report, dt_s: float) -> tuple[DelayLineState, Report]:
    """The report of `delay_s` ago."""
    rows, share = state.rows, state.share
    if state.filled == 0:
        for k in range(len(rows) // REPORT_WIDTH):
            pack_report(rows, k * REPORT_WIDTH, x)
    pack_report(rows, state.place, x)
    older = next_row(rows, state.place, REPORT_WIDTH)
    newer = next_row(rows, older, REPORT_WIDTH)
    return DelayLineState(rows, older, share, 1), interpolate_report(rows, older, newer, share)


@kernel
def step_ins(params: Latency, state: DelayLineState, x: Ins, dt_s: float) -> tuple[DelayLineState, Ins]:
    """The INS record of `delay_s` ago; headings the short way round."""
    rows, share = state.rows, state.share
    if state.filled == 0:
        count = len(rows) // INS_WIDTH
        for k in range(count):
            back_m = (count - k) * dt_s * x.speed_mps
            x_m = x.x_m - back_m * math.cos(x.heading_rad)
            y_m = x.y_m - back_m * math.sin(x.heading_rad)
            pack_ins(rows, k * INS_WIDTH, Ins(x_m, y_m, x.heading_rad, x.speed_mps, x.accel_mps2, x.yaw_rate_radps))
    pack_ins(rows, state.place, x)
    older = next_row(rows, state.place, INS_WIDTH)
    newer = next_row(rows, older, INS_WIDTH)
    return DelayLineState(rows, older, share, 1), interpolate_ins(rows, older, newer, share)


def late_report(delay_s: float) -> Block:
    """Block on Report; delay_s = 0 is the identity."""
    return Block(_init(REPORT_WIDTH), step_report, Latency(positive("delay_s", delay_s)))


def late_ins(delay_s: float) -> Block:
    """Block on Ins; delay_s = 0 is the identity."""
    return Block(_init(INS_WIDTH), step_ins, Latency(positive("delay_s", delay_s)))
