"""Records that come late as a whole: delay lines for a Report and for an Ins, straight lines between two ticks.

A record that goes in at tick k is put out `delay_s` later. Before the first one the car rolled straight on as that one
says. A gear is nothing between two gears: of a delay with a part of a tick the earlier one counts.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from tunefree_hil.base.contracts import Block, Latency
from tunefree_hil.base.kernel import buffer, kernel
from tunefree_hil.base.maths import wrap_rad
from tunefree_hil.base.records import Ins, Report
from tunefree_hil.effects._signals import positive

REPORT_WIDTH, INS_WIDTH = len(Report()), len(Ins())
GEAR = Report._fields.index("gear")


class LineState(NamedTuple):
    """Rows of a record, one a tick; the place of the next one to go in, which is the oldest; the share of a tick that
    is left over from whole ticks; 0 until the first record has come.
    """

    rows: Any
    place: int
    share: float
    filled: int


def _init(width: int) -> Any:
    def init(params: Latency, dt_s: float) -> LineState:
        ticks = params.delay_s / dt_s
        whole = math.floor(ticks + 1e-9)
        share = ticks - whole if ticks - whole > 1e-9 else 0.0  # 0.07 / 0.01 is not quite 7
        return LineState(buffer((whole + 2) * width), 0, share, 0)

    return init


@kernel
def following(rows: Any, at: int, width: int) -> int:
    """Where the row behind the one at `at` begins."""
    at = at + width
    return 0 if at == len(rows) else at


@kernel
def between(rows: Any, older: int, newer: int, share: float) -> float:
    """`share` of the way from the newer of two numbers to the older."""
    new = float(rows[newer])
    return new + share * (float(rows[older]) - new)


@kernel
def step_report(params: Latency, state: LineState, x: Report, dt_s: float) -> tuple[LineState, Report]:
    """The report of `delay_s` ago."""
    rows, share = state.rows, state.share
    if state.filled == 0:
        for k in range(len(rows) // REPORT_WIDTH):
            for i in range(REPORT_WIDTH):
                rows[k * REPORT_WIDTH + i] = x[i]
    for i in range(REPORT_WIDTH):
        rows[state.place + i] = x[i]
    a = following(rows, state.place, REPORT_WIDTH)
    b = following(rows, a, REPORT_WIDTH)
    gear = float(rows[a + GEAR]) if share > 0.0 else float(rows[b + GEAR])
    late = Report(
        between(rows, a, b, share), between(rows, a + 1, b + 1, share), between(rows, a + 2, b + 2, share),
        between(rows, a + 3, b + 3, share), between(rows, a + 4, b + 4, share), between(rows, a + 5, b + 5, share),
        between(rows, a + 6, b + 6, share), between(rows, a + 7, b + 7, share), between(rows, a + 8, b + 8, share),
        between(rows, a + 9, b + 9, share), between(rows, a + 10, b + 10, share), between(rows, a + 11, b + 11, share),
        between(rows, a + 12, b + 12, share), between(rows, a + 13, b + 13, share),
        between(rows, a + 14, b + 14, share), between(rows, a + 15, b + 15, share), gear,
        between(rows, a + 17, b + 17, share), between(rows, a + 18, b + 18, share),
        between(rows, a + 19, b + 19, share),
    )  # fmt: skip
    return LineState(rows, a, share, 1), late


@kernel
def step_ins(params: Latency, state: LineState, x: Ins, dt_s: float) -> tuple[LineState, Ins]:
    """The INS record of `delay_s` ago; headings the short way round."""
    rows, share = state.rows, state.share
    if state.filled == 0:
        count = len(rows) // INS_WIDTH
        for k in range(count):
            back_m = (count - k) * dt_s * x.speed_mps
            for i in range(INS_WIDTH):
                rows[k * INS_WIDTH + i] = x[i]
            rows[k * INS_WIDTH] = x.x_m - back_m * math.cos(x.heading_rad)
            rows[k * INS_WIDTH + 1] = x.y_m - back_m * math.sin(x.heading_rad)
    for i in range(INS_WIDTH):
        rows[state.place + i] = x[i]
    a = following(rows, state.place, INS_WIDTH)
    b = following(rows, a, INS_WIDTH)
    heading = float(rows[b + 2])
    if share > 0.0:
        heading = wrap_rad(heading + share * wrap_rad(float(rows[a + 2]) - heading))
    late = Ins(
        between(rows, a, b, share), between(rows, a + 1, b + 1, share), heading, between(rows, a + 3, b + 3, share),
        between(rows, a + 4, b + 4, share), between(rows, a + 5, b + 5, share),
    )  # fmt: skip
    return LineState(rows, a, share, 1), late


def late_report(delay_s: float) -> Block:
    """Block on Report; delay_s = 0 is the identity."""
    return Block(_init(REPORT_WIDTH), step_report, Latency(positive("delay_s", delay_s)))


def late_ins(delay_s: float) -> Block:
    """Block on Ins; delay_s = 0 is the identity."""
    return Block(_init(INS_WIDTH), step_ins, Latency(positive("delay_s", delay_s)))
