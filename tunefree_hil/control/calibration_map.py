"""The open-loop map f_map of eq. 2: (acceleration wanted, speed) -> pedal command, brake negative (interfaces 3).

The file `calibration.npz` holds triples: `speed_mps`, `accel_mps2`, `command_frac`, one-dimensional, of equal length.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.kernel import kernel, table
from tunefree_hil.base.maths import find_cell

KEYS = ("speed_mps", "accel_mps2", "command_frac")


class CalibrationMap(NamedTuple):
    """Speeds ascending; row i of the pairs is first[i] <= k < first[i + 1], its accelerations strictly ascending."""

    speed_mps: Any
    first: Any
    accel_mps2: Any
    command_frac: Any


def from_triples(
    speed_mps: Sequence[float], accel_mps2: Sequence[float], command_frac: Sequence[float], file: str = ""
) -> CalibrationMap:
    """The map of triples; of a repeated (speed, acceleration) pair the last one counts (apollo_facts 4.4)."""
    if not len(speed_mps) == len(accel_mps2) == len(command_frac) or len(speed_mps) == 0:
        raise InputError(
            f"{', '.join(KEYS)} have {len(speed_mps)}, {len(accel_mps2)}, {len(command_frac)} values",
            code="bad_calibration",
            file=file,
            hint="three one-dimensional arrays of the same length, at least 1",
        )
    rows: dict[float, dict[float, float]] = {}
    for speed, accel, command in zip(speed_mps, accel_mps2, command_frac, strict=True):
        rows.setdefault(float(speed), {})[float(accel)] = float(command)
    first, accels, commands = [0], [], []
    for speed in sorted(rows):
        pairs = sorted(rows[speed].items())
        accels += [accel for accel, _ in pairs]
        commands += [command for _, command in pairs]
        first.append(len(accels))
    return CalibrationMap(table(sorted(rows)), table(first), table(accels), table(commands))


def load(path: Path) -> CalibrationMap:
    """The map of a `calibration.npz`. Raises InputError that says what is wrong with the file."""
    hint = "make one with tools/make_calibration, or learn one from logs"
    if not path.is_file():
        raise InputError("no such file", code="no_calibration", file=str(path), hint=hint)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            lacking = [key for key in KEYS if key not in archive.files]
            if lacking:
                raise InputError(f"lacks {', '.join(lacking)}", code="bad_calibration", file=str(path), hint=hint)
            columns = [np.asarray(archive[key], dtype=np.float64) for key in KEYS]
    except (OSError, ValueError, EOFError, BadZipFile) as error:
        raise InputError(f"cannot be read: {error}", code="bad_calibration", file=str(path), hint=hint) from error
    if any(column.ndim != 1 or not np.all(np.isfinite(column)) for column in columns):
        raise InputError(
            "holds arrays that are not one-dimensional and finite", code="bad_calibration", file=str(path), hint=hint
        )
    return from_triples(columns[0].tolist(), columns[1].tolist(), columns[2].tolist(), str(path))


@kernel
def command_in_row(calibration: CalibrationMap, row: int, accel_mps2: float) -> float:
    """Linear in acceleration within one speed, held at the ends."""
    accels, commands = calibration.accel_mps2, calibration.command_frac
    low, high = int(calibration.first[row]), int(calibration.first[row + 1]) - 1
    if accel_mps2 <= accels[low]:
        return float(commands[low])
    if accel_mps2 >= accels[high]:
        return float(commands[high])
    while high - low > 1:
        middle = (low + high) // 2
        if accels[middle] <= accel_mps2:
            low = middle
        else:
            high = middle
    share = (accel_mps2 - accels[low]) / (accels[high] - accels[low])  # not 0: strictly ascending
    return commands[low] + share * (commands[high] - commands[low])


@kernel
def lookup(calibration: CalibrationMap, speed_mps: float, accel_mps2: float) -> float:
    """Command for an acceleration at a speed: linear between the two bracketing speeds, held at the ends."""
    speeds = calibration.speed_mps
    last = len(speeds) - 1
    if speed_mps <= speeds[0]:
        return command_in_row(calibration, 0, accel_mps2)
    if speed_mps >= speeds[last]:
        return command_in_row(calibration, last, accel_mps2)
    i = find_cell(speeds, speed_mps)
    share = (speed_mps - speeds[i]) / (speeds[i + 1] - speeds[i])  # not 0: strictly ascending
    below = command_in_row(calibration, i, accel_mps2)
    return below + share * (command_in_row(calibration, i + 1, accel_mps2) - below)
