"""Suggestions are a pure function, stay in the box, keep apart, and get better than chance."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tune.drive_study import SPACE, Parameter
from tests.tune.sampler_cases import CASES, FAST, INSTALLED
from tunefree_hil.base.errors import InputError
from tunefree_hil.tune.sampling import (
    SAMPLERS,
    ScoredPoint,
    derive_slot_seed,
    sampler_value_from_score,
    suggest_point,
    suggest_points,
)
from tunefree_hil.tune.sampling.points import to_unit
from tunefree_hil.tune.space import Space, make_space

BOX = make_space([Parameter(f"p{i}", 0.01, 1.0) for i in range(4)])
PARAMETERS = {
    "log": Parameter("log", 0.01, 1.0),
    "linear": Parameter("linear", -1.0, 2.0, "linear"),
    "steps": Parameter("steps", 0.0, 1.0, "linear", step=0.25),
    "switch": Parameter("switch", 0.0, 1.0, "linear", choices=(0.0, 1.0)),
    "choices": Parameter("choices", 1.0, 7.0, "linear", choices=(1.0, 2.0, 7.0)),
}
MIXED = make_space(PARAMETERS.values())
SPACES = {"mixed": MIXED, **{name: make_space([parameter]) for name, parameter in PARAMETERS.items()}}
APART = 0.01  # in the unit box of four parameters, whose diagonal is 2


def history(space: Space, length: int, score: Any = lambda values: sum(values)) -> list[ScoredPoint]:
    """Random trials, which hold every kind of value."""
    told = []
    for slot in range(length):
        values = suggest_point(space, [], sampler="random", seed=99, slot=slot)
        told.append(ScoredPoint(values, score(values.values())))
    return told


@pytest.mark.parametrize("sampler", FAST)
@settings(max_examples=15)
@given(seed=st.integers(0, 2**40), length=st.integers(0, 25), slot=st.integers(0, 1000))
def test_every_sampler_stays_in_the_box(sampler: str, seed: int, length: int, slot: int) -> None:
    asked = suggest_point(SPACE, history(SPACE, length), sampler=sampler, seed=seed, slot=slot)
    assert tuple(asked) == SPACE.names
    assert SPACE.clip(asked) == asked  # inside, on the grid, and binary32


@pytest.mark.parametrize("sampler", CASES)
@pytest.mark.parametrize("shape", SPACES)
def test_a_batch_is_in_the_box_whatever_axes_it_has(sampler: str, shape: str) -> None:
    """Logarithmic, linear, stepped, a switch, several choices, and each of them alone; with limits that are broken."""
    space = SPACES[shape]
    points = [point._replace(violation=0.1 * (k % 3)) for k, point in enumerate(history(space, 14))]
    asked = suggest_points(space, points, sampler=sampler, seed=2, slots=[14, 15], pending=[points[3].parameters])
    for values in asked:
        assert tuple(values) == space.names and space.clip(values) == values
        assert all(values[axis.name] in axis.grid for axis in space.axes if axis.grid)


@pytest.mark.slow
@pytest.mark.parametrize("sampler", [name for name in INSTALLED if name not in FAST])
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 2**40), length=st.integers(8, 20), slot=st.integers(0, 1000), equal=st.booleans())
def test_a_gaussian_process_stays_in_the_box(sampler: str, seed: int, length: int, slot: int, equal: bool) -> None:
    """Also where all scores are the same."""
    points = history(MIXED, length, (lambda _: 1.0) if equal else sum)
    asked = suggest_point(MIXED, points, sampler=sampler, seed=seed, slot=slot)
    assert tuple(asked) == MIXED.names and MIXED.clip(asked) == asked


@pytest.mark.parametrize("sampler", CASES)
def test_a_suggestion_is_a_function_of_its_arguments(sampler: str) -> None:
    points = history(SPACE, 20)
    asked = [suggest_point(SPACE, points, sampler=sampler, seed=1, slot=20) for _ in range(2)]
    others = [suggest_point(SPACE, points, sampler=sampler, seed=seed, slot=slot) for seed, slot in ((1, 21), (2, 20))]
    assert asked[0] == asked[1]
    if sampler == "cma":  # draws in the order of the finished trials, whatever the slot
        assert asked[0] == others[0] != others[1]
    elif sampler == "trust_region":  # chance has a part in the points beside its own only
        assert asked[0] == others[0] == others[1]
    else:
        assert all(asked[0] != other for other in others)


@pytest.mark.parametrize("sampler", CASES)
def test_the_first_slots_of_a_batch_do_not_depend_on_the_last(sampler: str) -> None:
    points = history(SPACE, 16)
    whole = suggest_points(SPACE, points, sampler=sampler, seed=1, slots=range(16, 20))
    assert suggest_points(SPACE, points, sampler=sampler, seed=1, slots=range(16, 18)) == whole[:2]


def smallest_distance(points: Sequence[dict[str, float]]) -> float:
    units = [to_unit(BOX, values) for values in points]
    return min(float(np.linalg.norm(one - other)) for one, other in itertools.combinations(units, 2))


@pytest.mark.parametrize("sampler", CASES)
def test_a_batch_keeps_apart(sampler: str) -> None:
    """Six points asked for together, and six asked for one after the other while the earlier ones are in flight."""
    points = [ScoredPoint(point.parameters, quadratic(point.parameters)) for point in history(BOX, 30)]
    assert smallest_distance(suggest_points(BOX, points, sampler=sampler, seed=1, slots=range(30, 36))) > APART
    waiting: list[dict[str, float]] = []
    for slot in range(30, 36):
        waiting += suggest_points(BOX, points, sampler=sampler, seed=1, slots=[slot], pending=waiting)
    assert smallest_distance(waiting) > APART


@pytest.mark.slow
@pytest.mark.parametrize("sampler", [name for name in INSTALLED if name.startswith("gp_") or name == "cma"])
def test_a_batch_that_forgets_what_is_in_flight_comes_close(sampler: str) -> None:
    """So the test above sees whether a sampler looks at it. TPE and chance differ by their seed alone."""
    points = [ScoredPoint(point.parameters, quadratic(point.parameters)) for point in history(BOX, 30)]
    forgetful = [suggest_point(BOX, points, sampler=sampler, seed=1, slot=slot) for slot in range(30, 36)]
    assert smallest_distance(forgetful) < APART


def test_tpe_knows_what_is_in_flight() -> None:
    points = history(BOX, 30)
    for sampler in ("tpe_independent", "tpe_relative"):
        alone = suggest_point(BOX, points, sampler=sampler, seed=1, slot=30)
        asked = suggest_points(BOX, points, sampler=sampler, seed=1, slots=[30], pending=[alone] * 4)
        assert asked != [alone] and smallest_distance([*asked, alone]) > APART


@pytest.mark.parametrize("sampler", ["tpe_independent", "tpe_relative"])
def test_equal_scores_are_kept_in_slot_order(sampler: str) -> None:
    """With ties, what counts as good depends on the order; the order of the slots is the one that is kept."""
    told = history(SPACE, 20, lambda _: 1.0)
    asked = suggest_point(SPACE, told, sampler=sampler, seed=1, slot=20)
    assert asked != suggest_point(SPACE, told[::-1], sampler=sampler, seed=1, slot=20)


def test_seeds_of_slots_are_unrelated() -> None:
    seeds = {derive_slot_seed(seed, slot) for seed, slot in itertools.product(range(20), range(50))}
    assert len(seeds) == 1000
    assert max(seeds) < 2**32


def test_the_logarithm_of_a_score_is_finite_and_ordered() -> None:
    assert sampler_value_from_score(math.e) == pytest.approx(1.0)
    assert math.isfinite(sampler_value_from_score(0.0))
    assert sampler_value_from_score(0.0) < sampler_value_from_score(0.01) < sampler_value_from_score(10.0)


def test_an_unknown_sampler_is_refused() -> None:
    with pytest.raises(InputError, match="no sampler 'tpe'") as caught:
        suggest_point(SPACE, [], sampler="tpe", seed=1, slot=0)
    assert all(name in caught.value.hint for name in (*SAMPLERS, "auto"))


def quadratic(values: dict[str, float]) -> float:
    """A bowl in the logarithms with its bottom off the middle; 4 parameters over two decades."""
    return 0.1 + sum((math.log10(value) + 1.4) ** 2 for value in values.values())


def lowest_found(sampler: str, seed: int, trials: int) -> float:
    space = BOX
    told: list[ScoredPoint] = []
    for slot in range(trials):
        values = suggest_point(space, told, sampler=sampler, seed=seed, slot=slot)
        told.append(ScoredPoint(values, quadratic(values)))
    return min(one.score for one in told)


@pytest.mark.slow
@pytest.mark.parametrize("sampler", ["tpe_independent", "tpe_relative"])
def test_tpe_beats_random_search(sampler: str) -> None:
    seeds, trials = range(7), 60
    by_tpe = statistics.median(lowest_found(sampler, seed, trials) for seed in seeds)
    by_chance = statistics.median(lowest_found("random", seed, trials) for seed in seeds)
    assert by_tpe < by_chance


def constrained(values: dict[str, float]) -> ScoredPoint:
    """The score falls where the requirement is violated: a value up to 0.3 is allowed, the score is 1 - it."""
    gain = values["look_ahead_m"]
    return ScoredPoint(values, 1.0 - gain, max(0.0, gain / 0.3 - 1.0))


@pytest.mark.parametrize("sampler", ["tpe_independent", "tpe_relative"])
def test_a_search_under_a_requirement_stays_where_it_is_met(sampler: str) -> None:
    """Without the constraint the same history leads beyond it, as the score is better there."""
    space = make_space([Parameter("look_ahead_m", 0.0, 1.0, "linear")])
    runs: dict[bool, list[ScoredPoint]] = {True: [], False: []}
    for is_constrained, told in runs.items():
        for slot in range(60):
            asked = suggest_point(space, told, sampler=sampler, seed=3, slot=slot)
            point = constrained(asked)
            told.append(point if is_constrained else point._replace(violation=None))
    late = {key: [point.parameters["look_ahead_m"] for point in told[30:]] for key, told in runs.items()}
    assert statistics.median(late[False]) > 0.9
    assert 0.2 < statistics.median(late[True]) < 0.35
    assert min((point for point in runs[True] if not point.violation), key=lambda point: point.score).score < 0.72


@pytest.mark.parametrize("sampler", ["tpe_independent", "tpe_relative"])
def test_requirements_that_all_trials_meet_change_no_suggestion(sampler: str) -> None:
    told = history(SPACE, 20)
    met = [point._replace(violation=0.0) for point in told]
    asked = [suggest_point(SPACE, points, sampler=sampler, seed=1, slot=20) for points in (told, met)]
    assert asked[0] == asked[1]
    violated = [point._replace(violation=point.score) for point in told[:10]] + met[10:]
    assert suggest_point(SPACE, violated, sampler=sampler, seed=1, slot=20) != asked[0]
