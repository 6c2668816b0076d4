"""The open-loop map from drives (paper II.B): samples with the delay encoded, two nets, a table to be read backwards.

samples = ...samples_of(tracks, delays, vehicle)
learned = yield from learn_map(samples, vehicle, seed=1)      # Steps on the way
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.learn.drives import Drive
from tunefree_hil.learn.map_cells import Edges, Points, edges_of, hold_out, means_of, points_of, populated
from tunefree_hil.learn.map_net import PedalNet, merged
from tunefree_hil.learn.map_samples import PEDALS, Delay, Samples, find_delay, samples_of
from tunefree_hil.learn.map_table import MapGrid, MapTable, grid_of, table_of
from tunefree_hil.learn.map_tracks import tracks_of
from tunefree_hil.learn.training import map_nets

if TYPE_CHECKING:
    from tunefree_hil.config.schema import VehicleSpec

HELD_OUT_PARTS = 5  # a fifth of the cells chooses the width and ends the training
LEAST_CELLS, LEAST_SPEED_CELLS = 12, 3  # of a pedal, below which a net would be an invention

Result = TypeVar("Result")


class Step(NamedTuple):
    """How far the training is."""

    done: int
    total: int
    words: str


class PedalChoice(NamedTuple):
    """What the enumeration gave for a pedal: the mean of the seeds' nets, each of hidden width `width`.

    held_out_mps2: RMS over cells that these nets had not seen. by_width: hidden width -> the same of its single seeds.
    """

    net: PedalNet
    width: int
    held_out_mps2: float
    by_width: Mapping[int, tuple[float, ...]]
    points: Points
    whole: bool  # False: a training came to numbers that are not finite and was stopped there


class LearnedMap(NamedTuple):
    """The table, and what it was made of."""

    table: MapTable
    grid: MapGrid
    choices: Mapping[str, PedalChoice]


class Gathered(NamedTuple):
    """What drives say about the pedals."""

    samples: Samples
    delays: Mapping[str, Delay]
    words: list[str]


def gather(drives: Sequence[Drive], vehicle: VehicleSpec) -> Gathered:
    """The samples of drives, each pedal with its delay. Raises InputError that says what the drives lack."""
    tracks, words = tracks_of(drives, vehicle)
    delays = {pedal: find_delay(tracks, pedal, vehicle) for pedal in PEDALS}
    samples = samples_of(tracks, delays, vehicle)
    return Gathered(samples, delays, [*words, *(delay.words for delay in delays.values() if delay.found)])


def learn_map(samples: Samples, vehicle: VehicleSpec, seed: int) -> Generator[Step, None, LearnedMap]:
    """Train both nets and make the table. Raises InputError: torch missing, or too few cells with data."""
    edges = {pedal: edges_of(vehicle, pedal) for pedal in PEDALS}
    points = balanced(samples, edges, seed)
    choices = yield from learn_nets(points, seed)
    return map_of(choices, edges)


def map_of(choices: Mapping[str, PedalChoice], edges: Mapping[str, Edges]) -> LearnedMap:
    """The table of two trained nets, over the region of the points that they were trained on."""
    points = {pedal: choice.points for pedal, choice in choices.items()}
    grid = grid_of(
        {pedal: choice.net.accel_of for pedal, choice in choices.items()},
        {pedal: populated(points[pedal], edges[pedal]) for pedal in PEDALS},
        edges,
        {pedal: np.array([np.min(own.accel_mps2), np.max(own.accel_mps2)]) for pedal, own in points.items()},
    )
    return LearnedMap(table_of(grid), grid, choices)


def balanced(samples: Samples, edges: Mapping[str, Edges], seed: int) -> dict[str, Points]:
    """The points of each pedal. Raises InputError for a pedal that was tried in too few ways."""
    found = {}
    for number, pedal in enumerate(PEDALS):
        points = points_of(samples.of(pedal), edges[pedal], np.random.default_rng([seed, number]))
        _require_cells(points, edges[pedal], pedal)
        found[pedal] = points
    return found


def learn_nets(points: Mapping[str, Points], seed: int) -> Generator[Step, None, dict[str, PedalChoice]]:
    """Both nets: the width by enumeration on held-out cells, then its seeds once more on all cells, and their mean."""
    map_nets.require_torch()
    each = len(map_nets.WIDTHS) * map_nets.SEEDS
    choices: dict[str, PedalChoice] = {}
    for number, pedal in enumerate(PEDALS):
        own, scales = points[pedal], map_nets.scales_of(points[pedal])
        training, held_out = hold_out(own, HELD_OUT_PARTS, 0, np.random.default_rng([seed, 10 + number]))
        candidates = []
        for one in map_nets.enumerate_widths(training, held_out, scales, seed):
            candidates.append(one)
            words = f"{pedal}: {one.net.width} hidden units, {one.held_out_mps2:.3f} m/s² on held-out cells"
            yield Step(number * each + len(candidates), each * len(PEDALS), words)
        best, error = map_nets.chosen(candidates, held_out)
        final = [map_nets.train(own, None, scales, one.net.width, one.seed, max(one.rounds, 1)) for one in best]
        by_width = {
            width: tuple(one.held_out_mps2 for one in candidates if one.net.width == width) for width in map_nets.WIDTHS
        }
        nets = [one.net for one in final if one.whole] or [one.net for one in best]
        whole = all(one.whole for one in (*candidates, *final))
        choices[pedal] = PedalChoice(merged(nets), best[0].net.width, error, by_width, own, whole)
    return choices


def finished(steps: Generator[Step, None, Result]) -> Result:
    """What a generator returns, its steps unseen."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def _require_cells(points: Points, edges: Edges, pedal: str) -> None:
    means = means_of(points)
    speeds = len(np.unique(np.searchsorted(edges.speed_mps, means.speed_mps, side="right")))
    if len(means.cell) >= LEAST_CELLS and speeds >= LEAST_SPEED_CELLS:
        return
    known = f"{len(means.cell)} combinations of speed and command, at {speeds} speeds"
    raise InputError(
        f"the {pedal} was tried in too few ways: {known}",
        code="one_speed_only" if speeds < LEAST_SPEED_CELLS else "too_few_cells",
        key="LOG",
        hint=f"at least {LEAST_CELLS} combinations at {LEAST_SPEED_CELLS} speeds; `collect` drives what is missing",
    )
