"""Coverage cells: gear x steering band x speed band x pedal band, as in Apollo's data collection.

The band edges are shares of the vehicle's limits, taken from Apollo's values for the Lincoln MKZ: speeds 10 and 20 m/s
of 40, pedals as shares of the travel from rest to the limit, steering 1, 30 and 60 % of the wheel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from tunefree_hil.base.records import GEAR_NEUTRAL, GEAR_PARK, GEAR_REVERSE
from tunefree_hil.collect.envelope import LATERAL_SHARE, SPEED_SHARE, Envelope, curvature_1pm

STEER_BANDS = ("sharp right", "turn right", "branch right", "straight", "branch left", "turn left", "sharp left")
STRAIGHT = 3
PEDAL_BANDS = ("brake high", "brake mid", "brake light", "throttle light", "throttle mid", "throttle high")
FIRST_THROTTLE = 3
SPEED_BAND_COUNT = 3
STEER_EDGES = (0.01, 0.30, 0.60)  # of the steering limit
SPEED_EDGES = (0.25, 0.50)  # of the speed limit
THROTTLE_EDGES = (0.01, 0.154, 0.231)  # of the travel from rest to the limit; below the first the pedal is released
BRAKE_EDGES = (0.01, 0.143, 0.286)
MIN_SPEED_MPS = 0.2
MAX_REVERSE_MPS = 2.0  # upper edge of the only speed band in reverse
MIN_RUN_FRAMES = 20  # consecutive frames in one cell that count
FORWARD_CELLS = len(STEER_BANDS) * SPEED_BAND_COUNT * len(PEDAL_BANDS)
CELL_COUNT = FORWARD_CELLS + len(STEER_BANDS) * len(PEDAL_BANDS)
NO_CELL = -1
TOP_BAND_FACTOR = 1.25  # highest planned speed over the lower edge of the open speed band
MIN_SPEED_RATIO = 1.1  # upper over lower speed of a cell; below it the cell is left out


class CellSignals(NamedTuple):
    """Signals of one tick that determine its cell. gear NaN: not reported, taken as drive."""

    gear: float
    speed_mps: float
    steer_rad: float
    throttle_frac: float
    brake_frac: float


class CellIndex(NamedTuple):
    """A cell by the indices of its steering band, speed band (0 in reverse) and pedal band."""

    backwards: bool
    steer: int
    speed: int
    pedal: int


class TargetCell(NamedTuple):
    """A cell to fill, with the speeds at which it is driven. excluded: why it is left out, or ''."""

    index: CellIndex
    low_mps: float
    high_mps: float
    excluded: str


class BandEdges(NamedTuple):
    """Band edges of one vehicle. Pedal edges are duty as on the bus, steering edges steering-wheel angles."""

    speed_mps: tuple[float, float, float]
    steer_rad: tuple[float, float, float]
    throttle_frac: tuple[float, float, float]
    brake_frac: tuple[float, float, float]


def bands_from_envelope(envelope: Envelope) -> BandEdges:
    """The band edges of a vehicle."""
    rest = envelope.rest_frac
    throttle, brake = envelope.throttle_frac - rest, envelope.brake_frac - rest
    first, second = SPEED_EDGES
    a, b, c = STEER_EDGES
    t, u, v = THROTTLE_EDGES
    d, e, f = BRAKE_EDGES
    return BandEdges(
        (MIN_SPEED_MPS, first * envelope.speed_mps, second * envelope.speed_mps),
        (a * envelope.steer_rad, b * envelope.steer_rad, c * envelope.steer_rad),
        (rest + t * throttle, rest + u * throttle, rest + v * throttle),
        (rest + d * brake, rest + e * brake, rest + f * brake),
    )


def cell_number(index: CellIndex) -> int:
    """The cell's number, 0 to CELL_COUNT - 1."""
    if index.backwards:
        return FORWARD_CELLS + index.steer * len(PEDAL_BANDS) + index.pedal
    return (index.steer * SPEED_BAND_COUNT + index.speed) * len(PEDAL_BANDS) + index.pedal


def cell_index(number: int) -> CellIndex:
    """The inverse of `cell_number`."""
    if number >= FORWARD_CELLS:
        steer, pedal = divmod(number - FORWARD_CELLS, len(PEDAL_BANDS))
        return CellIndex(True, steer, 0, pedal)
    rest, pedal = divmod(number, len(PEDAL_BANDS))
    steer, speed = divmod(rest, SPEED_BAND_COUNT)
    return CellIndex(False, steer, speed, pedal)


def classify_cell(bands: BandEdges, signals: CellSignals) -> int:
    """Number of the cell of a tick; NO_CELL at standstill, with both pedals released, or where a value is missing.

    With both pedals pressed the brake counts.
    """
    speed = abs(signals.speed_mps)
    total = speed + signals.steer_rad + signals.throttle_frac + signals.brake_frac
    if total - total != 0.0 or speed < bands.speed_mps[0] or signals.gear in (GEAR_PARK, GEAR_NEUTRAL):
        return NO_CELL
    pressed = _above(bands.brake_frac, signals.brake_frac)
    if pressed:
        pedal = FIRST_THROTTLE - pressed
    else:
        pressed = _above(bands.throttle_frac, signals.throttle_frac)
        if not pressed:
            return NO_CELL
        pedal = FIRST_THROTTLE - 1 + pressed
    turn = _above(bands.steer_rad, abs(signals.steer_rad))
    steer = STRAIGHT + turn if signals.steer_rad > 0.0 else STRAIGHT - turn
    if signals.gear == GEAR_REVERSE:
        return cell_number(CellIndex(True, steer, 0, pedal)) if speed < MAX_REVERSE_MPS else NO_CELL
    return cell_number(CellIndex(False, steer, _above(bands.speed_mps, speed) - 1, pedal))


def _above(edges: tuple[float, float, float], value: float) -> int:
    return (value >= edges[0]) + (value >= edges[1]) + (value >= edges[2])


def make_target_cells(
    envelope: Envelope, top_mps: float | None = None, *, reverse_mps: float = 0.0
) -> tuple[TargetCell, ...]:
    """All cells by number, with their speeds or the reason why they are left out.

    Args:
        top_mps: Highest speed to drive; None for the vehicle's own limit.
        reverse_mps: Highest speed in reverse, 0 where the vehicle does not drive in reverse.
    """
    return tuple(_make_target(envelope, cell_index(number), top_mps, reverse_mps) for number in range(CELL_COUNT))


def max_planned_speed_mps(envelope: Envelope, top_mps: float | None = None) -> float:
    """The highest speed that is planned."""
    most = min(SPEED_SHARE * envelope.speed_mps, TOP_BAND_FACTOR * SPEED_EDGES[1] * envelope.speed_mps)
    return most if top_mps is None else min(most, top_mps)


def _make_target(envelope: Envelope, index: CellIndex, top_mps: float | None, reverse_mps: float) -> TargetCell:
    bands, top = bands_from_envelope(envelope), max_planned_speed_mps(envelope, top_mps)
    low = bands.speed_mps[index.speed]
    high = min([*bands.speed_mps[1:], math.inf][index.speed], top)
    if index.backwards:
        reason = "" if reverse_mps > MIN_SPEED_MPS else "limits.reverse_mps of the vehicle is 0"
        return TargetCell(index, MIN_SPEED_MPS, min(reverse_mps, MAX_REVERSE_MPS), reason)
    if high < MIN_SPEED_RATIO * low:
        return TargetCell(index, low, high, f"begins at {low:.3g} m/s; the highest planned speed is {top:.3g} m/s")
    turn = abs(index.steer - STRAIGHT)
    if turn == 0:
        return TargetCell(index, low, high, "")
    angle = 1.15 * bands.steer_rad[turn - 1]
    bound_mps2 = LATERAL_SHARE * envelope.lateral_mps2
    curve_speed_mps = math.sqrt(bound_mps2 / curvature_1pm(envelope, angle))
    if curve_speed_mps < MIN_SPEED_RATIO * low:
        lateral_mps2 = low * low * curvature_1pm(envelope, angle)
        reason = (
            f"{100.0 * STEER_EDGES[turn - 1]:.0f} % steering at {low:.3g} m/s gives a lateral acceleration of"
            f" {lateral_mps2:.1f} m/s2; at most {bound_mps2:.1f} are planned"
        )
        return TargetCell(index, low, curve_speed_mps, reason)
    return TargetCell(index, low, min(high, curve_speed_mps), "")


class CellCounter:
    """Counts frames by cell, tick by tick. Only runs of at least MIN_RUN_FRAMES in one cell count, then completely."""

    def __init__(self, need: Sequence[int], have: Sequence[int] | None = None) -> None:
        self.need = list(need)
        self.have = list(have) if have is not None else [0] * len(self.need)
        self.missing = sum(have < need for have, need in zip(self.have, self.need, strict=True))
        self._cell, self._run = NO_CELL, 0

    def count_frame(self, cell: int) -> None:
        """Count one tick of `cell`, or of NO_CELL."""
        if cell != self._cell:
            self._cell, self._run = cell, 0
        self._run += 1
        if cell == NO_CELL or self._run < MIN_RUN_FRAMES:
            return
        before = self.have[cell]
        self.have[cell] = before + (MIN_RUN_FRAMES if self._run == MIN_RUN_FRAMES else 1)
        if before < self.need[cell] <= self.have[cell]:
            self.missing -= 1

    def end_run(self) -> None:
        """End the current run, for a gap in the data."""
        self._cell, self._run = NO_CELL, 0

    def lacks(self, cell: int) -> bool:
        """Whether a cell is wanted and not full."""
        return self.have[cell] < self.need[cell]


def needed_frames(targets: Sequence[TargetCell], quota_s: float, dt_s: float) -> list[int]:
    """Wanted frames by cell, 0 where a cell is left out."""
    quota = max(1, round(quota_s / dt_s))
    return [0 if target.excluded else quota for target in targets]
