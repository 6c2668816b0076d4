"""What a road sweep drives: roads, cars and sets of gains, in chunks. It follows from a bench and an order alone.

Every road is driven by the nominal car and by one other car; the other cars are dealt within each family of roads, so
that a family with as many roads as cars meets all of them. All sets of gains drive the same roads, cars and noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from random import Random
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, model_of
from tunefree_hil.bench.batch import Job
from tunefree_hil.bench.load import fresh_roads_of
from tunefree_hil.config.schema import ScenarioSpec
from tunefree_hil.config.tuning.ensemble_schema import EnsembleSpec
from tunefree_hil.jobs.identity import compute_identity, data_sha256
from tunefree_hil.jobs.robustness.cars import make_cars
from tunefree_hil.jobs.robustness.driving.pack import CODE, describe_code
from tunefree_hil.jobs.tune.ensemble.cars import EnsembleCars, car_ranges
from tunefree_hil.roads.sets import PUBLIC
from tunefree_hil.tune.ensemble import EnsembleCar

SCHEMA = "tunefree.robustness/1"
SWEEP_SEEDS = 30_000  # seeds of searches, verifications and choices lie below (roads/sets.py)
# Drives of a chunk: 2.4 s of two cores with a reference vehicle at 102 drives/s (`tools/measure robustness`). A kill
# costs no more, and the first drive of a chunk, which has all threads for itself, less than 1 % of it.
CHUNK_DRIVES = 240
BUS_SEEDS = 65_536  # a seed of noise fits into EPISODE on the bus, where the worst roads are driven again


class RoadSetOrder(NamedTuple):
    """A set of made roads by name, number and seed."""

    name: str
    count: int
    seed: int


class SweepOrder(NamedTuple):
    """What to drive, as plain data beside the bench. vectors: complete sets of gains, the winner first."""

    model: str
    road_sets: tuple[RoadSetOrder, ...]
    cars: int
    seed: int
    vectors: Mapping[str, Mapping[str, float]]

    def as_data(self) -> dict[str, Any]:
        """Plain data for JSON and for a cluster; the order of the sets of gains is kept."""
        vectors = [[name, dict(values)] for name, values in self.vectors.items()]
        return {**self._asdict(), "road_sets": [list(road_set) for road_set in self.road_sets], "vectors": vectors}


class SweepRoad(NamedTuple):
    """A road and the car that drives it beside the nominal one."""

    spec: ScenarioSpec
    family: str
    other_car: int


class SweepDrive(NamedTuple):
    """One drive by its place in the plan: numbers of road, car and set of gains."""

    road: int
    car: int
    vector: int


class SweepPlan(NamedTuple):
    """All that is driven. hashes: of everything that the drives depend on; key: one hash of them."""

    bench: Bench
    order: SweepOrder
    roads: tuple[SweepRoad, ...]
    cars: tuple[EnsembleCar, ...]
    maker: EnsembleCars
    hashes: Mapping[str, Any]
    key: str

    @property
    def names(self) -> tuple[str, ...]:
        """The sets of gains, the winner first."""
        return tuple(self.order.vectors)

    @property
    def roads_per_chunk(self) -> int:
        """Roads of a chunk."""
        return max(1, CHUNK_DRIVES // (2 * len(self.names)))

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return -(-len(self.roads) // self.roads_per_chunk)

    @property
    def drives(self) -> int:
        """Number of drives."""
        return 2 * len(self.names) * len(self.roads)

    def list_drives(self, chunk: int) -> list[SweepDrive]:
        """The drives of a chunk; those of a road and a car follow one another, as they share their noise."""
        first = chunk * self.roads_per_chunk
        last = min(first + self.roads_per_chunk, len(self.roads))
        return [
            SweepDrive(road, car, vector)
            for road in range(first, last)
            for car in (0, self.roads[road].other_car)
            for vector in range(len(self.names))
        ]

    def make_job(self, drive: SweepDrive) -> Job:
        """The job of a drive, which the bus can drive too: the seed of its noise has 16 bits."""
        values = self.order.vectors[self.names[drive.vector]]
        job = self.maker.job(values, self.roads[drive.road].spec, self.cars[drive.car])
        return job if job.seed is None else job._replace(seed=job.seed % BUS_SEEDS)


def make_plan(bench: Bench, order: SweepOrder) -> SweepPlan:
    """Make roads and cars.

    Raises:
        InputError: Roads that cannot be made or that the tune has driven, a model without the cars.
    """
    specs = [road for one in order.road_sets for road in fresh_roads_of(bench, one.name, one.count, one.seed)]
    _refuse_driven_roads(bench, specs)
    ensemble = bench.spec.ensemble or EnsembleSpec()
    cars = make_cars(car_ranges(ensemble, model_of(bench, order.model)), order.cars, order.seed)
    maker = EnsembleCars(bench, ensemble, order.model, order.seed, count=2)
    identity = compute_identity(bench, order.model, specs)
    plain_cars = [[car.number, car.variant._asdict(), dict(car.numbers)] for car in cars]
    hashes = {
        CODE: describe_code(),
        **{name: value for name, value in identity["hashes"].items() if name not in ("bench", "scenarios")},
        "roads": data_sha256([road.hash for road in specs]),
        "cars": data_sha256(plain_cars),
        "controller settings and effects": identity["identity"],
    }
    key = data_sha256([SCHEMA, hashes, order.as_data(), CHUNK_DRIVES])
    return SweepPlan(bench, order, _deal_cars(specs, order), tuple(cars), maker, hashes, key)


def order_from_data(data: Mapping[str, Any]) -> SweepOrder:
    """The inverse of `SweepOrder.as_data`."""
    road_sets = tuple(RoadSetOrder(*one) for one in data["road_sets"])
    return SweepOrder(**{**data, "road_sets": road_sets, "vectors": dict(data["vectors"])})


def family_of(road: ScenarioSpec) -> str:
    """'u_turn' of 'u_turn_3mps_r30001_17' (roads/generation.py)."""
    return road.name.rsplit("_", 3)[0]


def has_known_shapes(bench: Bench, order: SweepOrder) -> bool:
    """Whether the tune drove the public roads too: their shapes do not depend on a seed."""
    roads, ensemble = bench.spec.roads, bench.spec.ensemble
    driven = [*((roads.search, roads.verify) if roads else ()), ensemble.select_roads if ensemble else ""]
    return PUBLIC in driven and any(road_set.name == PUBLIC for road_set in order.road_sets)


def _deal_cars(specs: Sequence[ScenarioSpec], order: SweepOrder) -> tuple[SweepRoad, ...]:
    """Deal the other cars to the roads: within a family each car once before one comes again."""
    chance, decks, roads = Random(f"deal {order.seed}"), dict[str, list[int]](), list[SweepRoad]()
    for spec in specs:
        family = family_of(spec)
        deck = decks.setdefault(family, [])
        if not deck:
            deck.extend(range(1, order.cars))
            chance.shuffle(deck)
        roads.append(SweepRoad(spec, family, deck.pop()))
    return tuple(roads)


def _refuse_driven_roads(bench: Bench, specs: Sequence[ScenarioSpec]) -> None:
    driven = {scenario.hash for scenario in bench.scenarios.values()}
    known = [road.name for road in specs if road.hash in driven]
    if known:
        message = f"search or verification of the run have driven {known[0]} ({len(known)} such roads)"
        raise InputError(message, code="known_roads", key="--seed", hint="take another --seed")
