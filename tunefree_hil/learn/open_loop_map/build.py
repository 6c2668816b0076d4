"""The open-loop map (Baidu paper, section II.B), from drives or from a model.

    gathered = gather_samples(drives, vehicle)
    learned = yield from learn_map(gathered.samples, vehicle, seed=1)

From drives: samples with the delay encoded, a net for each pedal, a table to be inverted. From a model: its steady
acceleration at held pedals on a level, straight road. Standstill is left out, since a brake has no effect there.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.open_loop_map import KEYS
from tunefree_hil.config.schema import VehicleSpec
from tunefree_hil.learn.drives.drive import Drive
from tunefree_hil.learn.open_loop_map.cells import (
    CellEdges,
    CellPoints,
    assign_cells,
    average_cells,
    find_populated_cells,
    make_cell_edges,
    split_holdout,
)
from tunefree_hil.learn.open_loop_map.samples import (
    PEDALS,
    ActuationDelay,
    MapSamples,
    find_pedal_range,
    identify_delay,
    make_pedal_tracks,
    make_samples,
)
from tunefree_hil.learn.open_loop_map.table import (
    MIN_ACCEL_STEP_MPS2,
    MapGrid,
    MapPoint,
    MapTable,
    PedalNet,
    average_nets,
    make_grid,
    skip_dead_band,
    table_from_grid,
)
from tunefree_hil.learn.training import map_nets
from tunefree_hil.plant.actuation.actuators import ActuatorParams, shaped
from tunefree_hil.plant.types import Plant
from tunefree_hil.plant.vehicle import steady_accel

N_HOLDOUT_PARTS = 5  # a fifth of the cells selects the width and stops the training
MIN_CELLS, MIN_SPEED_CELLS = 12, 3  # of a pedal: fewer do not determine a net

SWEEP_SPEEDS_MPS = (0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0)
SWEEP_SPEEDS_MPS += (12.0, 14.0, 16.0, 18.0, 20.0, 22.5, 25.0, 27.5, 30.0)
N_FINE_STEPS = 16  # from rest on, where the pedals begin to act
FINE_FRAC, COARSE_FRAC = 0.005, 0.02

SteadyAccel = Callable[[float, float, float], float]  # (speed, throttle duty, brake duty) -> m/s2


class MapProgress(NamedTuple):
    """Progress of the training: nets done and in all, and a message."""

    done: int
    total: int
    message: str


class PedalSelection(NamedTuple):
    """The net of a pedal, the mean over seeds at the selected width.

    Attributes:
        width: Hidden units of each seed's net.
        held_out_mps2: RMS over held-out cells.
        by_width: The same of each seed's net, by width.
        is_complete: False: a training diverged to values that are not finite, and was stopped.
    """

    net: PedalNet
    width: int
    held_out_mps2: float
    by_width: Mapping[int, tuple[float, ...]]
    points: CellPoints
    is_complete: bool


class LearnedMap(NamedTuple):
    """The table, its grid, and the nets by pedal."""

    table: MapTable
    grid: MapGrid
    selections: Mapping[str, PedalSelection]


class GatheredSamples(NamedTuple):
    """Samples of drives, delays by pedal, and notes."""

    samples: MapSamples
    delays: Mapping[str, ActuationDelay]
    notes: list[str]


class MapTriple(NamedTuple):
    """A point of the open-loop map; brake commands are negative."""

    speed_mps: float
    accel_mps2: float
    command_frac: float


def gather_samples(drives: Sequence[Drive], vehicle: VehicleSpec) -> GatheredSamples:
    """The samples of drives, each pedal with its delay.

    Raises:
        InputError: The drives lack a signal, or enough use of the pedals.
    """
    tracks, notes = make_pedal_tracks(drives, vehicle)
    delays = {pedal: identify_delay(tracks, pedal, vehicle) for pedal in PEDALS}
    samples = make_samples(tracks, delays, vehicle)
    notes = [*notes, *(delay.note for delay in delays.values() if delay.is_identified)]
    return GatheredSamples(samples, delays, notes)


def learn_map(samples: MapSamples, vehicle: VehicleSpec, seed: int) -> Generator[MapProgress, None, LearnedMap]:
    """Train both nets and make the table.

    Raises:
        InputError: torch is missing, or too few cells have data.
    """
    edges = {pedal: make_cell_edges(vehicle, pedal) for pedal in PEDALS}
    points = select_points(samples, edges, seed)
    selections = yield from train_nets(points, seed)
    return make_map(selections, edges)


def make_map(selections: Mapping[str, PedalSelection], edges: Mapping[str, CellEdges]) -> LearnedMap:
    """The table of two trained nets, over the region of their points."""
    points = {pedal: selection.points for pedal, selection in selections.items()}
    grid = make_grid(
        {pedal: selection.net.predict_acceleration for pedal, selection in selections.items()},
        {pedal: find_populated_cells(points[pedal], edges[pedal]) for pedal in PEDALS},
        edges,
        {
            pedal: np.array([np.min(pedal_points.accel_mps2), np.max(pedal_points.accel_mps2)])
            for pedal, pedal_points in points.items()
        },
    )
    return LearnedMap(table_from_grid(grid), grid, selections)


def select_points(samples: MapSamples, edges: Mapping[str, CellEdges], seed: int) -> dict[str, CellPoints]:
    """The points of each pedal in their cells.

    Raises:
        InputError: A pedal has too few cells with data.
    """
    selected = {}
    for number, pedal in enumerate(PEDALS):
        points = assign_cells(samples.select_pedal(pedal), edges[pedal], np.random.default_rng([seed, number]))
        require_enough_cells(points, edges[pedal], pedal)
        selected[pedal] = points
    return selected


def train_nets(points: Mapping[str, CellPoints], seed: int) -> Generator[MapProgress, None, dict[str, PedalSelection]]:
    """Train both nets: the width is selected on held-out cells; its seeds are then trained on all and averaged."""
    map_nets.import_torch()
    per_pedal = len(map_nets.HIDDEN_WIDTHS) * map_nets.N_SEEDS
    selections: dict[str, PedalSelection] = {}
    for number, pedal in enumerate(PEDALS):
        scales = map_nets.scales_from_points(points[pedal])
        rng = np.random.default_rng([seed, 10 + number])
        training, held_out = split_holdout(points[pedal], N_HOLDOUT_PARTS, 0, rng)
        candidates = []
        for candidate in map_nets.train_all_widths(map_nets.MapNetData(training, held_out, scales), seed):
            candidates.append(candidate)
            error = f"{candidate.held_out_mps2:.3f} m/s² on held-out cells"
            message = f"{pedal}: {candidate.net.width} hidden units, {error}"
            yield MapProgress(number * per_pedal + len(candidates), per_pedal * len(PEDALS), message)
        selections[pedal] = _select_pedal_net(points[pedal], held_out, scales, candidates)
    return selections


def _select_pedal_net(
    points: CellPoints,
    held_out: CellPoints,
    scales: map_nets.MapNetScales,
    candidates: Sequence[map_nets.TrainedMapNet],
) -> PedalSelection:
    best, error = map_nets.select_width(candidates, held_out)
    width = best[0].net.width
    data = map_nets.MapNetData(points, None, scales)
    final = [map_nets.train_map_net(data, width, net.seed, max(net.rounds, 1)) for net in best]
    by_width = {
        hidden: tuple(net.held_out_mps2 for net in candidates if net.net.width == hidden)
        for hidden in map_nets.HIDDEN_WIDTHS
    }
    nets = [trained.net for trained in final if trained.is_complete] or [trained.net for trained in best]
    is_complete = all(trained.is_complete for trained in (*candidates, *final))
    return PedalSelection(average_nets(nets), width, error, by_width, points, is_complete)


def require_enough_cells(points: CellPoints, edges: CellEdges, pedal: str) -> None:
    """Raise InputError where too few cells of a pedal have data."""
    means = average_cells(points)
    speeds = len(np.unique(np.searchsorted(edges.speed_mps, means.speed_mps, side="right")))
    if len(means.cell) >= MIN_CELLS and speeds >= MIN_SPEED_CELLS:
        return
    known = f"{len(means.cell)} combinations of speed and command, at {speeds} speeds"
    raise InputError(
        f"the {pedal} was used in too few ways: {known}",
        code="one_speed_only" if speeds < MIN_SPEED_CELLS else "too_few_cells",
        key="LOG",
        hint=f"at least {MIN_CELLS} combinations at {MIN_SPEED_CELLS} speeds; `collect` drives what is missing",
    )


class PedalRange(NamedTuple):
    """Duty at rest, and limit."""

    rest_frac: float
    limit_frac: float

    def duties(self) -> list[float]:
        """From rest to the limit, in fine steps first."""
        fine = [self.rest_frac + FINE_FRAC * i for i in range(N_FINE_STEPS)]
        start = fine[-1] + COARSE_FRAC
        coarse = [start + COARSE_FRAC * i for i in range(round((self.limit_frac - start) / COARSE_FRAC))]
        return [duty for duty in fine + coarse if duty < self.limit_frac - 1e-9] + [self.limit_frac]


def sweep_pedals(
    steady_accel_law: SteadyAccel, throttle: PedalRange, brake: PedalRange, speeds: Sequence[float] = SWEEP_SPEEDS_MPS
) -> list[MapTriple]:
    """The triples of a steady acceleration law, by speed and then by acceleration.

    Coasting appears twice, slightly apart: with the end of the brake's dead band and with that of the throttle's, so
    that both are exact in the look-up.
    """
    triples = []
    for speed in speeds:
        brakes = [MapPoint(steady_accel_law(speed, throttle.rest_frac, duty), -duty) for duty in brake.duties()]
        throttles = [MapPoint(steady_accel_law(speed, duty, brake.rest_frac), duty) for duty in throttle.duties()]
        brakes, throttles = (
            skip_dead_band(brakes, -1.0, MIN_ACCEL_STEP_MPS2),
            skip_dead_band(throttles, 1.0, MIN_ACCEL_STEP_MPS2),
        )
        brakes[0] = brakes[0]._replace(accel_mps2=brakes[0].accel_mps2 - 0.5 * MIN_ACCEL_STEP_MPS2)
        triples += [MapTriple(speed, point.accel_mps2, point.command_frac) for point in (*brakes[::-1], *throttles)]
    return triples


def sample_plant_map(
    plant: Plant,
    params: Mapping[str, float],
    vehicle: VehicleSpec,
    actuators: Mapping[str, ActuatorParams] | None = None,
) -> list[MapTriple]:
    """The triples of a plant with a steady acceleration as a formula.

    Args:
        plant: The plant.
        params: [plant.params].
        vehicle: Vehicle folder.
        actuators: By 'throttle' and 'brake': commands pass their dead band, gain and offset. None: the commands act
            on the plant directly.
    """
    channels = actuators or {}

    def applied(channel: str, duty: float) -> float:
        return float(shaped(channels[channel], duty)) if channel in channels else duty

    def steady_accel_law(speed_mps: float, throttle_frac: float, brake_frac: float) -> float:
        pedals = applied("throttle", throttle_frac), applied("brake", brake_frac)
        return steady_accel(plant, params, speed_mps, *pedals)

    throttle, brake = (PedalRange(*find_pedal_range(vehicle, pedal)) for pedal in PEDALS)
    return sweep_pedals(steady_accel_law, throttle, brake)


def arrays_from_triples(triples: Sequence[MapTriple]) -> dict[str, np.ndarray]:
    """The arrays of calibration.npz."""
    return dict(zip(KEYS, np.array(triples, dtype=np.float64).T, strict=True))
