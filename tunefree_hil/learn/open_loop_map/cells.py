"""Cells of speed and pedal: outliers dropped, numbers balanced, cells held out, means (apollo_facts 5.2).

The first cell of a pedal holds it at rest. Cells are finer where a pedal begins to bite.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tunefree_hil.learn.open_loop_map.samples import TOUCH_SHARE, Array, Samples, pedal_limits

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

SPEED_EDGES_MPS = (0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0)
SPEED_EDGES_MPS += (22.5, 25.0, 27.5, 30.0, 35.0, 40.0, 50.0, 60.0)
FINE_CELLS, FINE_SHARE = 8, 1.0 / 64.0  # of a pedal's way, from rest,
COARSE_SHARE = 1.0 / 32.0  # then this
LEAST_IN_CELL = 5  # samples: fewer say nothing about what a cell is like
MOST_IN_CELL = 24  # are kept, by lot
FAR_DEVIATIONS = 2.5  # from the cell's median, in standard deviations (of the median absolute deviation),
FAR_MPS2 = 0.03  # but at least this
BLURRED_WEIGHT = 0.25  # of a cell whose pedal was never held
MAD_SIGMA = 1.4826  # standard deviation / median absolute deviation, of a normal distribution

Law = Callable[[Array, Array], Array]  # (speed, command) -> acceleration


class Edges(NamedTuple):
    """Of the cells of one pedal, ascending; command in duty, its first cell is the pedal at rest."""

    speed_mps: Array
    command_frac: Array


class Points(NamedTuple):
    """Samples of one pedal in their cells. cell: a number of its own; weight: of a cell's points in all 1, or less."""

    speed_mps: Array
    command_frac: Array
    accel_mps2: Array
    cell: Array
    weight: Array

    def where(self, mask: Array) -> Points:
        """Some of them."""
        return Points(*(column[mask] for column in self))


class Means(NamedTuple):
    """One row a cell."""

    speed_mps: Array
    command_frac: Array
    accel_mps2: Array
    cell: Array


def edges_of(vehicle: VehicleSpec, pedal: str) -> Edges:
    """The cells of a pedal, up to its limit."""
    rest, limit = pedal_limits(vehicle, pedal)
    way = limit - rest
    shares = [FINE_SHARE * i for i in range(1, FINE_CELLS + 1)]
    shares += np.arange(shares[-1] + COARSE_SHARE, 1.0 - 0.5 * COARSE_SHARE, COARSE_SHARE).tolist()
    commands = [rest - TOUCH_SHARE * way, rest + TOUCH_SHARE * way, *(rest + share * way for share in shares), limit]
    return Edges(np.array(SPEED_EDGES_MPS), np.array(commands))


def points_of(samples: Samples, edges: Edges, rng: np.random.Generator) -> Points:
    """The samples of one pedal (`Samples.of`) by cell: outliers and thin cells dropped, at most MOST_IN_CELL."""
    columns = len(edges.command_frac) - 1
    row = np.searchsorted(edges.speed_mps, samples.speed_mps, side="right") - 1
    column = np.clip(np.searchsorted(edges.command_frac, samples.command_frac, side="right") - 1, 0, columns - 1)
    cell = row * columns + column
    inside = (row >= 0) & (row < len(edges.speed_mps) - 1)
    kept: list[Array] = []
    weights: list[Array] = []
    for one in np.unique(cell[inside]):
        mine, weight = _held_first(np.flatnonzero(inside & (cell == one)), samples.held)
        mine = mine[_is_near(samples.accel_mps2[mine])]
        if len(mine) >= LEAST_IN_CELL:
            kept.append(np.sort(rng.permutation(mine)[:MOST_IN_CELL]))
            weights.append(np.full(len(kept[-1]), weight / len(kept[-1])))
    at = np.concatenate(kept) if kept else np.zeros(0, dtype=int)
    weight = np.concatenate(weights) if kept else np.zeros(0)
    return Points(samples.speed_mps[at], samples.command_frac[at], samples.accel_mps2[at], cell[at], weight)


def _held_first(mine: Array, held: Array) -> tuple[Array, float]:
    """(samples, weight of the cell): where there are enough of a pedal that was held, those alone: lags blur."""
    calm = mine[held[mine] > 0.5]
    return (calm, 1.0) if len(calm) >= LEAST_IN_CELL else (mine, BLURRED_WEIGHT)


def _is_near(values: Array) -> Array:
    middle = np.median(values)
    deviation = MAD_SIGMA * float(np.median(np.abs(values - middle)))
    return np.abs(values - middle) <= max(FAR_DEVIATIONS * deviation, FAR_MPS2)


def hold_out(points: Points, parts: int, part: int, rng: np.random.Generator) -> tuple[Points, Points]:
    """(the rest, part `part` of `parts`) by whole cells, drawn by lot: the same lot for the same generator."""
    cells = rng.permutation(np.unique(points.cell))
    out = np.isin(points.cell, cells[part::parts])
    return points.where(~out), points.where(out)


def means_of(points: Points) -> Means:
    """The middle of each cell's points."""
    cells, at = np.unique(points.cell, return_inverse=True)
    counts = np.bincount(at)

    def mean(values: Array) -> Array:
        return np.bincount(at, values) / counts

    return Means(mean(points.speed_mps), mean(points.command_frac), mean(points.accel_mps2), cells)


def cell_errors(law: Law, points: Points) -> Array:
    """Of each cell the mean of law - sample, m/s2: noise of single samples averages out."""
    cells, at = np.unique(points.cell, return_inverse=True)
    errors = law(points.speed_mps, points.command_frac) - points.accel_mps2
    return np.bincount(at, errors) / np.bincount(at) if len(cells) else np.zeros(0)


def rms(errors: Array) -> float:
    """Root mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(errors * errors))) if len(errors) else float("nan")


def populated(points: Points, edges: Edges) -> Array:
    """bool [speed cells, command cells]: which hold points."""
    shape = len(edges.speed_mps) - 1, len(edges.command_frac) - 1
    found = np.zeros(shape[0] * shape[1], dtype=bool)
    found[np.unique(points.cell)] = True
    return found.reshape(shape)
