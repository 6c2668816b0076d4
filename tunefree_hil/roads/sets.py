"""Sets of roads for a vehicle: the families by a covering design, the public ones, many for robustness.

A set follows from vehicle, name, number and seed alone: every process makes the same roads with the same hashes.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from random import Random

from tunefree_hil.config.check import parse_road_set
from tunefree_hil.config.schema import RoadsSpec, ScenarioSpec, VehicleSpec, with_source
from tunefree_hil.roads.design import PlannedRoad, plan_roads
from tunefree_hil.roads.drive_ability import DriveAbility
from tunefree_hil.roads.families import FAMILIES
from tunefree_hil.roads.generation import RoadLabel, make_road, scenario_text
from tunefree_hil.roads.limits import RoadLimits, road_limits
from tunefree_hil.roads.public_roads import plan_public_roads

PUBLIC = "public229"
TAGS = {"families": "s", PUBLIC: "p", "robust": "r"}  # before the seed in the names of the roads
VERIFY_SEEDS = 10_000  # a verification's seed lies so much above that of its search; seeds of bench files lie below
HELD_OUT_SEEDS = 20_000  # the same of the roads that choose among trials


def road_set(
    vehicle: VehicleSpec, name: str, count: int, seed: int, *, offsets: bool = True, drive: DriveAbility | None = None
) -> list[ScenarioSpec]:
    """The roads of a set, all within the vehicle's limits, with unique names.

    Args:
        name: families, public229 or robust (config/check.py).
        count: Number of roads; public229 always has 229.
        seed: Another one gives other roads; of public229 it draws starts and noise only.
        offsets: Whether vehicles start a little beside their road.
        drive: What the drive gives by speed (drive_ability.py); None: the data sheet's acceleration is all that counts.

    Raises:
        InputError: An unknown set, a count that does not fit, or a vehicle that no road fits.
    """
    chosen = parse_road_set(name if name == PUBLIC else f"{name}:{count}")
    limits = road_limits(vehicle, drive)
    planned = _plan(chosen.name, chosen.count, seed, limits)
    tag, stream = f"{TAGS[name]}{seed}", name if name == PUBLIC else f"{name} {seed}"
    return [
        make_road(family, request, limits, RoadLabel(tag, number, f"{stream} {number}"), offsets)
        for number, (family, request) in enumerate(planned, 1)
    ]


def search_roads(vehicle: VehicleSpec, roads: RoadsSpec, drive: DriveAbility | None = None) -> list[ScenarioSpec]:
    """The roads of a bench file for the search."""
    return _from_text(vehicle, roads.search, roads.seed, drive)


def verify_roads(vehicle: VehicleSpec, roads: RoadsSpec, drive: DriveAbility | None = None) -> list[ScenarioSpec]:
    """The roads of a bench file for the verification, by a seed that no search has."""
    return _from_text(vehicle, roads.verify, roads.seed + VERIFY_SEEDS, drive)


def held_out_roads(vehicle: VehicleSpec, text: str, seed: int, drive: DriveAbility | None = None) -> list[ScenarioSpec]:
    """The roads of a set that choose among the trials of a search, by a seed that no search and no verification has."""
    return _from_text(vehicle, text, seed + HELD_OUT_SEEDS, drive)


def _from_text(vehicle: VehicleSpec, text: str, seed: int, drive: DriveAbility | None) -> list[ScenarioSpec]:
    if not text:
        return []
    chosen = parse_road_set(text)
    return road_set(vehicle, chosen.name, chosen.count, seed, drive=drive)


def _plan(name: str, count: int, seed: int, limits: RoadLimits) -> list[PlannedRoad]:
    if name == PUBLIC:
        return plan_public_roads(limits)
    return plan_roads(FAMILIES, limits, count, Random(f"{name} {count} {seed}"))


def write_roads(folder: Path, specs: Iterable[ScenarioSpec]) -> list[ScenarioSpec]:
    """Write made roads as scenario files NAME.toml; they load back equal to the returned ones, which have the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for spec in specs:
        path = folder / f"{spec.name}.toml"
        part = path.with_suffix(".part")
        part.write_bytes(scenario_text(spec).encode())
        part.replace(path)
        written.append(with_source(spec, str(path), spec.hash))
    return written
