"""CMA-ES after TPE: suggestions are a function of what is finished, stay in the box, and go along a limit."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tune.drive_study import SPACE, Parameter
from tunefree_hil.tune.sampling import TPE_CMA, ScoredPoint, suggest_point, suggest_points
from tunefree_hil.tune.sampling.cma import CRITERIA, population_size, suggest_cma_points
from tunefree_hil.tune.sampling.points import from_unit, to_unit
from tunefree_hil.tune.sampling.ranking import rank_value
from tunefree_hil.tune.space import Space, make_space

BOWL = make_space([Parameter(f"p{i}", 0.01, 1.0) for i in range(6)])
Score = Callable[[dict[str, float]], ScoredPoint]


def bowl(values: dict[str, float]) -> ScoredPoint:
    """A valley in the logarithms, 10 times as steep across the diagonals as along them."""
    logs = [math.log10(value) + 0.7 for value in values.values()]
    across = sum((logs[i] - logs[i + 1]) ** 2 for i in range(len(logs) - 1))
    return ScoredPoint(values, 0.1 + sum(value * value for value in logs) + 10.0 * across)


def beyond_a_limit(values: dict[str, float]) -> ScoredPoint:
    """The score falls towards a limit at p0 = 0.1 and beyond it."""
    point = bowl(values)
    return point._replace(score=point.score + 1.0 - values["p0"], violation=max(0.0, values["p0"] / 0.1 - 1.0))


def search(space: Space, score: Score, trials: int, sampler: str = TPE_CMA, seed: int = 3) -> list[ScoredPoint]:
    told: list[ScoredPoint] = []
    while len(told) < trials:
        slots = range(len(told), len(told) + 8)
        told += [score(values) for values in suggest_points(space, told, sampler=sampler, seed=seed, slots=slots)]
    return told


@pytest.fixture(scope="module")
def begun() -> list[ScoredPoint]:
    """The first trials, at random."""
    drawn = [suggest_point(BOWL, [], sampler="random", seed=7, slot=slot) for slot in range(CRITERIA.start_trials)]
    return [bowl(values) for values in drawn]


@given(seed=st.integers(0, 2**31), length=st.integers(0, 40), count=st.integers(1, 20))
@settings(max_examples=25, deadline=None)
def test_every_point_is_in_the_box_and_on_the_grid(seed: int, length: int, count: int) -> None:
    drawn = [suggest_point(SPACE, [], sampler="random", seed=9, slot=k) for k in range(CRITERIA.start_trials + length)]
    told = [ScoredPoint(values, sum(values.values())) for values in drawn]
    asked = suggest_cma_points(SPACE, told, seed=seed, count=count)
    assert len(asked) == count
    assert all(SPACE.clip(values) == values and tuple(values) == SPACE.names for values in asked)


@given(slot=st.integers(0, 10_000))
def test_the_unit_box_has_an_inverse(slot: int) -> None:
    values = suggest_point(SPACE, [], sampler="random", seed=1, slot=slot)
    unit = to_unit(SPACE, values)
    assert ((unit >= 0.0) & (unit <= 1.0)).all()
    assert from_unit(SPACE, unit) == pytest.approx(values, rel=1e-6)


def test_a_generation_asked_in_parts_is_the_one_asked_at_once(begun: list[ScoredPoint]) -> None:
    """What is told between the parts changes nothing before a population is complete, and something afterwards."""
    size = population_size(len(BOWL.axes))
    whole = suggest_cma_points(BOWL, begun, seed=1, count=size)
    told = [*begun, *(bowl(values) for values in whole[:-1])]
    assert suggest_cma_points(BOWL, told, seed=1, count=1) == whole[-1:]
    further = suggest_cma_points(BOWL, begun, seed=1, count=size + 1)[-1]
    assert suggest_cma_points(BOWL, [*told, bowl(whole[-1])], seed=1, count=1) != [further]


def test_seeds_differ_and_a_seed_repeats(begun: list[ScoredPoint]) -> None:
    first, again, other = (suggest_cma_points(BOWL, begun, seed=seed, count=8) for seed in (1, 1, 2))
    assert first == again != other


def test_populations_are_the_default_of_the_strategy_rounded_up() -> None:
    assert [population_size(n) for n in (1, 2, 6, 11, 15)] == [4, 8, 12, 12, 12]


@pytest.mark.parametrize("violation", [None, 0.0])
def test_without_a_violation_a_point_ranks_by_its_score(violation: float | None) -> None:
    assert rank_value(ScoredPoint({}, 0.3, violation)) == 0.3
    assert rank_value(ScoredPoint({}, 0.2, 0.2)) > 0.3 > rank_value(ScoredPoint({}, 0.2, 0.05))
    assert rank_value(ScoredPoint({}, 0.2, 100.0)) == rank_value(ScoredPoint({}, 0.2, 1e9)) < math.inf


@pytest.mark.slow
def test_it_finds_the_bottom_of_a_narrow_valley_where_tpe_does_not() -> None:
    found = {
        sampler: statistics.median(
            min(point.score for point in search(BOWL, bowl, 400, sampler, seed)) for seed in range(3)
        )
        for sampler in (TPE_CMA, "tpe_independent")
    }
    assert found[TPE_CMA] - 0.1 < 0.3 * (found["tpe_independent"] - 0.1)


def test_it_goes_along_a_limit_and_not_beyond() -> None:
    """The best point that meets the requirement lies close to it."""
    told = search(BOWL, beyond_a_limit, 300)
    best = min((point for point in told if not point.violation), key=lambda point: point.score)
    assert 0.08 < best.parameters["p0"] <= 0.1
    late = [point.parameters["p0"] for point in told[200:]]
    assert 0.05 < statistics.median(late) < 0.11


def test_a_search_that_has_converged_starts_anew_from_its_best_point(begun: list[ScoredPoint]) -> None:
    """All points the same: the spread shrinks until the strategy stops, and is then what it was at the start."""
    one, spreads = min(begun, key=rank_value), []
    for populations in (15, *range(25, 33)):
        told = [*begun, *[one] * (population_size(6) * populations)]
        asked = [to_unit(BOWL, values) for values in suggest_cma_points(BOWL, told, seed=1, count=64)]
        spreads.append(max(statistics.pstdev(float(unit[k]) for unit in asked) for k in range(6)))
    assert spreads[0] < 0.5 * CRITERIA.start_spread < max(spreads)
