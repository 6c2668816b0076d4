"""Sensors at their stop: many equal values at one end of what a signal says, hardly any next to it.

Such a signal says nothing of the motion where it stands, and would be taken for a scale or a limit of the car.
Pedals and steering are left out: what an actuator's stop does is an effect of the catalogue.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tunefree_hil.learn.drives import Drive
from tunefree_hil.learn.runs import runs

Array = np.ndarray

SENSORS = (
    "report.accel_mps2", "report.lateral_accel_mps2", "report.yaw_rate_radps", "ins.accel_mps2", "ins.yaw_rate_radps"
)  # fmt: skip
LEAST_RUN = 8  # fresh values in a row that are one and the same
LEAST_RUNS = 2
PILED = 5.0  # times as often as the next values together: noise and rounding make no such end
NEXT = 3  # values next to the end


class Stop(NamedTuple):
    """A sensor's stop: the value, how many fresh values stand there, as a share of all."""

    field: str
    value: float
    share: float

    @property
    def words(self) -> str:
        """For people."""
        return f"{self.field} stands at its stop of {self.value:.4g} in {self.share:.1%} of its values"


def stops_of(drive: Drive) -> list[Stop]:
    """Of all sensors of a drive that are at a stop somewhere."""
    found = []
    for field in SENSORS:
        values = drive.get(field)
        if values is not None:
            some = values[drive.fresh[field] & np.isfinite(values)]
            found += [Stop(field, end, share) for end, share in _ends(some)]
    return found


def without(drive: Drive, stops: list[Stop]) -> Drive:
    """The drive as if it did not have these signals."""
    gone = {stop.field for stop in stops}
    return drive._replace(
        fields={name: values for name, values in drive.fields.items() if name not in gone},
        fresh={name: rows for name, rows in drive.fresh.items() if name not in gone},
    )


def _ends(some: Array) -> list[tuple[float, float]]:
    """(value, share) of each end at which values pile up. A stand is no stop: nought is left out."""
    levels, counts = np.unique(some, return_counts=True)
    if len(levels) < 4 * NEXT:
        return []
    found = []
    for end, beside in ((0, slice(1, 1 + NEXT)), (-1, slice(-1 - NEXT, -1))):
        value = float(levels[end])
        piled = counts[end] > PILED * counts[beside].sum()
        if value != 0.0 and piled and len(runs(some == value, LEAST_RUN)) >= LEAST_RUNS:
            found.append((value, float(counts[end]) / len(some)))
    return found
