"""Schema of a mapping file of `log import` ("tunefree.import/1"): which column of a CSV is which record field.

Every unit comes from a closed list; its factor to SI stands beside it, so that a swapped unit can be named.
"""

from __future__ import annotations

from typing import Literal

from msgspec import field

from tunefree_hil.base.records import GROUPS, WHEEL_FIELDS
from tunefree_hil.base.units import G_MPS2, KPH_PER_MPS, RAD_PER_DEG
from tunefree_hil.config.find import nearest
from tunefree_hil.config.problem import ConfigProblem, Problems
from tunefree_hil.config.vehicle_schema import LimitsSpec, NominalSpec, Spec

TURN_RAD = 360.0 * RAD_PER_DEG
# SI unit -> {unit: factor to it}; a field's SI unit is the end of its name
UNITS: dict[str, dict[str, float]] = {
    "mps": {"m/s": 1.0, "km/h": 1.0 / KPH_PER_MPS, "mph": 0.44704, "kn": 1852.0 / 3600.0},
    "mps2": {"m/s2": 1.0, "g": G_MPS2},
    "rad": {"rad": 1.0, "deg": RAD_PER_DEG},
    "radps": {"rad/s": 1.0, "deg/s": RAD_PER_DEG, "rpm": TURN_RAD / 60.0},
    "frac": {"1": 1.0, "%": 0.01},
    "m": {"m": 1.0, "mm": 0.001, "km": 1000.0, "ft": 0.3048},
    "nm": {"Nm": 1.0},
    "gear": {"1": 1.0},
}
Unit = Literal[
    "m/s",
    "km/h",
    "mph",
    "kn",
    "m/s2",
    "g",
    "rad",
    "deg",
    "rad/s",
    "deg/s",
    "rpm",
    "1",
    "%",
    "m",
    "mm",
    "km",
    "ft",
    "Nm",
]
CLOCK_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
CHECKS = (
    "speed_and_path",
    "yaw_rate_and_heading",
    "accel_and_speed",
    "heading_and_path",
    "steer_and_yaw_rate",
    "wheels_and_speed",
    "same_quantity",
    "range",
)
FIELDS = tuple(f"{group}.{name}" for group, record in GROUPS.items() for name in record._fields)


class ClockSpec(Spec, frozen=True, kw_only=True):
    """The time column. gap_s: shortest silence that counts as a gap; 0: three times the usual step."""

    column: str
    unit: Literal["s", "ms", "us", "ns"] = "s"
    gap_s: float = 0.0


class ColumnSpec(Spec, frozen=True, kw_only=True):
    """One column. SI value = (cell * scale + offset) in `unit`, so a sign or a gauge's gain goes into `scale`.

    period_ms: sent at most that often; 0: at every row. new_when: a column that changes where this one was measured
    anew; rows in between repeat the value and are not sent. gear codes are the project's (base/records.py).
    """

    column: str
    field: str  # "report.speed_mps"
    unit: Unit
    scale: float = 1.0
    offset: float = 0.0
    period_ms: int = 0
    new_when: str = ""
    assumed: str = ""


class EnabledSpec(Spec, frozen=True, kw_only=True):
    """The column that shows where the vehicle obeyed its commands: where the cell is `active`."""

    column: str
    active: float = 1.0


class ImportSpec(Spec, frozen=True, kw_only=True):
    """A mapping file. accept: plausibility checks that may fail, each with the reason why this drive is right."""

    schema: Literal["tunefree.import/1"]
    name: str
    source: str  # where the data are from, and their licence
    clock: ClockSpec
    columns: list[ColumnSpec]
    enabled: EnabledSpec | None = None
    delimiter: str = ","
    decimal: Literal[".", ","] = "."
    accept: dict[str, str] = field(default_factory=dict)
    limits: LimitsSpec | None = None
    nominal: NominalSpec = NominalSpec()
    path: str = ""
    hash: str = ""


def si_unit(name: str) -> str:
    """The SI unit of a record field by the end of its name: 'speed_mps' -> 'mps'."""
    return name.rpartition("_")[2] if name != "gear" else "gear"


def to_si(column: ColumnSpec) -> float:
    """The factor from the column's unit to SI."""
    return UNITS[si_unit(column.field.partition(".")[2])][column.unit]


def check_import(spec: ImportSpec) -> Problems:
    """Problems of a mapping file."""
    if len(spec.delimiter) != 1 or spec.delimiter in (spec.decimal, '"', "\n"):
        yield ConfigProblem("delimiter", f"{spec.delimiter!r} cannot part the cells", "one sign, such as , ; or a tab")
    if not spec.columns:
        yield ConfigProblem("columns", "no column is named", "add [[columns]] with column, field and unit")
    if spec.clock.gap_s < 0.0:
        yield ConfigProblem("clock.gap_s", "it is below 0", "give seconds, or leave it out")
    for name in spec.accept:
        if name not in CHECKS:
            yield ConfigProblem(f"accept.{name}", "no such check", nearest(name, CHECKS))
    seen: set[str] = set()
    for i, column in enumerate(spec.columns):
        key = f"columns[{i}]"
        if column.field in seen:
            yield ConfigProblem(f"{key}.field", f"{column.field} is filled twice", "remove one")
        seen.add(column.field)
        yield from _column(key, column)
    wheels = {f"report.{name}" for name in WHEEL_FIELDS}
    if seen & wheels and not wheels <= seen:
        yield ConfigProblem(
            "columns", f"of the four wheels {', '.join(sorted(wheels - seen))} is missing", "map all four, or none"
        )


def _column(key: str, column: ColumnSpec) -> Problems:
    if column.field not in FIELDS:
        yield ConfigProblem(f"{key}.field", f"no record field {column.field!r}", nearest(column.field, FIELDS))
        return
    units = UNITS[si_unit(column.field.partition(".")[2])]
    if column.unit not in units:
        yield ConfigProblem(f"{key}.unit", f"{column.unit} is no unit of {column.field}", f"one of {', '.join(units)}")
    if column.scale == 0.0:
        yield ConfigProblem(f"{key}.scale", "it is 0", "the cell is multiplied by it")
    if column.period_ms < 0:
        yield ConfigProblem(f"{key}.period_ms", "it is below 0", "give whole ms, or leave it out")
