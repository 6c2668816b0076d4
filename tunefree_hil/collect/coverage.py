"""How far a collection has come: frames by cell, as numbers, as a map in text, as plain data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tunefree_hil.collect import features
from tunefree_hil.collect.cells import (
    LEAST_RUN,
    PEDALS,
    REVERSE_MPS,
    SPEEDS,
    STEERS,
    Counter,
    Place,
    Target,
    bands_of,
    needs_of,
    number_of,
)
from tunefree_hil.collect.envelope import envelope_of
from tunefree_hil.config.schema import VehicleSpec

SCHEMA = "tunefree.coverage/1"
SHORT = ("shrp L", "turn L", "brch L", "strait", "brch R", "turn R", "shrp R")  # left is to the left


class Coverage:
    """Counts of a vehicle's cells against a quota."""

    def __init__(self, vehicle: VehicleSpec, targets: Sequence[Target], quota_s: float, dt_s: float) -> None:
        self.vehicle = vehicle
        self.targets = tuple(targets)
        self.quota_s = quota_s
        self.dt_s = dt_s
        self.bands = bands_of(envelope_of(vehicle))
        self.counter = Counter(needs_of(targets, quota_s, dt_s))

    def add(self, get: Callable[[str], np.ndarray | None]) -> None:
        """Count a recording whose fields `get` gives by name."""
        features.count(get, self.bands, self.counter)

    @property
    def wanted(self) -> int:
        """Cells that are asked for."""
        return sum(need > 0 for need in self.counter.need)

    @property
    def full(self) -> int:
        """Cells that are full."""
        return self.wanted - self.counter.missing

    @property
    def had_s(self) -> float:
        """Seconds that count towards a quota."""
        pairs = zip(self.counter.have, self.counter.need, strict=True)
        return sum(min(have, need) for have, need in pairs) * self.dt_s

    @property
    def needed_s(self) -> float:
        """Seconds of all quotas together."""
        return sum(self.counter.need) * self.dt_s

    def have_s(self, number: int) -> float:
        """Seconds in a cell."""
        return self.counter.have[number] * self.dt_s

    def missing(self) -> list[str]:
        """Names of the cells that are not full."""
        return [self.name(i) for i in range(len(self.targets)) if self.counter.lacks(i)]

    def name(self, number: int) -> str:
        """A cell in words."""
        place = self.targets[number].place
        gear = "reverse, " if place.backwards else ""
        return f"{gear}{STEERS[place.steer]}, {self.speed_words(place)}, {PEDALS[place.pedal]}"

    def band_words(self, place: Place) -> str:
        """A speed band in words, with the gear where it is not drive."""
        return self.speed_words(place) + (" backwards" if place.backwards else "")

    def speed_words(self, place: Place) -> str:
        """A speed band in words."""
        if place.backwards:
            return f"to {REVERSE_MPS:g} m/s"
        edges = self.bands.speed_mps
        if place.speed + 1 == SPEEDS:
            return f"from {edges[-1]:.3g} m/s"
        return f"{edges[place.speed]:.3g}-{edges[place.speed + 1]:.3g} m/s"

    def as_dict(self) -> dict[str, Any]:
        """coverage.json."""
        return {
            "schema": SCHEMA,
            "vehicle": self.vehicle.name,
            "vehicle_hash": self.vehicle.hash,
            "quota_s": self.quota_s,
            "least_run_frames": LEAST_RUN,
            "cells_full": self.full,
            "cells_wanted": self.wanted,
            "bands": self.bands._asdict(),
            "cells": [self._cell(number) for number in range(len(self.targets))],
        }

    def _cell(self, number: int) -> dict[str, Any]:
        target = self.targets[number]
        place = target.place
        return {
            "gear": "reverse" if place.backwards else "drive",
            "steer": STEERS[place.steer],
            "speed": self.speed_words(place),
            "pedal": PEDALS[place.pedal],
            "have_s": round(self.have_s(number), 3),
            "need_s": round(self.counter.need[number] * self.dt_s, 3),
            "excluded": target.excluded,
        }


def map_lines(coverage: Coverage) -> list[str]:
    """The map for a terminal of 80 columns: have/need in seconds by cell, '-' where a cell is not asked for."""
    lines = [f"seconds had of {coverage.quota_s:g} wanted by cell (- is not asked for, see coverage.json)"]
    lines.append(" " * 22 + "".join(f"{name:>8}" for name in SHORT))
    for group in groups(coverage):
        lines.append(coverage.band_words(group[0]))
        for first in group:
            row = [number_of(first._replace(steer=steer)) for steer in reversed(range(len(STEERS)))]
            cells = "".join(f"{_have_of_need(coverage, number):>8}" for number in row)
            lines.append(f"  {PEDALS[first.pedal]:<20}{cells}")
    return lines


def groups(coverage: Coverage) -> list[list[Place]]:
    """Rows of the map by speed band: the first place of each; backwards only where the vehicle is asked to."""
    found = [[Place(False, 0, speed, pedal) for pedal in range(len(PEDALS))] for speed in range(SPEEDS)]
    if any(one.place.backwards and not one.excluded for one in coverage.targets):
        found.append([Place(True, 0, 0, pedal) for pedal in range(len(PEDALS))])
    return found


def _have_of_need(coverage: Coverage, number: int) -> str:
    have_s = coverage.have_s(number)
    had = f"{have_s:.1f}" if 0.0 < have_s < 9.95 else f"{have_s:.0f}"
    if coverage.targets[number].excluded:
        return "-" if have_s == 0.0 else f"({had})"
    return f"{had}/{coverage.quota_s:g}"
