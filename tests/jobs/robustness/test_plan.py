"""A plan follows from bench and order; its roads are fresh, its cars dealt, its seeds fit the bus."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.robustness.made_sweep import make_order, plan_of
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.bench.load import held_out_roads_of
from tunefree_hil.config.check import MOST_ROAD_SEED
from tunefree_hil.jobs.robustness.plan import (
    SWEEP_SEEDS,
    RoadSetOrder,
    family_of,
    has_known_shapes,
    make_plan,
    order_from_data,
)
from tunefree_hil.roads.families import FAMILIES
from tunefree_hil.roads.sets import HELD_OUT_SEEDS

ROADS = 'roads = { search = "families:12", verify = "families:12", seed = 1 }\n'


def test_the_same_order_gives_the_same_plan_and_any_other_another(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path))
    order = make_order(bench)
    plan = make_plan(bench, order)
    again = make_plan(load(write_bench(tmp_path)), order_from_data(order.as_data()))
    assert (again.key, again.roads, again.cars) == (plan.key, plan.roads, plan.cars)
    others = [
        make_order(bench, 21),
        make_order(bench, seed=2),
        make_order(bench, cars=6),
        make_order(bench, sets=3),
        order._replace(vectors={name: {**values, "station.kp": 0.3} for name, values in order.vectors.items()}),
    ]
    assert len({plan.key, *(make_plan(bench, other).key for other in others)}) == 6


def test_no_search_verification_or_choice_has_its_roads(tmp_path: Path) -> None:
    assert MOST_ROAD_SEED + HELD_OUT_SEEDS < SWEEP_SEEDS
    bench = load(write_bench(tmp_path, more=ROADS))
    plan = make_plan(bench, make_order(bench, 12))
    driven = {road.hash for road in [*bench.scenarios.values(), *held_out_roads_of(bench, "families:12")]}
    assert len(driven) == 12 + 12 + 12 + 1 and not driven & {road.spec.hash for road in plan.roads}


def test_roads_of_the_search_are_refused(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path, more=ROADS))
    searched = make_order(bench)._replace(road_sets=(RoadSetOrder("families", 12, 1),))
    with pytest.raises(InputError) as caught:
        make_plan(bench, searched)
    assert caught.value.code == "known_roads" and "--seed" in caught.value.hint


def test_public_roads_of_the_search_are_known_by_their_shapes(tmp_path: Path) -> None:
    public = RoadSetOrder("public229", 229, SWEEP_SEEDS + 1)
    bench = load(write_bench(tmp_path, more='roads = { search = "public229" }\n'))
    order = make_order(bench)
    assert not has_known_shapes(bench, order)
    assert has_known_shapes(bench, order._replace(road_sets=(*order.road_sets, public)))
    assert not has_known_shapes(load(write_bench(tmp_path)), order._replace(road_sets=(public,)))


def test_every_road_has_the_nominal_car_and_another_one_that_is_dealt_by_family(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, 170, cars=6, sets=3)
    drives = [drive for chunk in range(plan.chunks) for drive in plan.list_drives(chunk)]
    assert len(drives) == len(set(drives)) == plan.drives == 170 * 2 * 3
    assert {drive.road for drive in drives} == set(range(170))
    assert {road.family for road in plan.roads} == {family.name for family in FAMILIES}
    for family in {road.family for road in plan.roads}:
        cars = Counter(road.other_car for road in plan.roads if road.family == family)
        assert set(cars) == {1, 2, 3, 4, 5} and max(cars.values()) - min(cars.values()) <= 1
    assert [drive.car for drive in drives[:6]] == [0, 0, 0, *[plan.roads[0].other_car] * 3]


def test_all_sets_drive_with_the_same_noise_which_the_bus_can_draw_too(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, 12)
    for first, second in zip(plan.list_drives(0)[::2], plan.list_drives(0)[1::2], strict=True):
        one, other = plan.make_job(first), plan.make_job(second)
        assert one.values != other.values and one._replace(values={}) == other._replace(values={})
        assert (one.seed is None) == (first.car == 0) and (one.seed is None or 0 <= one.seed < 65_536)
        assert bool(one.effects or one.scale) == (first.car != 0)


def test_families_are_read_from_the_names(tmp_path: Path) -> None:
    names = {family_of(road.spec) for road in plan_of(tmp_path, 17).roads}
    assert names == {family.name for family in FAMILIES}
