"""A measured signal on every tick: its values, where a frame brought one, and where there was a gap.

Sensors at their stop: many equal values at one end of what a signal says, hardly any next to it.

Such a signal says nothing of the motion where it stands, and would be taken for a scale or a limit of the car.
Pedals and steering are left out: what an actuator's stop does is an effect of the catalogue.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from tunefree_hil.gap.estimation.noise import told_noise
from tunefree_hil.gap.model.history import ahead
from tunefree_hil.learn.drives.drive import INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES, Drive
from tunefree_hil.learn.drives.runs import every_of, runs, there_of
from tunefree_hil.learn.drives.smoothing import between_fresh
from tunefree_hil.learn.drives.validity import is_on_demand

Array = np.ndarray

SLOW_TICKS = 3  # from value to value, from which a signal lies on straight lines that are seen
COVERS = 0.5  # of what the chassis says: an INS that says less is no second opinion of a drive
INS = "ins."


class Signal(NamedTuple):
    """A measured signal on every tick, straight lines between fresh values; the INS's as much earlier as it is late.

    there: bool [n], not within a gap. told: the values in the rows in which they came (moved by parts of a row, they
    are means of two, and quieter). late: rows by which `values` were moved, parts of a row too. every: rows from one
    value to the next.
    """

    values: Array
    fresh: Array
    there: Array
    told: Array
    late: float = 0.0
    every: float = 1.0

    @property
    def noise(self) -> float:
        """Standard deviation of the sensor's white noise, or of the wire's rounding where that is more."""
        return told_noise(self.told, np.flatnonzero(self.fresh & self.there))

    def as_told(self, values: Array, rows: Array) -> Array:
        """What another signal [n] was when this one's sensor looked that told something in these rows."""
        return np.interp(rows - self.late, np.arange(len(values)), values)

    def as_seldom(self, values: Array) -> Array:
        """Another signal [n], on the straight lines that this one lies on: what is simulated on every tick and held
        against what was measured ten times a second.
        """
        if self.every < SLOW_TICKS:
            return values
        ticks = np.arange(len(values))
        seen = np.flatnonzero(self.fresh) - self.late
        return np.interp(ticks, seen, np.interp(seen, ticks, values))


def signals_of(drive: Drive, late: float) -> dict[str, Signal]:
    """Signals by field name. late: rows by which the INS is late."""
    return {name: one for name in drive.fields if (one := signal_of(drive, name, late)) is not None}


def well_covered(signals: Mapping[str, Signal], name: str) -> tuple[dict[str, Signal], tuple[str, ...]]:
    """(signals without an INS that says little of a drive and the chassis says the same, what was left out in words).

    Without a speed of its own an INS is left out whole, but for a yaw rate that nobody else tells.
    """
    speed, (yaw, chassis_yaw) = INS_FIRST_SPEEDS[0], INS_FIRST_YAW_RATES
    if says_little(signals, *INS_FIRST_SPEEDS):
        out = {one for one in signals if one.startswith(INS) and (one != yaw or chassis_yaw in signals)}
        what = ("a speed", speed, "it")
    elif says_little(signals, *INS_FIRST_YAW_RATES):
        out, what = {yaw}, ("a yaw rate", yaw, "that")
    else:
        return dict(signals), ()
    share = signals[what[1]].there.mean()
    words = f"{name}: the INS says {what[0]} in {share:.0%} of it only, so {what[2]} is left out"
    return {key: one for key, one in signals.items() if key not in out}, (words,)


def says_little(signals: Mapping[str, Signal], by_ins: str, by_chassis: str) -> bool:
    """Whether an INS says something in less than COVERS of what the chassis says it in."""
    if by_ins not in signals or by_chassis not in signals:
        return False
    return bool(signals[by_ins].there.sum() < COVERS * signals[by_chassis].there.sum())


def signal_of(drive: Drive, name: str, late: float) -> Signal | None:
    """A field of a drive; None for one that says next to nothing, or that nobody measured or sent."""
    values, fresh = drive.fields[name], drive.fresh[name] & np.isfinite(drive.fields[name])
    if not name.startswith(("report.", INS, "command.")) or fresh.sum() < 2:
        return None
    if name.endswith("heading_rad"):
        values = values.copy()
        values[fresh] = np.unwrap(values[fresh])
    one = as_told(values, fresh, drive.dt_s)
    if name.startswith(INS) and late:
        there = ahead(one.there.astype(float), late) > 0.999
        return one._replace(values=ahead(one.values, late), there=there, late=late)
    return one


def as_told(values: Array, fresh: Array, dt_s: float) -> Signal:
    """Of values [n] that are fresh now and then, twice at least."""
    told = fresh & np.isfinite(values)
    between = between_fresh(values, told)
    return Signal(between, told, there_of(told, dt_s), between, every=every_of(told))


def carried(signals: Mapping[str, Signal], names: tuple[str, ...], ticks: int) -> Array:
    """bool [n]: where the first of some signals that there is has no gap; everywhere where there is none of them, or it
    is sent on demand: then it pauses for most of a drive, again and again, and what was said last holds.
    """
    for name in names:
        if name in signals:
            there = signals[name].there
            return np.ones(ticks, dtype=bool) if is_on_demand(there) else there
    return np.ones(ticks, dtype=bool)


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
