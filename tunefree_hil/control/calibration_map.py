"""The open-loop map f_map of eq. 2: (demanded acceleration, speed) -> pedal command, brake negative
(docs/reference/files.md)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tunefree_hil.base.kernel import kernel
from tunefree_hil.base.open_loop_map import Refusal, SpeedRows, read_triples, rows_by_speed, value_at

CalibrationMap = SpeedRows  # `at`: acceleration in m/s2, `value`: the command
REFUSAL = Refusal("no_calibration", "bad_calibration", "make one with tools/make_calibration, or learn one from logs")


def from_triples(
    speed_mps: Sequence[float], accel_mps2: Sequence[float], command_frac: Sequence[float]
) -> CalibrationMap:
    """The map of triples; of a repeated (speed, acceleration) pair the last one is used.

    Raises ValueError for columns of unequal length, or empty ones.
    """
    return rows_by_speed(speed_mps, accel_mps2, command_frac)


def load(path: Path) -> CalibrationMap:
    """The map of a `calibration.npz`. Raises InputError for a file that is not valid."""
    return from_triples(*read_triples(path, REFUSAL))


@kernel
def lookup(calibration: CalibrationMap, speed_mps: float, accel_mps2: float) -> float:
    """Command for an acceleration at a speed."""
    return value_at(calibration, speed_mps, accel_mps2)
