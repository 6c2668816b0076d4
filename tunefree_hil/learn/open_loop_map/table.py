"""Makes the calibration table of the controller from the two pedal nets: monotone in the command, and inverted.

The accelerations of the nets on a grid are projected onto rows that never fall from full brake over released pedals to
full throttle (isotonic regression). Each row becomes a list of (acceleration, command) points that both ascend
strictly, so that the controller can look up the command. Of the dead band of a pedal only the last command is in it.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import isotonic_regression

from tunefree_hil.base.open_loop_map import KEYS
from tunefree_hil.control.calibration_map import CalibrationMap
from tunefree_hil.learn.open_loop_map.cells import AccelerationLaw, CellEdges
from tunefree_hil.learn.open_loop_map.samples import BRAKE, PEDAL_SIGN, PEDALS, THROTTLE

Array = np.ndarray

SUPPORTED, INTERPOLATED, EXTRAPOLATED = 1.0, 0.5, 0.0  # data at the node; at lower and higher commands; neither
SUPPORT_WEIGHTS = {SUPPORTED: 1.0, INTERPOLATED: 0.1, EXTRAPOLATED: 0.02}  # of a node in the projection
MAX_IDLE_ACCEL_MPS2 = 0.02  # a pedal that changes the acceleration by less is in its dead band
MIN_ACCEL_STEP_MPS2 = 0.005  # between neighbouring points of a row


class MapGrid(NamedTuple):
    """Accelerations over speed and signed command (brake negative), both ascending.

    Attributes:
        command_frac: Shape (n_columns,); 0 where both pedals are at rest.
        accel_mps2: Shape (n_rows, n_columns).
        support: SUPPORTED, INTERPOLATED or EXTRAPOLATED, shape (n_rows, n_columns).
    """

    speed_mps: Array
    command_frac: Array
    rest_column: int
    rest_frac: float
    accel_mps2: Array
    support: Array


class MapTable(NamedTuple):
    """The triples of calibration.npz and the support of each, by speed and then by acceleration."""

    speed_mps: Array
    accel_mps2: Array
    command_frac: Array
    support: Array


class MapPoint(NamedTuple):
    """A point of one row of the table."""

    accel_mps2: float
    command_frac: float
    support: float = SUPPORTED


class _PedalSide(NamedTuple):
    """Duties from rest on, shape (n_duties,); accelerations and support, shape (n_speeds, n_duties)."""

    duties: Array
    accels: Array
    support: Array


def make_grid(
    laws: Mapping[str, AccelerationLaw],
    populated: Mapping[str, Array],
    edges: Mapping[str, CellEdges],
    ranges: Mapping[str, Array],
) -> MapGrid:
    """Nodes on the edges of the cells, within the range of the data. All arguments are by pedal.

    Args:
        laws: The nets.
        populated: As from `find_populated_cells`.
        edges: Of the cells.
        ranges: Least and greatest measured acceleration, which limit the nets.
    """
    rows = np.flatnonzero(populated[THROTTLE].any(axis=1) | populated[BRAKE].any(axis=1))
    used = slice(int(rows[0]), int(rows[-1]) + 2)  # speed edges
    sides = {
        pedal: _make_pedal_side(laws[pedal], populated[pedal], edges[pedal], ranges[pedal], used) for pedal in PEDALS
    }
    throttle_side, brake_side = sides[THROTTLE], sides[BRAKE]
    coasting = _average_coasting(
        throttle_side.accels[:, 0], throttle_side.support[:, 0], brake_side.accels[:, 0], brake_side.support[:, 0]
    )
    raw = np.concatenate([brake_side.accels[:, :0:-1], coasting[:, None], throttle_side.accels[:, 1:]], axis=1)
    middle = np.maximum(brake_side.support[:, :1], throttle_side.support[:, :1])
    support = np.concatenate([brake_side.support[:, :0:-1], middle, throttle_side.support[:, 1:]], axis=1)
    commands = np.concatenate([-brake_side.duties[:0:-1], [0.0], throttle_side.duties[1:]])
    weights = np.vectorize(SUPPORT_WEIGHTS.__getitem__)(support)
    rising = [isotonic_regression(row, weights=weight).x for row, weight in zip(raw, weights, strict=True)]
    return MapGrid(
        speed_mps=edges[THROTTLE].speed_mps[used],
        command_frac=commands,
        rest_column=len(brake_side.duties) - 1,
        rest_frac=float(throttle_side.duties[0]),
        accel_mps2=np.stack(rising),
        support=support,
    )


def _make_pedal_side(
    law: AccelerationLaw, populated: Array, edges: CellEdges, accel_range: Array, used: slice
) -> _PedalSide:
    """The grid of one pedal. used: the speed edges."""
    columns = np.flatnonzero(populated.any(axis=0))
    last = max(int(columns[-1]) + 1, 2)  # the edge behind the last column with data
    rest = 0.5 * (edges.command_frac[0] + edges.command_frac[1])
    duties = np.concatenate([[rest], edges.command_frac[2 : last + 1]])
    accels = law(*np.meshgrid(edges.speed_mps[used], duties, indexing="ij"))
    support = _classify_support(populated, used, last)
    return _PedalSide(duties, np.clip(accels, accel_range[0], accel_range[1]), support)


def _classify_support(populated: Array, used: slice, last: int) -> Array:
    """Support of nodes by the cells around them, shape (n_speeds, n_duties)."""
    padded = np.pad(populated, ((1, 1), (0, 1)))
    by_speed = padded[used] | padded[used.start + 1 : used.stop + 1]  # either cell beside each speed node
    nodes = [by_speed[:, 0]] + [by_speed[:, j - 1] | by_speed[:, j] for j in range(2, last + 1)]
    supported = np.stack(nodes, axis=1)
    after = np.maximum.accumulate(supported[:, ::-1], axis=1)[:, ::-1]
    before = np.maximum.accumulate(supported, axis=1)
    return np.where(supported, SUPPORTED, np.where(before & after, INTERPOLATED, EXTRAPOLATED))


def _average_coasting(
    throttle_accels: Array, throttle_support: Array, brake_accels: Array, brake_support: Array
) -> Array:
    """Acceleration with both pedals at rest: the mean of the nets, or the net with better support."""
    throttle_weight = np.where(throttle_support >= brake_support, 1.0, 0.0)
    brake_weight = np.where(brake_support >= throttle_support, 1.0, 0.0)
    return (throttle_weight * throttle_accels + brake_weight * brake_accels) / (throttle_weight + brake_weight)


def table_from_grid(grid: MapGrid) -> MapTable:
    """The grid inverted row by row."""
    rows: list[tuple[float, float, float, float]] = []
    for speed, accels, support in zip(grid.speed_mps, grid.accel_mps2, grid.support, strict=True):
        points = invert_row(accels, grid.command_frac, support, grid.rest_column, grid.rest_frac)
        rows += [(float(speed), point.accel_mps2, point.command_frac, point.support) for point in points]
    return MapTable(*np.array(rows).T)


def invert_row(accels: Array, commands: Array, support: Array, rest_column: int, rest_frac: float) -> list[MapPoint]:
    """The points of one row, acceleration and command ascending strictly; `accels` must not fall.

    Coasting appears twice, slightly apart: with the end of the brake's dead band and with that of the throttle's, so
    that both are exact in the look-up.
    """
    points = [MapPoint(*map(float, numbers)) for numbers in zip(accels, commands, support, strict=True)]
    at_rest = points[rest_column]
    throttles = [at_rest._replace(command_frac=rest_frac), *points[rest_column + 1 :]]
    brakes = [at_rest._replace(command_frac=-rest_frac), *reversed(points[:rest_column])]
    throttles = skip_dead_band(throttles, 1.0, MAX_IDLE_ACCEL_MPS2)
    brakes = skip_dead_band(brakes, -1.0, MAX_IDLE_ACCEL_MPS2)
    brakes[0] = brakes[0]._replace(accel_mps2=at_rest.accel_mps2 - 0.5 * MIN_ACCEL_STEP_MPS2)
    # With rest at duty 0 and no dead band one point suffices.
    if brakes[0].command_frac >= throttles[0].command_frac:
        brakes = brakes[1:]
    return [*reversed(brakes), *throttles]


def skip_dead_band(points: Sequence[MapPoint], sign: float, max_idle_mps2: float) -> list[MapPoint]:
    """Points from the end of the dead band on, each MIN_ACCEL_STEP_MPS2 further; the first of equal ones.

    Args:
        points: Of one pedal, from rest on.
        sign: Of the acceleration by the pedal.
        max_idle_mps2: A change of the acceleration by less is in the dead band.
    """
    coasting = points[0].accel_mps2
    idle = max(i for i, point in enumerate(points) if sign * (point.accel_mps2 - coasting) < max_idle_mps2)
    effective = [points[idle]._replace(accel_mps2=coasting)]
    for point in points[idle + 1 :]:
        if sign * (point.accel_mps2 - effective[-1].accel_mps2) >= MIN_ACCEL_STEP_MPS2:
            effective.append(point)
    return effective


def law_from_calibration(calibration: CalibrationMap, pedal: str) -> AccelerationLaw:
    """The table read forwards for one pedal: (speed, duty) to acceleration, linear, constant beyond the ends."""
    speeds = np.asarray(calibration.speed_mps, dtype=np.float64)
    first = np.asarray(calibration.first, dtype=np.int64)
    accels, commands = np.asarray(calibration.at), np.asarray(calibration.value)

    def law(speed_mps: Array, command_frac: Array) -> Array:
        rows = [
            np.interp(PEDAL_SIGN[pedal] * command_frac, commands[low:high], accels[low:high])
            for low, high in itertools.pairwise(first)
        ]
        position = np.interp(speed_mps, speeds, np.arange(len(speeds)))
        below = np.minimum(position.astype(int), max(len(speeds) - 2, 0))
        above = np.minimum(below + 1, len(speeds) - 1)
        share, index = position - below, np.arange(len(position))
        table = np.stack(rows)
        return table[below, index] * (1.0 - share) + table[above, index] * share

    return law


def is_monotone(table: MapTable) -> bool:
    """Whether acceleration and command ascend strictly at every speed, as the look-up requires."""
    for speed in np.unique(table.speed_mps):
        row = table.speed_mps == speed
        if np.any(np.diff(table.accel_mps2[row]) <= 0.0) or np.any(np.diff(table.command_frac[row]) <= 0.0):
            return False
    return True


def write_table(path: Path, table: MapTable, card: str) -> None:
    """Write calibration.npz (docs/reference/files.md), with `support` and `card` (JSON) beside its arrays."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part.npz")
    columns = dict(zip(KEYS, table[:3], strict=True))
    np.savez(part, **columns, support=table.support, card=np.array(card))
    part.replace(path)


class LinearScale(NamedTuple):
    """(value - middle) / span."""

    middle: float
    span: float

    def normalize(self, value: Array) -> Array:
        """SI to about -1 to 1."""
        return (value - self.middle) / self.span

    def denormalize(self, value: Array) -> Array:
        """Back to SI."""
        return value * self.span + self.middle


class PedalNet(NamedTuple):
    """Eq. 1 of the Baidu paper, evaluated without torch: acceleration from speed and the duty of one pedal.

    Inputs and output are scaled; weights have shape (n_hidden,).
    """

    speed: LinearScale
    command: LinearScale
    accel: LinearScale
    w_speed: Array
    w_command: Array
    bias: Array
    w_out: Array
    b_out: float

    @property
    def width(self) -> int:
        """Number of hidden units."""
        return len(self.bias)

    def predict_acceleration(self, speed_mps: Array, command_frac: Array) -> Array:
        """m/s2, for arguments of one shape: sum of w_out sigmoid(w_command u + w_speed v + bias), plus b_out."""
        v, u = self.speed.normalize(np.asarray(speed_mps)), self.command.normalize(np.asarray(command_frac))
        inner = v[..., None] * self.w_speed + u[..., None] * self.w_command + self.bias
        hidden = 0.5 + 0.5 * np.tanh(0.5 * inner)  # the sigmoid, without overflow
        return self.accel.denormalize(hidden @ self.w_out + self.b_out)


def average_nets(nets: Sequence[PedalNet]) -> PedalNet:
    """The mean of nets with the same scales, as one net with all their hidden units."""
    first, share = nets[0], 1.0 / len(nets)
    w_speed, w_command, bias, w_out = (
        np.concatenate([getattr(net, name) for net in nets]) for name in ("w_speed", "w_command", "bias", "w_out")
    )
    b_out = share * sum(net.b_out for net in nets)
    return first._replace(w_speed=w_speed, w_command=w_command, bias=bias, w_out=share * w_out, b_out=b_out)


def scale_from_values(values: Array) -> LinearScale:
    """The scale that maps these values to -1 to 1."""
    low, high = float(np.min(values)), float(np.max(values))
    return LinearScale(0.5 * (low + high), max(0.5 * (high - low), 1e-6))
