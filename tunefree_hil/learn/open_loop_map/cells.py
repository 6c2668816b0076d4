"""Cells of speed and pedal duty: outlier removal, balancing, holdout and means, as in Apollo's data pipeline.

The first cell of a pedal holds it at rest. Cells are finer near rest, where a pedal begins to act.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.learn.open_loop_map.samples import ROWS, Array, MapSamples, find_pedal_range

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

SPEED_EDGES_MPS = (0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0)
SPEED_EDGES_MPS += (22.5, 25.0, 27.5, 30.0, 35.0, 40.0, 50.0, 60.0)
N_FINE_CELLS, FINE_SHARE = 8, 1.0 / 64.0  # shares of pedal travel
COARSE_SHARE = 1.0 / 32.0
MAD_SIGMA = 1.4826  # standard deviation over median absolute deviation, normal distribution

AccelerationLaw = Callable[[Array, Array], Array]  # (speed, command) -> acceleration


class CellCriteria(NamedTuple):
    """How samples are selected within a cell (docs/results/criteria.md)."""

    min_samples: int = 5  # a cell with fewer is dropped: they do not show its scatter
    max_samples: int = 24  # at most so many are kept, drawn at random: more would outweigh rare cells
    outlier_sigmas: float = 2.5  # distance from the median, in standard deviations by the median absolute deviation
    min_outlier_distance_mps2: float = 0.03  # least distance of an outlier from the median
    unheld_weight: float = 0.25  # weight of a cell whose pedal was never held: lags blur the effect of a moving pedal


CELLS = CellCriteria()


class CellEdges(NamedTuple):
    """Edges of the cells of one pedal, ascending; the first command cell is the pedal at rest."""

    speed_mps: Array
    command_frac: Array


class CellPoints(NamedTuple):
    """Samples of one pedal in their cells, arrays of shape (n_points,).

    Attributes:
        cell: Number of the cell.
        weight: The points of a cell weigh 1 together, or less.
    """

    speed_mps: Array
    command_frac: Array
    accel_mps2: Array
    cell: Array
    weight: Array

    def select(self, mask: Array) -> CellPoints:
        """The points of a mask."""
        return CellPoints(*(column[mask] for column in self))


class CellMeans(NamedTuple):
    """Means of cells, arrays of shape (n_cells,)."""

    speed_mps: Array
    command_frac: Array
    accel_mps2: Array
    cell: Array


def make_cell_edges(vehicle: VehicleSpec, pedal: str) -> CellEdges:
    """The cells of a pedal, up to its limit."""
    rest, limit = find_pedal_range(vehicle, pedal)
    span, half_width = limit - rest, ROWS.released_share * (limit - rest)
    shares = [FINE_SHARE * i for i in range(1, N_FINE_CELLS + 1)]
    shares += np.arange(shares[-1] + COARSE_SHARE, 1.0 - 0.5 * COARSE_SHARE, COARSE_SHARE).tolist()
    commands = [rest - half_width, rest + half_width, *(rest + share * span for share in shares), limit]
    return CellEdges(np.array(SPEED_EDGES_MPS), np.array(commands))


def assign_cells(samples: MapSamples, edges: CellEdges, rng: np.random.Generator) -> CellPoints:
    """The samples of one pedal by cell, without outliers and sparse cells, at most max_samples a cell."""
    columns = len(edges.command_frac) - 1
    row = np.searchsorted(edges.speed_mps, samples.speed_mps, side="right") - 1
    column = np.clip(np.searchsorted(edges.command_frac, samples.command_frac, side="right") - 1, 0, columns - 1)
    cell = row * columns + column
    inside = (row >= 0) & (row < len(edges.speed_mps) - 1)
    selected: list[Array] = []
    weights: list[Array] = []
    for number in np.unique(cell[inside]):
        members, weight = _prefer_held(np.flatnonzero(inside & (cell == number)), samples.is_held)
        members = members[_is_inlier(samples.accel_mps2[members])]
        if len(members) >= CELLS.min_samples:
            selected.append(np.sort(rng.permutation(members)[: CELLS.max_samples]))
            weights.append(np.full(len(selected[-1]), weight / len(selected[-1])))
    index = np.concatenate(selected) if selected else np.zeros(0, dtype=int)
    weight = np.concatenate(weights) if selected else np.zeros(0)
    columns_of_points = samples.speed_mps[index], samples.command_frac[index], samples.accel_mps2[index]
    return CellPoints(*columns_of_points, cell[index], weight)


def _prefer_held(members: Array, is_held: Array) -> tuple[Array, float]:
    """(samples with a held pedal, or all where these are too few; weight of the cell). No lag blurs a held pedal."""
    held_rows = members[is_held[members] > 0.5]
    return (held_rows, 1.0) if len(held_rows) >= CELLS.min_samples else (members, CELLS.unheld_weight)


def _is_inlier(values: Array) -> Array:
    middle = np.median(values)
    deviation = MAD_SIGMA * float(np.median(np.abs(values - middle)))
    limit = max(CELLS.outlier_sigmas * deviation, CELLS.min_outlier_distance_mps2)
    return np.abs(values - middle) <= limit


def split_holdout(points: CellPoints, parts: int, part: int, rng: np.random.Generator) -> tuple[CellPoints, CellPoints]:
    """Split by whole cells, drawn at random, into the rest and part `part` of `parts`."""
    cells = rng.permutation(np.unique(points.cell))
    is_held_out = np.isin(points.cell, cells[part::parts])
    return points.select(~is_held_out), points.select(is_held_out)


def average_cells(points: CellPoints) -> CellMeans:
    """The mean of each cell's points."""
    cells, index = np.unique(points.cell, return_inverse=True)
    counts = np.bincount(index)

    def mean(values: Array) -> Array:
        return np.bincount(index, values) / counts

    return CellMeans(mean(points.speed_mps), mean(points.command_frac), mean(points.accel_mps2), cells)


def compute_cell_errors(law: AccelerationLaw, points: CellPoints) -> Array:
    """Mean of law minus sample of each cell, m/s2: the noise of single samples averages out."""
    cells, index = np.unique(points.cell, return_inverse=True)
    errors = law(points.speed_mps, points.command_frac) - points.accel_mps2
    return np.bincount(index, errors) / np.bincount(index) if len(cells) else np.zeros(0)


def compute_rms(errors: Array) -> float:
    """Root mean square; NaN without errors."""
    return float(np.sqrt(np.mean(errors * errors))) if len(errors) else float("nan")


def find_populated_cells(points: CellPoints, edges: CellEdges) -> Array:
    """Which cells hold points, bool, shape (n_speed_cells, n_command_cells)."""
    shape = len(edges.speed_mps) - 1, len(edges.command_frac) - 1
    is_populated = np.zeros(shape[0] * shape[1], dtype=bool)
    is_populated[np.unique(points.cell)] = True
    return is_populated.reshape(shape)
