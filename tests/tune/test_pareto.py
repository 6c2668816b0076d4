"""The front of a study, and the rule that picks one trial of it."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tunefree_hil.tune.pareto import (
    Objectives,
    dominates,
    find_front,
    find_study_front,
    measure_trade,
    with_trades,
)
from tunefree_hil.tune.trial import Baseline, Trial, find_best_trial

MANUAL = (0.3, 0.15)
BASELINES = {"worse": Baseline({}, 0.4, {}, 0.0, (0.5, 0.1)), "best": Baseline({}, 0.25, {}, 0.0, MANUAL)}
VALUES = st.floats(0.01, 10.0)
POINTS = st.lists(st.tuples(VALUES, VALUES), max_size=25)
FEW_VALUES = st.lists(st.tuples(*[st.sampled_from([0.1, 0.2, 0.3])] * 3), max_size=20)  # with ties, three objectives


def study(points: Sequence[Objectives], violations: Sequence[float] = ()) -> list[Trial]:
    trials = [Trial(slot, slot, {}, sum(point), {}, objectives=point) for slot, point in enumerate(points)]
    return with_trades(
        [trial._replace(violation=v) for trial, v in zip(trials, violations or [0.0] * len(trials), strict=True)],
        BASELINES,
    )


@given(POINTS | FEW_VALUES)
def test_nothing_on_the_front_is_dominated_and_all_else_is(points: list[Objectives]) -> None:
    front = find_front(points)
    on_front = [points[index] for index in front]
    assert len(set(front)) == len(front) and on_front == sorted(on_front)
    for index, point in enumerate(points):
        assert any(dominates(other, point) for other in on_front) == (index not in front)


@given(st.tuples(VALUES, VALUES), st.tuples(VALUES, VALUES))
def test_one_of_two_dominates_or_neither(first: Objectives, second: Objectives) -> None:
    assert not (dominates(first, second) and dominates(second, first)) and not dominates(first, first)


@given(POINTS, st.floats(0.01, 100.0), st.floats(0.01, 100.0))
def test_the_unit_of_an_objective_does_not_matter(points: list[Objectives], x: float, y: float) -> None:
    for point in points:
        scaled = measure_trade((point[0] * x, point[1] * y), (MANUAL[0] * x, MANUAL[1] * y))
        assert scaled == pytest.approx(measure_trade(point, MANUAL), rel=1e-9)


@given(st.tuples(VALUES, VALUES), st.floats(1.001, 3.0), st.integers(0, 1))
def test_a_trade_grows_with_each_objective(point: Objectives, factor: float, which: int) -> None:
    worse = tuple(value * factor if k == which else value for k, value in enumerate(point))
    assert measure_trade(worse, MANUAL) > measure_trade(point, MANUAL)


@given(POINTS)
def test_the_winner_is_on_the_front(points: list[Objectives]) -> None:
    assume(points)
    trials = study(points)
    winner = find_best_trial(trials)
    assert winner is not None and winner in find_study_front(trials, BASELINES).trials
    gains = [trial for trial in trials if trial.objectives[0] < MANUAL[0] and trial.objectives[1] < MANUAL[1]]
    assert winner in gains or not gains, "what is better than the manual set in both wins over all that is not"


@given(POINTS, st.tuples(VALUES, VALUES))
def test_a_further_trial_wins_or_changes_nothing(points: list[Objectives], more: Objectives) -> None:
    """A knee is moved by a trial at an end of the front."""
    assume(points)
    before, after = find_best_trial(study(points)), find_best_trial(study([*points, more]))
    assert before is not None and after is not None and (after == before or after.objectives == more)


def test_the_rule_on_fronts_of_one_to_three_points() -> None:
    even, careful, wild = (0.25, 0.13), (0.299, 0.1), (0.1, 0.16)
    assert find_best_trial(study([wild])).objectives == wild  # type: ignore[union-attr]
    assert find_best_trial(study([wild, careful])).objectives == careful  # type: ignore[union-attr]
    assert find_best_trial(study([wild, careful, even])).objectives == even  # type: ignore[union-attr]
    assert measure_trade(even, MANUAL) == pytest.approx(1.0 - ((1 - 0.25 / 0.3) * (1 - 0.13 / 0.15)) ** 0.5)
    assert measure_trade(wild, MANUAL) == pytest.approx(0.16 / 0.15, abs=1e-5)
    assert measure_trade(MANUAL, MANUAL) == pytest.approx(1.0, abs=1e-5)
    assert measure_trade((0.0, 0.0), (0.0, 0.0)) == 0.0, "a manual set without any error"


def test_requirements_come_before_the_trade() -> None:
    trials = study([(0.1, 0.1), (0.28, 0.14), (0.4, 0.2)], [0.2, 0.0, 0.0])
    front = find_study_front(trials, BASELINES)
    assert [trial.slot for trial in front.trials] == [1] and find_best_trial(trials) == trials[1]
    assert front.manual == "best" and front.reference == MANUAL
    none_meets = study([(0.1, 0.1), (0.28, 0.14)], [0.2, 0.3])
    assert [trial.slot for trial in find_study_front(none_meets, BASELINES).trials] == [0]


def test_the_ends_of_a_front() -> None:
    front = find_study_front(study([(0.1, 0.3), (0.2, 0.2), (0.3, 0.1), (0.4, 0.4)]), BASELINES)
    assert [front.extreme(k).slot for k in (0, 1)] == [0, 2] and len(front.trials) == 3


def test_without_objectives_or_baselines_trials_keep_their_score() -> None:
    trials = [Trial(0, 0, {}, 0.5, {})]
    assert with_trades(trials, BASELINES) == trials and trials[0].merit == 0.5
    with_objectives = trials[0]._replace(objectives=(0.1, 0.1))
    assert with_trades([with_objectives], {}) == [with_objectives]
