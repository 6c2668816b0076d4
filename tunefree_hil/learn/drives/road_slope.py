"""What an accelerometer says throughout, wherever the car heads: its own fault, or a slope that no place has."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tunefree_hil.base.units import G_MPS2
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.data_sheet import rear_behind_m
from tunefree_hil.learn.drives.drive import INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES, Drive
from tunefree_hil.learn.drives.smoothing import first_between_fresh, rate_of

Array = np.ndarray

FELT = ("report.accel_mps2",)
MEAN_S = 2.0  # a slope is looked at in means over so long
RATE_S = 0.5  # under the rate of speed
SLOW_MPS = 1.0  # below it an accelerometer says little about the road: stick, pitch, brakes
SECTORS, LEAST_MEANS = 8, 2  # of the compass; means that each of them must have, for a drive to all sides
ONE_WAY = 0.5  # mean heading's length from which on a drive goes somewhere: it may climb all the way
UNEVEN = 0.5  # of what stands: a slope that changes by more is a road's
STRAIGHT, EVEN = 0.9, 0.15  # the same of a drive that turns, but not to all sides: no road is as even for so long
LONG_S = 90.0
TOLD = 0.01  # g, from which on it is said
STEEP = 0.05  # g, from which on few sensors are mounted so wrongly, and a hill is the likelier
STEEP_EVEN = 0.05  # so it must be as even as this, of what stands
MOST_OFFSET = 0.2  # g: steeper than roads are


def offset_of(drive: Drive, vehicle: VehicleSpec) -> float:
    """What a drive's accelerometer says throughout beyond the rate of speed, in g; 0.0 where it may be a common road.

    A car that has been through all directions met each slope from either side: what stays the same wherever it heads
    is no hill. That a place slopes evenly is allowed for (a plane); a drive that goes one way may climb all the way,
    and is believed only where its slope hardly changes, which no road's does for minutes of turning. Whether it is the
    sensor's or something pulls the car (grade) its motion says: learn/physics/fit.py, road_share.
    """
    late = round(vehicle.ins_frame.latency_s / drive.dt_s)
    felt, speed, yaw = (
        first_between_fresh(drive, names, late) for names in (FELT, INS_FIRST_SPEEDS, INS_FIRST_YAW_RATES)
    )
    if felt is None or speed is None or yaw is None:
        return 0.0
    heading = np.cumsum(np.nan_to_num(yaw)) * drive.dt_s
    rate = rate_of(speed, np.isfinite(speed), max(round(RATE_S / drive.dt_s) | 1, 5), drive.dt_s)
    outwards_mps2 = rear_behind_m(vehicle.nominal) * yaw * yaw  # the centre of mass slides outwards at b * yaw rate
    beyond = (felt - rate + outwards_mps2) / G_MPS2
    known = np.isfinite(beyond) & (speed > SLOW_MPS)
    return standing(*_means(beyond, heading, known, round(MEAN_S / drive.dt_s)))


def offset_words(drives: Iterable[Drive], vehicle: VehicleSpec) -> list[str]:
    """A sentence for each drive whose accelerometer is off by enough to be taken for a hill otherwise."""
    found = [(drive.name, offset_of(drive, vehicle)) for drive in drives]
    return [
        f"{name}: its accelerometer says {G_MPS2 * offset:+.2f} m/s2 beyond the rate of speed wherever the car heads: "
        "no hill does; a fault of the sensor, or a slope that follows the car"
        for name, offset in found
        if abs(offset) > TOLD
    ]


def standing(slopes: Array, headings_rad: Array) -> float:
    """What of slopes is the same wherever the car headed; both [n], means over MEAN_S; 0.0 where they do not tell."""
    if len(slopes) < LONG_S / MEAN_S:
        return 0.0
    sectors = np.floor((headings_rad % (2.0 * np.pi)) / (2.0 * np.pi / SECTORS)).astype(int) % SECTORS
    one_way = abs(np.exp(1j * headings_rad).mean())
    plane = np.column_stack([np.ones(len(slopes)), np.cos(headings_rad), np.sin(headings_rad)])
    found, *_ = np.linalg.lstsq(plane, slopes, rcond=None)
    offset, left = float(found[0]), float(np.sqrt(np.mean((slopes - plane @ found) ** 2)))
    to_all_sides = np.bincount(sectors, minlength=SECTORS).min() >= LEAST_MEANS and one_way < ONE_WAY
    uneven = UNEVEN if to_all_sides else EVEN if one_way < STRAIGHT else 0.0
    if abs(offset) >= STEEP:
        uneven = min(uneven, STEEP_EVEN)
    return offset if left < uneven * abs(offset) and abs(offset) < MOST_OFFSET else 0.0


def _means(slope: Array, heading: Array, known: Array, rows: int) -> tuple[Array, Array]:
    """Means of slope and heading over `rows` ticks, where at least half of them are known."""
    n = len(slope) // rows * rows
    some = known[:n].reshape(-1, rows)
    slopes = np.where(some, slope[:n].reshape(-1, rows), 0.0).sum(axis=1) / np.maximum(some.sum(axis=1), 1)
    enough = 2 * some.sum(axis=1) >= rows
    return slopes[enough], heading[:n].reshape(-1, rows).mean(axis=1)[enough]
