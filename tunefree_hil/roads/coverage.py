"""What roads ask for, by speed, and which roads ask for more than those that were searched."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.course import Course
from tunefree_hil.episode.feasible import curvature_by_time


class CoverageCriteria(NamedTuple):
    """When a road counts as beyond what was searched. Less is within what a controller's gains carry over."""

    cell_mps: float = 5.0  # m/s, width of a cell of speed; gains change little within it
    min_speed_excess_mps: float = 1.0  # m/s beyond the fastest, or below the slowest, that was searched
    min_accel_excess_mps2: float = 0.3  # m/s2, of both accelerations, beyond those of the cell and its neighbours


CRITERIA = CoverageCriteria()


class DrivenQuantity(Enum):
    """A quantity of the searched envelope; the value is its name in a message."""

    SPEED = "speed"
    LATERAL_ACCEL = "lateral acceleration"
    ACCEL = "acceleration"
    DECEL = "deceleration"


class SpeedCell(NamedTuple):
    """The greatest accelerations in a cell of speed, all positive."""

    lateral_accel_mps2: float
    accel_mps2: float
    decel_mps2: float


class DrivenEnvelope(NamedTuple):
    """What a set of roads asks for.

    Attributes:
        cells: Greatest accelerations by the number of the cell of speed (speed over cell_mps, rounded down).
    """

    speed_low_mps: float
    speed_high_mps: float
    cells: Mapping[int, SpeedCell]


class RoadBeyond(NamedTuple):
    """A road that asks for more of a quantity than the searched ones, at its worst point."""

    road: str
    quantity: DrivenQuantity
    value: float
    limit: float
    speed_mps: float


def envelope(courses: Iterable[Course]) -> DrivenEnvelope:
    """What the courses ask for together. Raises ValueError where there is none."""
    lows, highs, cells = [], [], dict[int, SpeedCell]()
    for course in courses:
        speed = np.asarray(course.speed_mps)
        lows.append(float(speed.min()))
        highs.append(float(speed.max()))
        for number, cell in _cells(course).items():
            known = cells.get(number, SpeedCell(0.0, 0.0, 0.0))
            cells[number] = SpeedCell(*map(max, known, cell))
    if not lows:
        raise ValueError("an envelope needs a course")
    return DrivenEnvelope(min(lows), max(highs), cells)


def outside(searched: DrivenEnvelope, verified: Mapping[str, Course]) -> list[RoadBeyond]:
    """The roads to be verified that ask for more than the searched ones, by name and quantity."""
    return [record for name, course in verified.items() for record in _beyond(searched, name, course)]


def outside_text(record: RoadBeyond) -> str:
    """The warning."""
    unit = "m/s" if record.quantity is DrivenQuantity.SPEED else "m/s2"
    at_speed = "" if record.quantity is DrivenQuantity.SPEED else f" near {record.speed_mps:.0f} m/s"
    return (
        f"{record.road} is to be verified, and lies outside the searched envelope: {record.quantity.value} "
        f"{record.value:.1f} {unit}{at_speed}, searched to {record.limit:.1f} {unit}"
    )


def _cells(course: Course) -> dict[int, SpeedCell]:
    speed, accel = np.asarray(course.speed_mps), np.asarray(course.accel_mps2)
    lateral = np.abs(speed * speed * curvature_by_time(course))
    numbers = np.floor(speed / CRITERIA.cell_mps).astype(int)
    return {
        int(number): SpeedCell(
            float(lateral[numbers == number].max()),
            float(max(accel[numbers == number].max(), 0.0)),
            float(max(-accel[numbers == number].min(), 0.0)),
        )
        for number in np.unique(numbers)
    }


def _beyond(searched: DrivenEnvelope, name: str, course: Course) -> list[RoadBeyond]:
    speed = np.asarray(course.speed_mps)
    low, high = float(speed.min()), float(speed.max())
    records = []
    if high > searched.speed_high_mps + CRITERIA.min_speed_excess_mps:
        records.append(RoadBeyond(name, DrivenQuantity.SPEED, high, searched.speed_high_mps, high))
    if low < searched.speed_low_mps - CRITERIA.min_speed_excess_mps:
        records.append(RoadBeyond(name, DrivenQuantity.SPEED, low, searched.speed_low_mps, low))
    quantities = (DrivenQuantity.LATERAL_ACCEL, DrivenQuantity.ACCEL, DrivenQuantity.DECEL)
    cells = _cells(course)
    for index, quantity in enumerate(quantities):
        excesses = [
            RoadBeyond(name, quantity, cell[index], limit, (number + 0.5) * CRITERIA.cell_mps)
            for number, cell in cells.items()
            if cell[index] > (limit := _searched_most(searched, number, index)) + CRITERIA.min_accel_excess_mps2
        ]
        records += sorted(excesses, key=lambda record: record.limit - record.value)[:1]
    return records


def _searched_most(searched: DrivenEnvelope, number: int, index: int) -> float:
    """The greatest value in the cell and its two neighbours."""
    near = [searched.cells[cell][index] for cell in (number - 1, number, number + 1) if cell in searched.cells]
    return max(near, default=0.0)
