"""The open-loop map from drives (paper II.B): samples with the delay encoded, two nets, a table to be read backwards.

samples = ...samples_of(tracks, delays, vehicle)
learned = yield from learn_map(samples, vehicle, seed=1)      # Steps on the way

The open-loop map of a model, made by driving it with held pedals: triples (speed, acceleration, command).

For each speed and pedal duty the model is put on a level, straight road at that speed and the rate of its speed is
read off, thinned to where a command makes a difference. Standstill itself is left out: there a brake shows nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.open_loop_map import KEYS
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.open_loop_map.cells import Edges, Points, edges_of, hold_out, means_of, points_of, populated
from tunefree_hil.learn.open_loop_map.samples import PEDALS, Delay, Samples, find_delay, samples_of, tracks_of
from tunefree_hil.learn.open_loop_map.table import MapGrid, MapTable, PedalNet, grid_of, merged, table_of
from tunefree_hil.learn.training import map_nets
from tunefree_hil.plant.actuation.actuators import ActuatorParams, shaped
from tunefree_hil.plant.types import Plant
from tunefree_hil.plant.vehicle import steady_accel

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


SPEEDS_MPS = (0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0)
SPEEDS_MPS += (12.0, 14.0, 16.0, 18.0, 20.0, 22.5, 25.0, 27.5, 30.0)
FINE_STEPS = 16  # of duty 0.005 from rest, where the pedals begin to bite
FINE_FRAC, COARSE_FRAC = 0.005, 0.02
LEAST_STEP_MPS2 = 0.005  # points closer than this say the same

Triple = tuple[float, float, float]
AccelOf = Callable[[float, float, float], float]  # (speed, throttle duty, brake duty) -> m/s2


class Pedal(NamedTuple):
    """Duty at rest and the most that the vehicle takes."""

    rest_frac: float
    limit_frac: float

    def duties(self) -> list[float]:
        """From rest to the limit: fine steps first."""
        fine = [self.rest_frac + FINE_FRAC * i for i in range(FINE_STEPS)]
        start = fine[-1] + COARSE_FRAC
        coarse = [start + COARSE_FRAC * i for i in range(round((self.limit_frac - start) / COARSE_FRAC))]
        return [duty for duty in fine + coarse if duty < self.limit_frac - 1e-9] + [self.limit_frac]


def sweep(accel_of: AccelOf, throttle: Pedal, brake: Pedal, speeds: Sequence[float] = SPEEDS_MPS) -> list[Triple]:
    """The triples, by speed and then by acceleration; brake commands are negative.

    Between the last brake duty that does nothing and the last throttle duty that does nothing the acceleration is that
    of coasting; the map has both, a hair apart, so that neither pedal's dead band is interpolated away.
    """
    triples = []
    for speed in speeds:
        braking = _biting([(accel_of(speed, throttle.rest_frac, duty), -duty) for duty in brake.duties()], -1.0)
        pushing = _biting([(accel_of(speed, duty, brake.rest_frac), duty) for duty in throttle.duties()], 1.0)
        coasting = braking[0][0]
        braking[0] = (coasting - 0.5 * LEAST_STEP_MPS2, braking[0][1])
        triples += [(speed, accel, command) for accel, command in reversed(braking)]
        triples += [(speed, accel, command) for accel, command in pushing]
    return triples


def _biting(points: list[tuple[float, float]], sign: float) -> list[tuple[float, float]]:
    """(acceleration, command) points from the last that does as little as the first, each LEAST_STEP further."""
    first = points[0][0]
    idle = [point for point in points if sign * (point[0] - first) < LEAST_STEP_MPS2]
    kept = [(first, idle[-1][1])]
    for accel, command in points:
        if sign * (accel - kept[-1][0]) >= LEAST_STEP_MPS2:
            kept.append((accel, command))
    return kept


def open_loop_map(
    plant: Plant,
    params: Mapping[str, float],
    vehicle: VehicleSpec,
    actuators: Mapping[str, ActuatorParams] | None = None,
) -> list[Triple]:
    """The triples of a plant whose steady acceleration needs no settling.

    actuators: 'throttle', 'brake'; the map's commands are then theirs, through dead band, gain and offset. None: the
    commands are what the plant feels.
    """
    channels = actuators or {}

    def felt(channel: str, duty: float) -> float:
        return float(shaped(channels[channel], duty)) if channel in channels else duty

    def accel_of(speed_mps: float, throttle_frac: float, brake_frac: float) -> float:
        pedals = felt("throttle", throttle_frac), felt("brake", brake_frac)
        return steady_accel(plant, params, speed_mps, *pedals)

    rest_frac = vehicle.nominal.rest_pedal_frac
    return sweep(accel_of, Pedal(rest_frac, vehicle.limits.throttle_frac), Pedal(rest_frac, vehicle.limits.brake_frac))


def as_arrays(triples: Sequence[Triple]) -> dict[str, np.ndarray]:
    """The arrays of calibration.npz."""
    return dict(zip(KEYS, np.array(triples, dtype=np.float64).T, strict=True))
