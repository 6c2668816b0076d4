"""A frame of every kind, and formats with what they say they lose."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.bus.formats.rows import BRS, ERROR, ESI, EXTENDED_BIT, FD, RTR, SENT, Format, Lost, Row, survey

SUFFIX = {"blf": ".blf", "asc": ".asc", "csv": ".csv", "mf4": ".mf4", "ros1": ".bag", "ros2": ".ros2"}
ROWS = (
    Row(0.0, "can0", 0x123, b"\x01\x02"),
    Row(0.010001, "can0", 0x123 | EXTENDED_BIT, b"", SENT),
    Row(0.02, "can1", 0x7FF, bytes(range(64)), FD | BRS | ESI),
    Row(0.021, "can1", 0x7FE, b"", FD),
    Row(0.03, "can128", 0x11, b"", RTR, 4),
    Row(0.031, "can0", 0x1FFFFFFE | EXTENDED_BIT, b"", RTR | SENT),
    Row(0.04, "can0", 0x44, bytes(8), ERROR),
    Row(0.05, "can0", 0x1FFFFFFF | EXTENDED_BIT, bytes(range(8))),
    Row(0.05, "can0", 5, bytes(12), FD | SENT),
)


def shifted(base_s: float, rows: tuple[Row, ...] | list[Row] = ROWS) -> list[Row]:
    return [row._replace(time_s=round(row.time_s + base_s, 6)) for row in rows]


class Held(NamedTuple):
    """What a format keeps of rows, and what it says of the rest."""

    rows: list[Row]
    losses: dict[str, int]


def hold(form: Format, rows: Sequence[Row]) -> Held:
    lost = Lost()
    kept = list(form.hold(rows, survey(rows), lost))
    return Held(kept, dict(lost))


def write(form: Format, path: Path, rows: Sequence[Row]) -> None:
    form.write(path, rows, survey(rows))
