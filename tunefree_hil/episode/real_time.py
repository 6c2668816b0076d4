"""Converts the time stamps of a log to ticks: in virtual time, and in real time with the log of the bench
(docs/reference/bench_channel.md)."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.bench_channel import Role, State, Status, decode
from tunefree_hil.episode.candump import read_rows

MOST_STEP_S = 600.0  # between two frames; with more it is not a recording of ticks
CUT_THERE = "cut the log in two there: each piece is a recording of its own"
ON_GRID = 1e-3  # of a tick: stamps nearer than this to whole ticks are virtual time


class Times(NamedTuple):
    """zero_s: stamp of tick 0; late_ticks: by how many ticks a report is used after its stamp; words: as text.
    by_frame: tick 0 is unknown, and the first frame is taken for it.
    """

    zero_s: float
    late_ticks: int
    words: str
    by_frame: bool = False


def times_of(off_grid: float, first_s: float, earliest_s: float, dt_s: float, folder: Path) -> Times:
    """Virtual time where all stamps are whole ticks from 0 on; else real time, from bench.log or the first frame.

    off_grid: the furthest of any stamp from a whole tick, as a share of a tick. first_s, earliest_s: the log's first
    stamp, and the least. folder: of the log, which may contain that of the bench.
    """
    if off_grid < ON_GRID and first_s < dt_s:
        return Times(0.0, 0, "virtual time")
    if (folder / "bench.log").is_file():
        return Times(run_zero_s(folder / "bench.log"), 1, "real time: tick 0 is where bench.log says")
    return Times(earliest_s, 1, f"real time: second 0 is the log's first frame, at {earliest_s:.3f} s", True)


def clock_jump(step_s: float, at_s: float, direction: str, file: Path, hint: str = CUT_THERE) -> InputError:
    """The error for a log whose clock jumps `way` ("back" or "ahead") by more than MOST_STEP_S at one frame."""
    message = f"the clock jumps {direction} by {step_s:.6g} s at stamp {at_s:.6f}"
    return InputError(message, code="clock_jump", file=str(file), hint=hint)


def run_zero_s(bench_log: Path) -> float:
    """Stamp of tick 0 in s: that of the runner's first RUN plus its lead.

    Reading stops at that RUN, so a cut-off log is sufficient. Raises InputError for a log that is
    missing, empty or foreign, or without a RUN.
    """
    for row in read_rows(bench_log, allow_cut=True):
        message = decode(CanFrame(row.can_id, row.data))
        if isinstance(message, Status) and (message.role, message.state) == (Role.RUNNER, State.RUN):
            return row.time_s + message.tick * 1e-3
    raise InputError(
        "holds no RUN: the drive beside it never began",
        code="no_run",
        file=str(bench_log),
        hint="leave this episode out",
    )
