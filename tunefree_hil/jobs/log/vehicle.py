"""Vehicle folder of an imported drive: the fields of the CSV, everything else absent, limits from the data."""

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
    """vehicle.toml as plain data; limits as given, or from the data."""
    periods = {name: _period_ms(drive, name) for name in drive.columns}
    state_ms = [] if drive.enabled is None else [_rounded_ms(drive.time_s[np.isfinite(drive.enabled)])]
    tick_ms = math.gcd(*periods.values(), *state_ms)
    table: dict[str, Any] = {
        "schema": "tunefree.vehicle/1",
        "name": spec.name,
        "dbc": ["vehicle.dbc"],
        "bitrate": 500_000,
        "tick_ms": 10 if tick_ms % 10 == 0 else tick_ms,
        "absent": _absent_fields(drive),
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


def _rounded_ms(times: np.ndarray, given_ms: int = 0) -> int:
    """Median time between two values, or the given one: rounded to 10 ms from 8 ms on, else to 1 ms, at least 1."""
    period_ms = given_ms or (1000.0 * float(np.median(np.diff(times))) if times.size > 1 else 100.0)
    return max(1, round(period_ms / 10.0) * 10 if period_ms >= 8.0 else round(period_ms))


def _absent_fields(drive: CsvDrive) -> list[str]:
    present = {name.partition(".")[::2] for name in drive.columns}
    wheels = any(field in WHEEL_FIELDS for _, field in present)
    return [
        f"{group}.{name}"
        for group in GROUPS
        for name in field_names(group)
        if (group, name) not in present and not (name == WHEELS and wheels)
    ]


def _limits(spec: ImportSpec, drive: CsvDrive) -> dict[str, Any]:
    """Limits from the mapping; else the largest values in the data, or default values, marked as assumed."""
    if spec.limits is not None:
        return plain(spec.limits)
    speed = _max_driven(drive, "speed_mps", 1.0)
    limits = {
        "steer_rad": _max_driven(drive, "steer_rad", 8.0),
        "steer_rate_radps": 8.0,
        "throttle_frac": 1.0,
        "brake_frac": 1.0,
        "speed_mps": speed,
    }
    return {**limits, "assumed": list(limits)}


def _max_driven(drive: CsvDrive, field: str, default: float) -> float:
    """Largest absolute value of a field in any group, rounded up to 0.1."""
    columns = [column.values[column.sent] for name, column in drive.columns.items() if name.endswith(f".{field}")]
    largest = max((float(np.abs(values).max()) for values in columns if values.size), default=0.0)
    return math.ceil(10.0 * largest) / 10.0 if largest > 0.0 else default
