"""Check a log of CAN frames: counts, rates, gaps, counters, CRCs, frames that do not decode, foreign frames."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from tunefree_hil.base.events import Event
from tunefree_hil.jobs.log.files import codec_for_log, describe_cut, has_vehicle_channels, open_log
from tunefree_hil.jobs.log.options import LogCheckOptions

if TYPE_CHECKING:
    from tunefree_hil.bus.dbc.codec import Codec

HEAD = f"{'message':<24}{'id':>11}{'frames':>8}{'Hz':>8}{'nominal':>8}{'gap ms':>8}"
HEAD += f"{'late':>6}{'lost':>6}{'short':>7}{'crc':>5}"


def check(options: LogCheckOptions) -> Iterator[Event]:
    """One line a message on stdout, then the faults. Exit 1 on a fault.

    Columns: measured and nominal rate, longest gap, gaps above 1.5 periods, frames lost by their counter, frames
    shorter than in the DBC, frames with a wrong CRC ('-': the vehicle folder names no CRC profile).
    """
    from tunefree_hil.bus.recording.log_check import check_frames

    codec, where = codec_for_log(options.path, options.vehicle)
    yield Event("note", f"{options.path}, read as {where}")
    log = open_log(options.path)
    health = check_frames(log.frames(), codec, has_vehicle_channels(log.frames(), codec))
    yield Event("line", HEAD)
    for row in health.messages:
        yield Event("line", _row(row, codec))
    for can_id, count in health.foreign.items():
        yield Event("line", f"{'(not in the DBC)':<24}{can_id & 0x1FFFFFFF:>#11x}{count:>8}")
    problems = ([describe_cut(log)] if log.cut_line else []) + health.problems
    for problem in problems:
        yield Event("line", f"fault: {problem}")
    faults = f"{len(problems)} faults" if len(problems) != 1 else "1 fault"
    sentence = f"{health.frames} frames in {health.span_s:.2f} s: " + (faults if problems else "no faults")
    data = {"messages": health.messages, "foreign": health.foreign, "problems": problems, "vehicle": where}
    yield Event("result", "", {**data, "frames": health.frames, "sentence": sentence, "exit": 1 if problems else 0})


def _row(row: Any, codec: Codec) -> str:
    wanted_hz = 1000.0 / row.period_ms
    gap = f"{1000.0 * row.longest_gap_s:8.1f}" if row.frames > 1 else f"{'-':>8}"
    rate = f"{row.rate_hz:8.1f}" if row.frames > 1 else f"{'-':>8}"
    broken = "-" if row.broken is None else row.broken
    counts = f"{row.late:>6}{row.lost:>6}{row.short:>7}{broken:>5}"
    can_id = codec.by_name[row.name].can_id
    return f"{row.name:<24}{can_id:>#11x}{row.frames:>8}{rate}{wanted_hz:8.1f}{gap}{counts}"
