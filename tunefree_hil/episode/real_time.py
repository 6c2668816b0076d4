"""Where the ticks of a real-time drive begin, as the bench said beside the vehicle's log (interfaces 8)."""

from __future__ import annotations

from pathlib import Path

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.bench_channel import Role, State, Status, decode
from tunefree_hil.episode.candump import read_rows


def run_zero_s(bench_log: Path) -> float:
    """Stamp of tick 0 in s: that of the runner's first RUN plus the lead that it carries.

    Read no further than to that RUN, so that a log which was cut off will do. Raises InputError for a log that is
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
