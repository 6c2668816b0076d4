"""Readers of the three formats that an export writes, and Apollo's lookup in its table. Written from the formats."""

from __future__ import annotations

import bisect
from typing import Any

Fields = dict[str, list[Any]]


def read_text_proto(text: str) -> Fields:
    """Field -> its values in order; messages as fields again. Comments and empty lines are left out."""
    lines = [line.split("#")[0].strip() for line in text.splitlines()]
    fields, rest = _read_fields([line for line in lines if line])
    assert not rest, f"a brace too many before {rest[:2]}"
    return fields


def _read_fields(lines: list[str]) -> tuple[Fields, list[str]]:
    fields: Fields = {}
    while lines:
        line, lines = lines[0], lines[1:]
        if line == "}":
            return fields, lines
        if line.endswith("{"):
            value, lines = _read_fields(lines)
            fields.setdefault(line.removesuffix("{").strip(), []).append(value)
        else:
            name, _, text = line.partition(":")
            fields.setdefault(name, []).append(read_scalar(text.strip()))
    return fields, lines


def read_scalar(text: str) -> Any:
    """A flag, a number or a quoted text."""
    if text in ("true", "false"):
        return text == "true"
    return text[1:-1] if text.startswith('"') else float(text)


def read_yaml(text: str) -> dict[str, Any]:
    """The parameters of the node of a ROS 2 parameter file: nested mappings of scalars, two spaces a level."""
    root: dict[str, Any] = {}
    levels = [root]
    for line in text.splitlines():
        if not line or line.startswith("#"):
            continue
        depth = (len(line) - len(line.lstrip())) // 2
        name, _, value = line.strip().partition(":")
        del levels[depth + 1 :]
        if value:
            levels[depth][name] = read_scalar(value.strip())
        else:
            levels.append(levels[depth].setdefault(name, {}))
    return root["/**"]["ros__parameters"]


def read_csv(text: str) -> tuple[list[float], list[float], list[list[float]]]:
    """(speeds, pedals, accelerations by pedal and speed)."""
    head, *rows = [line.split(",") for line in text.splitlines()]
    numbers = [[float(one) for one in row] for row in rows]
    return [float(one) for one in head[1:]], [row[0] for row in numbers], [row[1:] for row in numbers]


class ApolloTable:
    """Apollo's lookup: speeds and accelerations sorted, clamped to the ends, linear in acceleration, then in speed."""

    def __init__(self, table: Fields) -> None:
        self.rows: dict[float, dict[float, float]] = {}
        for one in table["calibration"]:
            self.rows.setdefault(one["speed"][0], {})[one["acceleration"][0]] = one["command"][0]

    def command(self, speed_mps: float, accel_mps2: float) -> float:
        speeds = sorted(self.rows)
        low, high, share = bracket(speeds, speed_mps)
        first, second = (self._in_row(speed, accel_mps2) for speed in (low, high))
        return first + share * (second - first)

    def _in_row(self, speed_mps: float, accel_mps2: float) -> float:
        row = self.rows[speed_mps]
        low, high, share = bracket(sorted(row), accel_mps2)
        return row[low] + share * (row[high] - row[low])


def bracket(places: list[float], place: float) -> tuple[float, float, float]:
    """The places on both sides, and the share of the way between them."""
    if place <= places[0]:
        return places[0], places[0], 0.0
    if place >= places[-1]:
        return places[-1], places[-1], 0.0
    i = bisect.bisect_right(places, place) - 1
    return places[i], places[i + 1], (place - places[i]) / (places[i + 1] - places[i])
