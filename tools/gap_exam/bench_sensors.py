"""Sensors of a car of the exam on a bench: scales, biases, filters and delays on what its frames say.

Steps of one tick on records with the fields of docs/reference/files.md (report.*, ins.*), by name alone: nothing of
the bench's
package is imported. `sensors.py` of the model folder (bench_folder.py) puts them where a bench has its effects. A delay
takes straight lines between ticks, where the exam's own logs take them between milliseconds.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

from tools.gap_exam.files import read_json
from tools.gap_exam.hidden import NOTHING, Hidden, hidden_of
from tools.gap_exam.seal import unseal

SPEEDS = ("speed_mps", "wheel_fl_radps", "wheel_fr_radps", "wheel_rl_radps", "wheel_rr_radps")
IN_STEPS = ("gear",)  # has no value between two
ANGLES = ("heading_rad",)


class Past(NamedTuple):
    """What a port remembers: records as they were, the newest first, and the filtered yaw rate (NaN: none yet)."""

    records: tuple[Any, ...] = ()
    yaw_radps: float = math.nan


def hidden_in(path: Path) -> Hidden:
    """What a model folder's hidden.json holds under seal."""
    effects = unseal(read_json(path))["effects"]
    return hidden_of(effects) if effects else NOTHING


def report_step(h: Hidden, past: Past, x: Any, dt_s: float) -> tuple[Past, Any]:
    """The chassis reports of one tick: filtered, late as a whole, then scaled and biased."""
    yaw = x.yaw_rate_radps
    if h.yaw_rate_filter > 0.0 and math.isfinite(past.yaw_radps):
        yaw = yaw + (past.yaw_radps - yaw) * math.exp(-dt_s / h.yaw_rate_filter)
    records, said = late(past.records, x._replace(yaw_rate_radps=yaw), h.report_latency, dt_s)
    changed = {name: h.speed_scale * getattr(said, name) for name in SPEEDS}
    changed["yaw_rate_radps"] = h.yaw_rate_scale * said.yaw_rate_radps + h.yaw_rate_bias
    changed["accel_mps2"] = said.accel_mps2 + h.accel_bias
    changed["steer_rad"] = said.steer_rad + h.steer_report_offset
    return Past(records, yaw), said._replace(**changed)


def ins_step(h: Hidden, past: Past, x: Any, dt_s: float) -> tuple[Past, Any]:
    """The INS record of one tick."""
    records, said = late(past.records, x, h.ins_latency, dt_s)
    return Past(records), said


def late(records: tuple[Any, ...], x: Any, delay_s: float, dt_s: float) -> tuple[tuple[Any, ...], Any]:
    """(records to remember, the record as it was delay_s ago); the first one for as long as nothing is that old."""
    if delay_s <= 0.0:
        return (), x
    ticks = delay_s / dt_s
    whole = math.floor(ticks)
    records = (x, *records)[: whole + 2]
    newer = records[min(whole, len(records) - 1)]
    older = records[min(whole + 1, len(records) - 1)]
    return records, type(x)(*(_between(name, newer, older, ticks - whole) for name in x._fields))


def _between(name: str, newer: Any, older: Any, share: float) -> float:
    new, old = getattr(newer, name), getattr(older, name)
    if name in IN_STEPS:
        return new
    away = old - new
    if name in ANGLES:
        away = math.remainder(away, 2.0 * math.pi)
        return math.remainder(new + share * away, 2.0 * math.pi)
    return new + share * away
