"""A test drive made of one true motion, as text of a CSV: 20 s of curves and speed changes at 50 Hz."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from tunefree_hil.config.import_schema import UNITS, si_unit
from tunefree_hil.config.load import load_import

STEP_S, ROWS = 0.02, 1000
HEAD = 'schema = "tunefree.import/1"\nname = "made"\nsource = "made by a test"\n'
# column -> (record field, unit)
COLUMNS = {
    "v": ("report.speed_mps", "m/s"),
    "a": ("report.accel_mps2", "m/s2"),
    "r": ("report.yaw_rate_radps", "rad/s"),
    "x": ("ins.x_m", "m"),
    "y": ("ins.y_m", "m"),
    "psi": ("ins.heading_rad", "rad"),
    "thr": ("command.throttle_frac", "1"),
}


def motion() -> list[dict[str, float]]:
    """SI values by column, and the time 't'."""
    rows = []
    x = y = 0.0
    for k in range(ROWS):
        t = k * STEP_S
        v = 10.0 + 4.0 * math.sin(0.5 * t)
        psi = 1.2 * math.sin(0.4 * t)
        row = {"t": t, "v": v, "a": 2.0 * math.cos(0.5 * t), "r": 0.48 * math.cos(0.4 * t), "x": x, "y": y, "psi": psi}
        rows.append(row | {"thr": 0.3 + 0.1 * math.sin(t)})
        x += v * math.cos(psi) * STEP_S
        y += v * math.sin(psi) * STEP_S
    return rows


def in_units(rows: Sequence[Mapping[str, float]], units: Mapping[str, str]) -> list[dict[str, float]]:
    """The same drive with some columns in other units."""
    factors = {column: UNITS[si_unit(COLUMNS[column][0].partition(".")[2])][unit] for column, unit in units.items()}
    return [{name: value / factors.get(name, 1.0) for name, value in row.items()} for row in rows]


def write_csv(path: Path, rows: Sequence[Mapping[str, float | str]]) -> Path:
    """Rows as CSV; the keys of the first are the head."""
    names = list(rows[0])
    lines = [",".join(names), *(",".join(str(row[name]) for name in names) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_map(path: Path, said: Mapping[str, str] | None = None, columns: Sequence[str] = (), more: str = "") -> Path:
    """A mapping of these columns (default: all); `said`: units that the file claims, right or wrong."""
    chosen = {name: COLUMNS[name] for name in (columns or COLUMNS)}
    tables = [
        f'[[columns]]\ncolumn = "{name}"\nfield = "{field}"\nunit = "{(said or {}).get(name, unit)}"\n'
        for name, (field, unit) in chosen.items()
    ]
    path.write_text(HEAD + more + '[clock]\ncolumn = "t"\n' + "".join(tables), encoding="utf-8")
    load_import(path)
    return path
