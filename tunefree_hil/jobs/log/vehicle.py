"""The vehicle folder's table of an imported drive: its own fields, everything else absent, limits as driven."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from tunefree_hil.base.records import GROUPS, WHEEL_FIELDS
from tunefree_hil.bus.dbc.synthetic_dbc import ENABLED, STATE, WHEELS, message_name, signal_name
from tunefree_hil.config.check_vehicle import field_names
from tunefree_hil.config.dump import plain
from tunefree_hil.episode.csv_drive import CsvDrive

if TYPE_CHECKING:
    from tunefree_hil.config.import_schema import ImportSpec


def vehicle_table(spec: ImportSpec, drive: CsvDrive) -> dict[str, Any]:
    """vehicle.toml as plain data: each column's field, everything else absent, limits as given or as driven."""
    periods = {name: _period_ms(drive, name) for name in drive.columns}
    state_ms = [] if drive.enabled is None else [_rounded_ms(drive.time_s[np.isfinite(drive.enabled)])]
    tick_ms = math.gcd(*periods.values(), *state_ms)
    table: dict[str, Any] = {
        "schema": "tunefree.vehicle/1",
        "name": spec.name,
        "dbc": ["vehicle.dbc"],
        "bitrate": 500_000,
        "tick_ms": 10 if tick_ms % 10 == 0 else tick_ms,
        "absent": _absent(drive),
    }
    if any(name.partition(".")[2] in WHEEL_FIELDS for name in drive.columns):
        table["data_bitrate"] = 2_000_000  # the four wheels need a CAN FD frame
    for name, column in drive.columns.items():
        group, _, field = name.partition(".")
        wheel = field in WHEEL_FIELDS
        assumed = column.spec.assumed
        entry = {
            "message": message_name(name),
            "signal": [signal_name(f"{group}.{one}") for one in WHEEL_FIELDS] if wheel else signal_name(name),
            "period_ms": periods[name],
        } | ({"assumed": assumed} if assumed else {})
        table.setdefault(group, {})[WHEELS if wheel else field] = entry
    if state_ms:
        table["extra"] = {STATE: {"kind": "telemetry", "period_ms": state_ms[0]}}
        table["state"] = {"enabled": [{"message": STATE, "signal": ENABLED}]}
    return table | {"limits": _limits(spec, drive), "nominal": plain(spec.nominal)}


def _period_ms(drive: CsvDrive, name: str) -> int:
    column = drive.columns[name]
    return _rounded_ms(drive.time_s[column.sent], column.spec.period_ms)


def _rounded_ms(times: np.ndarray, said_ms: int = 0) -> int:
    """The usual time between two values, or what is said: tens of ms from 8 ms on, whole ms below, at least 1."""
    period_ms = said_ms or (1000.0 * float(np.median(np.diff(times))) if times.size > 1 else 100.0)
    return max(1, round(period_ms / 10.0) * 10 if period_ms >= 8.0 else round(period_ms))


def _absent(drive: CsvDrive) -> list[str]:
    there = {name.partition(".")[::2] for name in drive.columns}
    wheels = any(field in WHEEL_FIELDS for _, field in there)
    return [
        f"{group}.{name}"
        for group in GROUPS
        for name in field_names(group)
        if (group, name) not in there and not (name == WHEELS and wheels)
    ]


def _limits(spec: ImportSpec, drive: CsvDrive) -> dict[str, Any]:
    """As the mapping gives them; else the greatest values driven, or round figures, all said to be assumed."""
    if spec.limits is not None:
        return plain(spec.limits)
    speed = _most(drive, "speed_mps", 1.0)
    limits = {
        "steer_rad": _most(drive, "steer_rad", 8.0),
        "steer_rate_radps": 8.0,
        "throttle_frac": 1.0,
        "brake_frac": 1.0,
        "speed_mps": speed,
    }
    return {**limits, "assumed": list(limits)}


def _most(drive: CsvDrive, field: str, otherwise: float) -> float:
    """The greatest absolute value of a field in any group, rounded up to a tenth."""
    found = [column.values[column.sent] for name, column in drive.columns.items() if name.endswith(f".{field}")]
    most = max((float(np.abs(some).max()) for some in found if some.size), default=0.0)
    return math.ceil(10.0 * most) / 10.0 if most > 0.0 else otherwise
