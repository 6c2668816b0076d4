"""Coverage of a collection: frames by cell as numbers, as a text map and as plain data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tunefree_hil.collect import features
from tunefree_hil.collect.cells import (
    MAX_REVERSE_MPS,
    MIN_RUN_FRAMES,
    PEDAL_BANDS,
    SPEED_BAND_COUNT,
    STEER_BANDS,
    CellCounter,
    CellIndex,
    TargetCell,
    bands_from_envelope,
    cell_number,
    needed_frames,
)
from tunefree_hil.collect.envelope import envelope_from_vehicle
from tunefree_hil.config.schema import VehicleSpec

SCHEMA = "tunefree.coverage/1"
COLUMN_LABELS = ("shrp L", "turn L", "brch L", "strait", "brch R", "turn R", "shrp R")  # left is to the left


class Coverage:
    """Counts of a vehicle's cells against a quota."""

    def __init__(self, vehicle: VehicleSpec, targets: Sequence[TargetCell], quota_s: float, dt_s: float) -> None:
        self.vehicle = vehicle
        self.targets = tuple(targets)
        self.quota_s = quota_s
        self.dt_s = dt_s
        self.bands = bands_from_envelope(envelope_from_vehicle(vehicle))
        self.counter = CellCounter(needed_frames(targets, quota_s, dt_s))

    def add(self, get: Callable[[str], np.ndarray | None]) -> None:
        """Count a recording; get: its columns by name."""
        features.count_recording(get, self.bands, self.counter)

    @property
    def wanted(self) -> int:
        """Number of wanted cells."""
        return sum(need > 0 for need in self.counter.need)

    @property
    def full(self) -> int:
        """Number of full cells."""
        return self.wanted - self.counter.missing

    @property
    def collected_s(self) -> float:
        """Seconds that count towards the quotas."""
        pairs = zip(self.counter.have, self.counter.need, strict=True)
        return sum(min(have, need) for have, need in pairs) * self.dt_s

    @property
    def needed_s(self) -> float:
        """Sum of all quotas in s."""
        return sum(self.counter.need) * self.dt_s

    def have_s(self, number: int) -> float:
        """Collected seconds of a cell."""
        return self.counter.have[number] * self.dt_s

    def missing(self) -> list[str]:
        """Names of the cells that are not full."""
        return [self.name(i) for i in range(len(self.targets)) if self.counter.lacks(i)]

    def name(self, number: int) -> str:
        """Text for a cell."""
        index = self.targets[number].index
        gear = "reverse, " if index.backwards else ""
        return f"{gear}{STEER_BANDS[index.steer]}, {self.speed_text(index)}, {PEDAL_BANDS[index.pedal]}"

    def band_text(self, index: CellIndex) -> str:
        """Text for a speed band, with the gear where it is reverse."""
        return self.speed_text(index) + (" in reverse" if index.backwards else "")

    def speed_text(self, index: CellIndex) -> str:
        """Text for a speed band."""
        if index.backwards:
            return f"to {MAX_REVERSE_MPS:g} m/s"
        edges = self.bands.speed_mps
        if index.speed + 1 == SPEED_BAND_COUNT:
            return f"from {edges[-1]:.3g} m/s"
        return f"{edges[index.speed]:.3g}-{edges[index.speed + 1]:.3g} m/s"

    def as_dict(self) -> dict[str, Any]:
        """coverage.json."""
        return {
            "schema": SCHEMA,
            "vehicle": self.vehicle.name,
            "vehicle_hash": self.vehicle.hash,
            "quota_s": self.quota_s,
            "least_run_frames": MIN_RUN_FRAMES,
            "cells_full": self.full,
            "cells_wanted": self.wanted,
            "bands": self.bands._asdict(),
            "cells": [self._cell(number) for number in range(len(self.targets))],
        }

    def _cell(self, number: int) -> dict[str, Any]:
        target = self.targets[number]
        index = target.index
        return {
            "gear": "reverse" if index.backwards else "drive",
            "steer": STEER_BANDS[index.steer],
            "speed": self.speed_text(index),
            "pedal": PEDAL_BANDS[index.pedal],
            "have_s": round(self.have_s(number), 3),
            "need_s": round(self.counter.need[number] * self.dt_s, 3),
            "excluded": target.excluded,
        }


def coverage_map_lines(coverage: Coverage) -> list[str]:
    """The map for a terminal of 80 columns: collected/wanted seconds by cell, '-' where a cell is left out."""
    lines = [f"seconds collected of {coverage.quota_s:g} wanted by cell (-: left out, see coverage.json)"]
    lines.append(" " * 22 + "".join(f"{name:>8}" for name in COLUMN_LABELS))
    for group in speed_band_rows(coverage):
        lines.append(coverage.band_text(group[0]))
        for first in group:
            row = [cell_number(first._replace(steer=steer)) for steer in reversed(range(len(STEER_BANDS)))]
            cells = "".join(f"{_cell_text(coverage, number):>8}" for number in row)
            lines.append(f"  {PEDAL_BANDS[first.pedal]:<20}{cells}")
    return lines


def speed_band_rows(coverage: Coverage) -> list[list[CellIndex]]:
    """First cell of each map row, grouped by speed band; reverse only where its cells are wanted."""
    rows = [
        [CellIndex(False, 0, speed, pedal) for pedal in range(len(PEDAL_BANDS))] for speed in range(SPEED_BAND_COUNT)
    ]
    if any(one.index.backwards and not one.excluded for one in coverage.targets):
        rows.append([CellIndex(True, 0, 0, pedal) for pedal in range(len(PEDAL_BANDS))])
    return rows


def _cell_text(coverage: Coverage, number: int) -> str:
    have_s = coverage.have_s(number)
    collected = f"{have_s:.1f}" if 0.0 < have_s < 9.95 else f"{have_s:.0f}"
    if coverage.targets[number].excluded:
        return "-" if have_s == 0.0 else f"({collected})"
    return f"{collected}/{coverage.quota_s:g}"
