"""Importance, edges and slices on functions whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tune.sampler_cases import FAST
from tunefree_hil.control.parameters import box32
from tunefree_hil.tune.insight import (
    MIN_TRIALS,
    choose_slice_points,
    compute_importance,
    describe_edges,
    find_edge,
    rank_correlation,
)
from tunefree_hil.tune.sampling import ScoredPoint, suggest_points
from tunefree_hil.tune.space import Axis, Space, resolve_space
from tunefree_hil.tune.study import Trial

LOG = Axis("a", *box32(0.01, 1.0), True)  # as every box is: rounded inward to binary32
LINEAR = Axis("b", 0.0, 2.0, False)
STEPPED = Axis("c", 0.0, 3.0, False, (0.0, 1.0, 2.0, 3.0))
SWITCH = Axis("d", 0.0, 1.0, False, (0.0, 1.0), True)
SPACE = Space((LINEAR, LOG, STEPPED, SWITCH))


def trials(n: int, seed: int = 1) -> list[Trial]:
    """a matters most, b less (larger is worse), the rest nothing."""
    chance = np.random.default_rng(seed)
    found = []
    for slot in range(n):
        values = {
            "a": LOG.clip(math.exp(chance.uniform(math.log(0.01), 0.0))),
            "b": LINEAR.clip(chance.uniform(0.0, 2.0)),
            "c": float(chance.integers(4)),
            "d": float(chance.integers(2)),
        }
        score = 0.1 + (math.log(values["a"]) + 2.0) ** 2 + 0.4 * values["b"]
        found.append(Trial(slot, slot, values, score, {}))
    return found


def test_what_matters_comes_first() -> None:
    found = compute_importance(SPACE, trials(300))
    assert next(iter(found)) == "a"
    shares = [one.share for one in found.values() if one.share is not None]
    assert len(shares) == 4 and sum(shares) == pytest.approx(1.0) and shares == sorted(shares, reverse=True)
    assert found["a"].share is not None and found["a"].share > 0.5
    assert all(one.n == 300 for one in found.values())
    assert found["b"].rank > 0.05


@pytest.mark.parametrize("score", [0.0, 1.0])
def test_equal_scores_have_no_shares(score: float) -> None:
    """Nor where nine tenths of them tie for the best place."""
    equal = [trial._replace(score=score) for trial in trials(40)]
    found = compute_importance(SPACE, equal)
    assert all(entry.share is None and entry.rank == 0.0 for entry in found.values())
    mostly = [*equal[:38], *(trial._replace(score=5.0) for trial in equal[38:])]
    assert all(entry.share is not None for entry in compute_importance(SPACE, mostly).values())


def test_what_was_not_varied_has_no_share() -> None:
    fixed = [trial._replace(parameters={**trial.parameters, "a": LOG.clip(0.1)}) for trial in trials(60)]
    found = compute_importance(SPACE, fixed)
    assert found["a"].share == 0.0 and sum(entry.share or 0.0 for entry in found.values()) == pytest.approx(1.0)


def test_values_without_an_order_have_no_trend() -> None:
    several = Space((LINEAR, Axis("e", 1.0, 7.0, False, (1.0, 2.0, 7.0), True), SWITCH))
    points = [
        trial._replace(parameters={**trial.parameters, "e": (1.0, 2.0, 7.0)[k % 3]}, score=1.0 + k % 3)
        for k, trial in enumerate(trials(60))
    ]
    found = compute_importance(several, points)
    assert found["e"].rank == 0.0 and next(iter(found)) == "e"


@pytest.mark.parametrize("sampler", FAST)
def test_trials_of_every_sampler_have_shares(sampler: str) -> None:
    """What decides is in front, whatever the sampler tries most."""
    points: list[ScoredPoint] = []
    while len(points) < 80:
        slots = range(len(points), len(points) + 8)
        for values in suggest_points(SPACE, points, sampler=sampler, seed=1, slots=slots):
            score = 0.1 + (math.log(values["a"]) + 2.0) ** 2 + values["c"]
            points.append(ScoredPoint(values, score))
    found = compute_importance(SPACE, [Trial(k, k, *point[:2], {}) for k, point in enumerate(points)])
    assert set(list(found)[:2]) == {"a", "c"} and all(entry.share is not None for entry in found.values())


def test_importance_is_a_function_of_the_trials() -> None:
    assert compute_importance(SPACE, trials(40)) == compute_importance(SPACE, trials(40))


def test_few_trials_have_ranks_only() -> None:
    found = compute_importance(SPACE, trials(MIN_TRIALS - 1))
    assert all(one.share is None and one.n == MIN_TRIALS - 1 for one in found.values())
    assert all(one.rank == 0.0 for one in compute_importance(SPACE, trials(1)).values())


@given(st.lists(st.integers(-50, 50), min_size=3, max_size=20, unique=True))
def test_ranks_know_order_only(values: list[int]) -> None:
    data = 0.1 * np.array(values)
    assert rank_correlation(data, np.exp(data)) == pytest.approx(1.0)
    assert rank_correlation(data, -(data**3)) == pytest.approx(-1.0)
    assert rank_correlation(data, np.ones(len(data))) == 0.0


def test_equal_values_share_their_rank() -> None:
    assert rank_correlation(np.array([1.0, 1.0, 2.0]), np.array([1.0, 2.0, 3.0])) == pytest.approx(math.sqrt(0.75))


@pytest.mark.parametrize(
    ("axis", "value", "edge"),
    [
        (LOG, LOG.low, "lower"),
        (LOG, 0.01 * 100.0**0.019, "lower"),
        (LOG, 0.01 * 100.0**0.021, ""),
        (LOG, 100.0**-0.019, "upper"),
        (LINEAR, 0.039, "lower"),
        (LINEAR, 1.95, ""),
        (STEPPED, 3.0, "upper"),
        (SWITCH, 1.0, ""),
    ],
)
def test_edges_are_two_percent_of_the_range(axis: Axis, value: float, edge: str) -> None:
    assert find_edge(axis, value) == edge


def test_an_edge_in_words() -> None:
    values = {"a": 0.01, "b": 1.0, "c": 1.0, "d": 1.0}
    assert describe_edges(SPACE, values) == ["a is at the lower edge of its range (0.01 to 1): widen the range"]


@given(st.sampled_from([*SPACE.axes, *resolve_space("complete", []).axes]), st.integers(2, 30))
def test_slices_reach_both_edges_and_stay_in_the_box(axis: Axis, points: int) -> None:
    found = choose_slice_points(axis, points)
    assert (found[0], found[-1]) == (axis.low, axis.high)
    assert found == sorted(set(found)) and all(axis.clip(value) == value for value in found)
    assert len(found) == (min(points, len(axis.grid)) if axis.grid else points)


def test_one_point_is_no_slice() -> None:
    with pytest.raises(ValueError, match="two"):
        choose_slice_points(LOG, 1)
