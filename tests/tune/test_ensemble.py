"""The cars of an ensemble, its scores, which candidates are dropped, and the choice among near-equal trials."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.grade.margins import NOMINAL
from tunefree_hil.grade.score import ScenarioGrade, combine_scores
from tunefree_hil.tune.ensemble import (
    CARS,
    CarRanges,
    FactorRange,
    HeldOutCriteria,
    HeldOutScore,
    Judgement,
    combine_ensemble,
    count_drives,
    draw_cars,
    find_near_equal,
    is_dropped,
    noise_seed,
    nominal_drives,
    nominal_score,
    order_roads,
    rank_by_held_out,
    summarise_cars,
    tail_mean,
    with_drives_over_bus,
    worst_of_cars,
)
from tunefree_hil.tune.journal import slot_key
from tunefree_hil.tune.trial import Trial

RANGES = CarRanges(
    {"mass": FactorRange(0.9, 1.2), "lag": FactorRange(0.8, 1.2)}, {"steer.gain": FactorRange(0.98, 1.02)}
)


def graded(
    road: str, score: float, outcome: str = "finished", samples: int = 100, replans: int = 0, **values: float | None
) -> ScenarioGrade:
    return ScenarioGrade(road, score, {}, replans, outcome, samples, requirements=values)


def trial(slot: int, score: float, violation: float = 0.0) -> Trial:
    return Trial(slot, slot, {}, score, {}, violation=violation)


@given(st.integers(2, 12), st.integers(0, 2**32 - 1))
def test_cars_fill_their_ranges_evenly(count: int, seed: int) -> None:
    cars = draw_cars(RANGES, count, seed)
    assert cars == draw_cars(RANGES, count, seed)
    assert [car.number for car in cars] == list(range(count))
    assert cars[0].variant == NOMINAL and not cars[0].numbers
    others = cars[1:]
    for values, span in (
        ([car.variant.mass for car in others], RANGES.variant["mass"]),
        ([car.variant.lag for car in others], RANGES.variant["lag"]),
        ([car.numbers["steer.gain"] for car in others], RANGES.numbers["steer.gain"]),
    ):
        parts = [math.floor((value - span.low) / (span.high - span.low) * len(others)) for value in values]
        assert sorted(parts) == list(range(len(others))), "one in each part: a Latin hypercube"
    assert all(car.variant.friction == 1.0 for car in cars)


def test_another_seed_gives_other_cars() -> None:
    assert draw_cars(RANGES, 4, 1)[1:] != draw_cars(RANGES, 4, 2)[1:]


def test_noise_is_the_roads_own_for_the_model_and_another_for_each_car() -> None:
    cars = draw_cars(RANGES, 4, 1)
    seeds = [noise_seed(7, car) for car in cars]
    assert seeds[0] == 7 and len(set(seeds)) == 4 and all(0 <= seed < 2**32 for seed in seeds)
    assert seeds == [noise_seed(7, car) for car in draw_cars(RANGES, 4, 9)], "the same noise for all candidates"


@given(st.lists(st.floats(0.0, 10.0), min_size=1, max_size=40), st.floats(0.01, 1.0))
def test_the_tail_is_the_mean_of_the_worst(scores: list[float], share: float) -> None:
    tail = tail_mean(scores, share)
    assert np.mean(scores) - 1e-9 <= tail <= max(scores) + 1e-9
    assert tail_mean(scores, 1.0) == pytest.approx(np.mean(scores))


def test_the_score_is_mean_or_mean_and_tail() -> None:
    grades = [graded("a", score) for score in (0.1, 0.2, 0.3, 0.4, 1.0)]
    mean = combine_scores(grades)
    assert combine_ensemble(grades, Judgement("mean", 0.2)) == mean
    assert combine_ensemble(grades, Judgement("constraint", 0.2)) == mean
    assert combine_ensemble(grades, Judgement("tail", 0.2)) == pytest.approx(0.5 * (0.4 + 1.0))
    assert combine_ensemble(grades, Judgement("tail", 0.4)) == pytest.approx(0.5 * (0.4 + 0.7))


def test_roads_that_tell_sets_apart_come_first() -> None:
    scores = {"calm": (0.2, 0.2), "sharp": (0.1, 0.9), "long": (2.0, 2.2), "alone": (3.0,)}
    assert order_roads(["alone", "calm", "long", "sharp"], scores) == ["sharp", "long", "alone", "calm"]
    assert order_roads(["b", "a"], {}) == ["b", "a"]


def test_who_fails_or_is_far_beyond_is_dropped() -> None:
    good, lost = {"a": {"outcome": "finished"}}, {"a": {"outcome": "finished"}, "b": {"outcome": "left_lane"}}
    assert not is_dropped(good, 0.5, 0.5) and is_dropped(good, 0.51, 0.5) and is_dropped(lost, 0.0, 0.5)


def test_the_worst_of_the_cars_is_judged_like_a_drive() -> None:
    entry = worst_of_cars(
        [
            graded("a", 0.2, steer=0.1, lateral=None),
            graded("a", 0.9, "left_lane", replans=2, steer=0.3, lateral=None),
            graded("a", 0.3, steer=0.2, lateral=None),
        ]
    )
    assert entry["outcome"] == "left_lane" and entry["replans"] == 2 and entry["score"] == 0.9
    assert entry["requirements"] == {"lateral": None, "steer": 0.3}
    assert entry["planned_samples"] == 0, "it has no share in a score"


def ensemble_scenarios() -> dict[str, dict]:
    nominal = {"a": graded("a", 0.2, samples=300), "b": graded("b", 0.4, samples=100)}
    scenarios = {
        name: grade.as_data() | {CARS: summarise_cars([graded(name, 1.0), graded(name, 3.0)], 3)}
        for name, grade in nominal.items()
    }
    worst = worst_of_cars([graded("a", 3.0)])
    return {**scenarios, worst["scenario"]: worst}


def test_the_drives_of_the_model_are_as_without_an_ensemble() -> None:
    nominal = [graded("a", 0.2, samples=300), graded("b", 0.4, samples=100)]
    scenarios = ensemble_scenarios()
    assert nominal_drives(scenarios) == {grade.scenario: grade.as_data() for grade in nominal}
    assert nominal_score(2.5, scenarios) == combine_scores(nominal)
    plain = nominal_drives(scenarios)
    assert nominal_score(2.5, plain) == 2.5, "without an ensemble the score is the evaluation's"
    over_bus = {name: {**drive, "frame_hash": "x"} for name, drive in plain.items()}
    merged = with_drives_over_bus(scenarios, over_bus)
    assert nominal_drives(merged) == over_bus and merged["a"][CARS] == scenarios["a"][CARS]
    assert set(merged) == set(scenarios)


def test_the_cost_says_what_racing_saved() -> None:
    full, dropped = ensemble_scenarios(), {"a": graded("a", 5.0).as_data() | {CARS: summarise_cars([], 1)}}
    assert count_drives([full, dropped, full], 6) == (13, 5, 1)


def test_near_equal_trials_are_the_best_and_those_that_are_nearly_as_good() -> None:
    ranked = [trial(4, 1.0), trial(2, 1.04), trial(3, 1.06), trial(1, 1.01, violation=0.1), trial(5, 1.05)]
    assert [one.slot for one in find_near_equal(ranked)] == [4, 2, 5]
    assert [one.slot for one in find_near_equal(ranked, HeldOutCriteria(max_trials=2))] == [4, 2]
    assert find_near_equal([]) == []


def test_held_out_roads_choose_among_them() -> None:
    ranked = [trial(4, 1.0), trial(2, 1.04), trial(5, 1.05), trial(3, 2.0)]
    held_out = {
        slot_key(4): HeldOutScore(0.2, 0.5),
        slot_key(2): HeldOutScore(0.0, 0.9),
        slot_key(5): HeldOutScore(0.0, 0.8),
    }
    assert [one.slot for one in rank_by_held_out(ranked, held_out)] == [5, 2, 4, 3], "requirements first, then score"
    assert rank_by_held_out(ranked, {}) == ranked
    assert [one.slot for one in rank_by_held_out(ranked[:2], held_out)] == [2, 4], "of some trials alone too"
