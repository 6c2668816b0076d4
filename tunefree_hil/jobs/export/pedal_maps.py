"""The open-loop map as Autoware reads it: acceleration by pedal (rows) and speed (columns), one table a pedal.

A pedal is counted from rest: 0 is released, where Autoware commands 0. Autoware interpolates between speeds first and
inverts then, the bench the other way round; `largest_difference` says what that and the common rows come to.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunefree_hil.control.calibration_map import CalibrationMap, lookup

LARGEST_ROWS = 60  # of a table; a map with more different commands gets evenly spaced rows
# Autoware refuses a table whose acceleration does not grow with the throttle and fall with the brake.
LEAST_STEP_MPS2 = 1e-3
DIGITS = 5
THROTTLE, BRAKE = 1.0, -1.0
PROBES = 9  # accelerations a speed in `largest_difference`


class PedalMap(NamedTuple):
    """sign: THROTTLE or BRAKE. accel_mps2: shape (n_pedals, n_speeds)."""

    sign: float
    pedal_frac: NDArray[np.float64]
    speed_mps: NDArray[np.float64]
    accel_mps2: NDArray[np.float64]


def make_pedal_map(calibration: CalibrationMap, rest_frac: float, sign: float) -> PedalMap:
    """The table of one pedal. Where a speed's commands end earlier than those of others, its last value is kept."""
    rows = [_by_command(calibration, i) for i in range(len(calibration.speed_mps))]
    pressed = np.unique(np.round([one for commands, _ in rows for one in sign * commands - rest_frac], DIGITS))
    pedals = np.concatenate([[0.0], pressed[pressed > 10.0**-DIGITS]])
    if pedals.size > LARGEST_ROWS:
        pedals = np.round(np.linspace(0.0, pedals[-1], LARGEST_ROWS), DIGITS)
    table = np.array([np.interp(sign * (rest_frac + pedals), commands, accels) for commands, accels in rows]).T
    for before, after in itertools.pairwise(table):
        edge = before + sign * LEAST_STEP_MPS2
        after[:] = np.maximum(after, edge) if sign == THROTTLE else np.minimum(after, edge)
    return PedalMap(sign, pedals, np.array(calibration.speed_mps), np.round(table, DIGITS))


def _by_command(calibration: CalibrationMap, row: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(commands ascending, accelerations) of one speed; of a command that occurs twice the mean."""
    points = slice(int(calibration.first[row]), int(calibration.first[row + 1]))
    commands, places = np.unique(np.array(calibration.value[points]), return_inverse=True)
    sums = np.bincount(places, np.array(calibration.at[points]))
    return commands, sums / np.bincount(places)


def render_csv(pedal_map: PedalMap, name: str) -> str:
    """First line: name and speeds in m/s; then a line a pedal: its share of full, and accelerations in m/s2."""
    lines = [[name, *pedal_map.speed_mps], *map(list, np.column_stack([pedal_map.pedal_frac, pedal_map.accel_mps2]))]
    return "".join(
        ",".join(one if isinstance(one, str) else f"{one:.{DIGITS}f}" for one in line) + "\n" for line in lines
    )


def find_pedal(pedal_map: PedalMap, accel_mps2: float, speed_mps: float) -> float:
    """The pedal by Autoware's rule: accelerations at this speed, then the pedal between them, clamped to the table."""
    at_speed = [float(np.interp(speed_mps, pedal_map.speed_mps, row)) for row in pedal_map.accel_mps2]
    order: Sequence[int] = range(len(at_speed)) if pedal_map.sign == THROTTLE else range(len(at_speed) - 1, -1, -1)
    return float(np.interp(accel_mps2, [at_speed[i] for i in order], [pedal_map.pedal_frac[i] for i in order]))


class MapDifference(NamedTuple):
    """Largest differences from the bench's lookup: of the pedal, and of the acceleration that a table gives for it."""

    pedal_frac: float
    accel_mps2: float


def largest_difference(pedal_map: PedalMap, calibration: CalibrationMap, rest_frac: float) -> MapDifference:
    """The differences at the map's speeds and halfway between them."""
    speeds = pedal_map.speed_mps
    probes = np.concatenate([speeds, 0.5 * (speeds[1:] + speeds[:-1])])
    largest = MapDifference(0.0, 0.0)
    for speed_mps in probes:
        start, end = (float(np.interp(speed_mps, speeds, pedal_map.accel_mps2[i])) for i in (0, -1))
        for accel_mps2 in np.linspace(start, end, PROBES + 2)[1:-1]:
            command = pedal_map.sign * lookup(calibration, float(speed_mps), float(accel_mps2))
            wanted = max(command - rest_frac, 0.0)
            pedal = abs(find_pedal(pedal_map, float(accel_mps2), float(speed_mps)) - wanted)
            given = [float(np.interp(speed_mps, speeds, row)) for row in pedal_map.accel_mps2]
            accel = abs(float(np.interp(wanted, pedal_map.pedal_frac, given)) - accel_mps2)
            largest = MapDifference(max(largest.pedal_frac, pedal), max(largest.accel_mps2, float(accel)))
    return largest
