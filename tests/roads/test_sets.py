"""Sets of roads: unique, the same in every process, spread over families and speeds, written and read back equal."""

from __future__ import annotations

import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from random import Random

import numpy as np
import pytest

from tests import other_vehicle
from tests.house import ROOT
from tunefree_hil.base.errors import InputError
from tunefree_hil.config.check import ROAD_SETS, parse_road_set
from tunefree_hil.config.load import load_scenario, load_vehicle
from tunefree_hil.config.schema import LimitsSpec, RoadsSpec, ScenarioSpec, VehicleSpec
from tunefree_hil.episode.feasible import check_feasible, limits_of
from tunefree_hil.episode.scenario import build_course
from tunefree_hil.roads import road_set, search_roads, verify_roads, write_roads
from tunefree_hil.roads.design import plan_roads
from tunefree_hil.roads.families import FAMILIES
from tunefree_hil.roads.limits import road_limits

MKZ = load_vehicle(other_vehicle.FIRST)
OTHER = load_vehicle(other_vehicle.FOLDER)
VEHICLES = (MKZ, OTHER)
LISTING = (
    "from tunefree_hil.config.load import load_vehicle; from tunefree_hil.roads import road_set; import sys; "
    "print(*[road.hash for road in road_set(load_vehicle(sys.argv[1]), 'families', 20, 5)]); "
    "print(*[name for name in ('scipy', 'numba', 'optuna') if name in sys.modules])"
)


def family_of(spec: ScenarioSpec) -> str:
    return max((f.name for f in FAMILIES if spec.name.startswith(f"{f.name}_")), key=len)


def manoeuvre_mps(spec: ScenarioSpec) -> float:
    return float(spec.name.removeprefix(family_of(spec) + "_").split("mps")[0])


@pytest.mark.parametrize("vehicle", VEHICLES, ids=lambda vehicle: vehicle.name)
@pytest.mark.parametrize("seed", range(4))
def test_twenty_roads_have_every_family_and_every_speed(vehicle: VehicleSpec, seed: int) -> None:
    roads = road_set(vehicle, "families", 20, seed)
    assert {family_of(road) for road in roads} == {family.name for family in FAMILIES}
    speeds = np.array([manoeuvre_mps(road) for road in roads])
    thirds = np.histogram(speeds, bins=3, range=(0.0, 30.0))[0]
    assert thirds.min() >= 4, thirds
    assert max(max(road.speed.value) for road in roads) >= 27.0
    assert min(min(road.speed.value) for road in roads) == 0.0


@pytest.mark.parametrize("seed", range(6))
def test_nearly_every_cell_of_speed_has_a_road(seed: int) -> None:
    """Twenty cells of 1.5 m/s; the slowest has a family only from 1 m/s on."""
    planned = plan_roads(FAMILIES, road_limits(MKZ), 20, Random(seed))
    assert len({int(road.request.speed_mps / 1.5) for road in planned}) >= 18
    assert all(road.family.low_mps <= road.request.speed_mps <= road.family.high_mps for road in planned)


def test_a_family_is_driven_at_all_its_speeds_in_the_course_of_seeds() -> None:
    turns = [
        road.request.speed_mps
        for seed in range(20)
        for road in plan_roads(FAMILIES, road_limits(MKZ), 20, Random(seed))
        if road.family.name == "turn"
    ]
    assert np.histogram(turns, bins=4, range=(3.0, 25.0))[0].min() >= 3


@pytest.mark.parametrize("seed", range(3))
def test_twelve_roads_cover_the_speeds_too(seed: int) -> None:
    speeds = np.array([manoeuvre_mps(road) for road in road_set(MKZ, "families", 12, seed)])
    assert np.histogram(speeds, bins=3, range=(0.0, 30.0))[0].min() >= 2


def test_lateral_acceleration_is_spread_over_the_speeds() -> None:
    """No third of the speeds has gentle bends only."""
    roads = [build_course(road, 0.01) for road in road_set(MKZ, "families", 60, 2)]
    for low, high in ((4.0, 10.0), (10.0, 20.0), (20.0, 30.1)):
        peaks = [
            np.max(np.square(course.speed_mps) * np.interp(course.station_m, _stations(course), _bends(course)))
            for course in roads
            if low <= max(course.speed_mps) < high
        ]
        assert max(peaks) > 2.0 and 0.0 <= min(peaks) < 1.0


def _stations(course) -> np.ndarray:
    return course.first_station_m + course.spacing_m * np.arange(len(course.path_curvature_1pm))


def _bends(course) -> np.ndarray:
    return np.abs(course.path_curvature_1pm)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["families", "public229", "robust"])
@pytest.mark.parametrize("vehicle", VEHICLES, ids=lambda vehicle: vehicle.name)
def test_the_roads_of_a_set_are_unique(vehicle: VehicleSpec, name: str) -> None:
    roads = road_set(vehicle, name, ROAD_SETS[name].usual, 7)
    assert len(roads) == ROAD_SETS[name].usual
    assert len({road.name for road in roads}) == len({road.hash for road in roads}) == len(roads)
    assert len({tuple(road.curvature.value + road.speed.value) for road in roads}) >= 0.99 * len(roads)
    assert all(0 <= road.noise_seed < 65536 for road in roads)


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", VEHICLES, ids=lambda vehicle: vehicle.name)
def test_the_public_roads_can_be_driven(vehicle: VehicleSpec) -> None:
    roads = road_set(vehicle, "public229", 229, 1, offsets=False)
    limits = limits_of(vehicle)
    assert [road.name for road in roads if check_feasible(build_course(road, 0.05), limits)] == []
    assert set(Counter(family_of(road) for road in roads)) == {family.name for family in FAMILIES}


def test_the_shapes_of_the_public_roads_do_not_depend_on_the_seed() -> None:
    first, second = (road_set(MKZ, "public229", 229, seed) for seed in (1, 2))
    assert [road.curvature for road in first] == [road.curvature for road in second]
    assert all(one.start != other.start for one, other in zip(first, second, strict=True))


def test_other_seeds_give_other_roads_and_the_same_seed_the_same() -> None:
    first, again, second = (road_set(MKZ, "families", 20, seed) for seed in (1, 1, 2))
    assert first == again
    assert not {tuple(road.speed.value) for road in first} & {tuple(road.speed.value) for road in second}


def test_search_and_verification_never_have_a_road_in_common() -> None:
    spec = RoadsSpec(search="families:20", verify="families:20", seed=3)
    searched, verified = search_roads(MKZ, spec), verify_roads(MKZ, spec)
    assert not {road.name for road in searched} & {road.name for road in verified}
    assert not {tuple(road.speed.value) for road in searched} & {tuple(road.speed.value) for road in verified}
    assert search_roads(MKZ, RoadsSpec(verify="families:20")) == []


@pytest.mark.slow
def test_every_process_makes_the_same_roads_without_heavy_libraries() -> None:
    lines = [
        subprocess.run(
            [sys.executable, "-c", LISTING, other_vehicle.FIRST], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.splitlines()
        for _ in range(2)
    ]
    assert lines[0][0].split() == lines[1][0].split() == [road.hash for road in road_set(MKZ, "families", 20, 5)]
    assert lines[0][1] == ""


def test_sixty_roads_are_made_at_once() -> None:
    begin = time.monotonic()
    road_set(MKZ, "families", 60, 9)
    assert time.monotonic() - begin < 2.0  # 0.1 s on a free core


def test_written_roads_load_back_equal(tmp_path: Path) -> None:
    roads = road_set(OTHER, "families", 20, 4)
    written = write_roads(tmp_path / "new", roads)
    for road, stored in zip(roads, written, strict=True):
        assert load_scenario(stored.path) == stored
        assert stored.hash == road.hash and stored.name == road.name
    assert not list(tmp_path.rglob("*.part"))


def test_a_road_without_offsets_starts_on_it() -> None:
    for road in road_set(MKZ, "families", 20, 1, offsets=False):
        assert (road.start.lateral_m, road.start.heading_rad) == (0.0, 0.0)
        assert road.start.speed_mps == pytest.approx(road.speed.value[0])
    starts = [road.start for road in road_set(MKZ, "families", 60, 1)]
    assert max(abs(start.lateral_m) for start in starts) > 0.15
    assert all(abs(start.heading_rad) * max(start.speed_mps, 1.0) <= 0.21 for start in starts)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("families", 20), ("families:7", 7), ("public229", 229), ("public229:229", 229), ("robust:1500", 1500)],
)
def test_names_of_sets(text: str, expected: int) -> None:
    assert parse_road_set(text).count == expected


@pytest.mark.parametrize(
    ("text", "message", "hint"),
    [
        ("familie:20", "no set of roads 'familie'", "families"),
        ("", "no set of roads ''", ""),
        ("families:0", "families has 1 to 1000 roads", "families:20"),
        ("families:", "families has", "families:20"),
        ("families:-3", "families has", "families:20"),
        ("families:2.5", "families has", "families:20"),
        ("families:²", "families has", "families:20"),
        ("robust:20", "robust has 1000 to 10000 roads", "robust:1000"),
        ("public229:30", "public229 has 229 roads", "write public229"),
    ],
)
def test_a_wrong_set_is_named_with_a_way_on(text: str, message: str, hint: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_road_set(text)
    assert message in caught.value.message and hint in caught.value.hint


def test_a_slow_vehicle_has_the_families_that_it_can_drive() -> None:
    slow = VehicleSpec(
        schema="tunefree.vehicle/1",
        name="slow",
        dbc=[],
        bitrate=500_000,
        limits=LimitsSpec(steer_rad=8.0, steer_rate_radps=8.0, throttle_frac=1.0, brake_frac=1.0, speed_mps=8.0),
    )
    roads = road_set(slow, "families", 20, 1)
    assert max(max(road.speed.value) for road in roads) <= 8.0
    assert not {"weave", "on_ramp"} & {family_of(road) for road in roads}
    with pytest.raises(InputError, match=r"no family of roads drives below 0\.5 m/s"):
        road_set(_with_speed(slow, 0.5), "families", 20, 1)


def _with_speed(vehicle: VehicleSpec, speed_mps: float) -> VehicleSpec:
    limits = LimitsSpec(steer_rad=8.0, steer_rate_radps=8.0, throttle_frac=1.0, brake_frac=1.0, speed_mps=speed_mps)
    return VehicleSpec(schema=vehicle.schema, name=vehicle.name, dbc=[], bitrate=500_000, limits=limits)
