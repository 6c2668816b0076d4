"""What the drive gives by speed, from an open-loop map, and that no made road asks for more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests import other_vehicle
from tunefree_hil.base.open_loop_map import Triples
from tunefree_hil.bench import load
from tunefree_hil.config.load import load_bench, load_vehicle
from tunefree_hil.roads.check import RoadQuantity, find_excesses
from tunefree_hil.roads.draft import RoadDraft
from tunefree_hil.roads.drive_ability import CRITERIA, DriveAbility, ability_from_map
from tunefree_hil.roads.limits import road_limits
from tunefree_hil.roads.sets import road_set

REST = 0.15
# At 10 m/s full throttle gives 2 m/s2 and the coasting vehicle loses 0.2; at standstill 2 and 0.
MAP = Triples([0.0, 0.0, 0.0, 10.0, 10.0, 10.0], [-3.0, 0.0, 2.0, -3.0, -0.2, 2.0], [-0.5, 0.15, 0.8, -0.5, 0.15, 0.8])


def test_beyond_the_map_power_is_constant_and_drag_grows_with_the_square():
    ability = ability_from_map(MAP, REST)
    at = dict(zip(ability.speed_mps, ability.accel_mps2, strict=True))
    assert at[0.0] == at[10.0] == 2.0
    assert at[20.0] == pytest.approx(2.2 / 2.0 - 0.2 * 4.0)
    assert ability.accel_at_mps2(5.0) == pytest.approx(0.7 * 2.0)


def test_the_top_speed_is_where_nearly_nothing_is_left():
    ability = ability_from_map(MAP, REST)
    top = ability.top_speed_mps()
    assert ability.accel_at_mps2(top) >= CRITERIA.min_accel_mps2 > ability.accel_at_mps2(top + 0.5)
    assert DriveAbility((0.0, 10.0), (-1.0, -1.0)).top_speed_mps() == 0.0


def test_a_weak_drive_gets_slower_roads_within_what_it_gives():
    vehicle = load_vehicle(other_vehicle.FIRST)
    weak = DriveAbility((0.0, 8.0, 16.0), (1.0, 1.0, 0.0))
    roads = road_set(vehicle, "families", 12, 3, drive=weak)
    assert max(max(road.speed.value) for road in roads) <= weak.top_speed_mps() < 16.0
    for road in roads:
        rates = np.diff(road.speed.value) / np.diff(road.speed.t_s)
        middle = 0.5 * (np.asarray(road.speed.value)[1:] + np.asarray(road.speed.value)[:-1])
        assert np.all(rates <= np.asarray(weak.accel_at_mps2(middle)) + 0.02)


def test_asking_for_more_than_the_drive_gives_is_found():
    limits = road_limits(load_vehicle(other_vehicle.FIRST), DriveAbility((0.0, 30.0), (0.5, 0.5)))
    draft = RoadDraft(np.linspace(5.0, 20.0, 201), np.zeros(201), "")
    assert RoadQuantity.ACCEL in {excess.quantity for excess in find_excesses(draft, limits)}


BENCHES_WITH_ROADS = [path for path in sorted(Path("bench_configs").glob("*.toml")) if load_bench(path).roads]


@pytest.mark.parametrize("path", BENCHES_WITH_ROADS, ids=lambda path: path.stem)
def test_the_roads_of_a_bench_file_are_feasible(path):
    bench = load(path)
    assert len(bench.spec.scenarios) == 16 and len(bench.spec.verify_scenarios) == 20
    for scenario in bench.scenarios.values():
        assert bench.course(scenario).ticks > 1000
