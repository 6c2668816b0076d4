"""Records as rows of a flat buffer: one float for each field, in the order of the fields.

The only place that knows this order; tests/base/test_rows.py fails if a record gains a field that is missing here.
"""

from __future__ import annotations

from typing import Any

from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.maths import wrap_rad
from tunefree_hil.base.records import Ins, Report

REPORT_WIDTH, INS_WIDTH = len(Report._fields), len(Ins._fields)


@kernel
def pack_row(rows: Any, start: int, record: Any) -> int:
    """Write the floats of a record to rows[start], rows[start + 1] ...; returns the index behind the last one."""
    for i in range(len(record)):
        rows[start + i] = record[i]
    return start + len(record)


@kernel
def pack_report(rows: Any, start: int, x: Report) -> int:
    """Write a report, field by field: in a compiled loop faster than `pack_row`; returns the index behind it."""
    rows[start] = x.throttle_input_frac
    rows[start + 1] = x.throttle_command_frac
    rows[start + 2] = x.throttle_frac
    rows[start + 3] = x.brake_input_frac
    rows[start + 4] = x.brake_command_frac
    rows[start + 5] = x.brake_frac
    rows[start + 6] = x.steer_command_rad
    rows[start + 7] = x.steer_rad
    rows[start + 8] = x.speed_mps
    rows[start + 9] = x.wheel_fl_radps
    rows[start + 10] = x.wheel_fr_radps
    rows[start + 11] = x.wheel_rl_radps
    rows[start + 12] = x.wheel_rr_radps
    rows[start + 13] = x.accel_mps2
    rows[start + 14] = x.lateral_accel_mps2
    rows[start + 15] = x.yaw_rate_radps
    rows[start + 16] = x.gear
    rows[start + 17] = x.accel_command_mps2
    rows[start + 18] = x.steer_torque_command_nm
    rows[start + 19] = x.steer_torque_nm
    return start + 20


@kernel
def pack_ins(rows: Any, start: int, x: Ins) -> int:
    """Write an INS record, as `pack_report` does."""
    rows[start] = x.x_m
    rows[start + 1] = x.y_m
    rows[start + 2] = x.heading_rad
    rows[start + 3] = x.speed_mps
    rows[start + 4] = x.accel_mps2
    rows[start + 5] = x.yaw_rate_radps
    return start + 6


@kernel
def next_row(rows: Any, start: int, width: int) -> int:
    """Where the row behind the one at `start` begins, in a ring of rows."""
    start = start + width
    return 0 if start == len(rows) else start


@kernel
def _mix(rows: Any, older: int, newer: int, share: float) -> float:
    """`share` of the way from the newer of two numbers to the older."""
    value = float(rows[newer])
    return value + share * (float(rows[older]) - value)


@kernel
def interpolate_report(rows: Any, a: int, b: int, share: float) -> Report:
    """The report `share` of the way from the newer row at `b` to the older at `a`; of two gears the earlier one."""
    gear = float(rows[a + 16]) if share > 0.0 else float(rows[b + 16])
    return Report(
        throttle_input_frac=_mix(rows, a, b, share),
        throttle_command_frac=_mix(rows, a + 1, b + 1, share),
        throttle_frac=_mix(rows, a + 2, b + 2, share),
        brake_input_frac=_mix(rows, a + 3, b + 3, share),
        brake_command_frac=_mix(rows, a + 4, b + 4, share),
        brake_frac=_mix(rows, a + 5, b + 5, share),
        steer_command_rad=_mix(rows, a + 6, b + 6, share),
        steer_rad=_mix(rows, a + 7, b + 7, share),
        speed_mps=_mix(rows, a + 8, b + 8, share),
        wheel_fl_radps=_mix(rows, a + 9, b + 9, share),
        wheel_fr_radps=_mix(rows, a + 10, b + 10, share),
        wheel_rl_radps=_mix(rows, a + 11, b + 11, share),
        wheel_rr_radps=_mix(rows, a + 12, b + 12, share),
        accel_mps2=_mix(rows, a + 13, b + 13, share),
        lateral_accel_mps2=_mix(rows, a + 14, b + 14, share),
        yaw_rate_radps=_mix(rows, a + 15, b + 15, share),
        gear=gear,
        accel_command_mps2=_mix(rows, a + 17, b + 17, share),
        steer_torque_command_nm=_mix(rows, a + 18, b + 18, share),
        steer_torque_nm=_mix(rows, a + 19, b + 19, share),
    )


@kernel
def interpolate_ins(rows: Any, a: int, b: int, share: float) -> Ins:
    """The INS record `share` of the way from the newer row at `b` to the older at `a`; headings the short way round."""
    heading = float(rows[b + 2])
    if share > 0.0:
        heading = wrap_rad(heading + share * wrap_rad(float(rows[a + 2]) - heading))
    return Ins(
        x_m=_mix(rows, a, b, share),
        y_m=_mix(rows, a + 1, b + 1, share),
        heading_rad=heading,
        speed_mps=_mix(rows, a + 3, b + 3, share),
        accel_mps2=_mix(rows, a + 4, b + 4, share),
        yaw_rate_radps=_mix(rows, a + 5, b + 5, share),
    )
