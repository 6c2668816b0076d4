"""Which trial wins: robust trials before the others, the best mean of those, and no possible winner is missed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.tune.journal import slot_key
from tunefree_hil.tune.robust_winner import (
    DriveTotals,
    drive_totals,
    find_open_trials,
    find_rejected_trials,
    is_robust,
    mean_merit,
    rank_trials,
)
from tunefree_hil.tune.trial import Trial, find_best_trial


def trial(slot: int, score: float, replans: int = 0, outcome: str = "finished") -> Trial:
    drives = {"bend": {"score": score, "replans": replans, "outcome": outcome}}
    return Trial(slot, slot, {"x": float(slot)}, score, drives)


def driven(trials: Sequence[Trial], slower: Mapping[str, DriveTotals]) -> dict[str, DriveTotals]:
    """What is known when all that may win has been driven, one after the other."""
    known: dict[str, DriveTotals] = {}
    while wanted := find_open_trials(trials, known):
        key = slot_key(wanted[0].slot)
        known[key] = slower[key]
    return known


def test_a_better_grade_that_does_not_hold_is_passed_over() -> None:
    trials = [trial(0, 0.150), trial(1, 0.143), trial(2, 0.160), trial(3, 0.155)]
    slower = {
        "trial 1": DriveTotals(0.19, 0, 0),
        "trial 2": DriveTotals(4.4, 12, 2),
        "trial 3": DriveTotals(0.17, 0, 0),
    }
    slower["trial 4"] = DriveTotals(0.60, 1, 0)
    assert [one.slot for one in rank_trials(trials, slower)] == [2, 0, 3, 1]
    assert [one.slot for one in find_rejected_trials(trials, slower)] == [1, 0, 3]
    assert not is_robust(trials[1], slower) and is_robust(trials[2], slower)
    assert mean_merit(trials[2], slower) == pytest.approx(0.165)


def test_without_the_slower_car_the_best_grade_wins() -> None:
    trials = [trial(0, 0.2), trial(1, 0.1), trial(2, 0.1)]
    assert [one.slot for one in rank_trials(trials, {})] == [1, 2, 0]
    assert find_rejected_trials(trials, {}) == [] and find_rejected_trials([], {}) == []


def test_where_none_holds_the_best_mean_of_what_was_driven_wins() -> None:
    trials = [trial(0, 0.2), trial(1, 0.1), trial(2, 0.05, replans=1)]
    slower = {"trial 1": DriveTotals(0.6, 1, 0), "trial 2": DriveTotals(5.0, 9, 3)}
    assert [one.slot for one in rank_trials(trials, slower)] == [0, 1, 2]
    assert [one.slot for one in find_rejected_trials(trials, slower)] == [2, 1]


def test_what_is_not_calm_as_it_is_is_not_driven_and_never_holds() -> None:
    trials = [trial(0, 0.1, replans=1), trial(1, 0.2, outcome="left_lane"), trial(2, 0.3)]
    assert [one.slot for one in find_open_trials(trials, {})] == [2]
    assert not is_robust(trials[0], {"trial 1": DriveTotals(0.1, 0, 0)})
    assert not drive_totals(0.2, trials[1].scenarios).is_clean and drive_totals(0.3, trials[2].scenarios).is_clean


def test_it_stops_where_no_grade_can_win_any_more() -> None:
    trials = [trial(slot, 0.1 + 0.01 * slot) for slot in range(9)]
    slower = {slot_key(slot): DriveTotals(0.16 + 0.01 * slot, 0, 0) for slot in range(9)}
    known = driven(trials, slower)
    assert list(known) == ["trial 1"] + [slot_key(slot) for slot in range(1, 3)]  # 0.13 is the first one's mean
    assert rank_trials(trials, known)[0].slot == 0


SCORES = st.floats(0.01, 1.0)


@given(st.lists(st.tuples(SCORES, st.floats(0.0, 2.0), st.booleans(), st.booleans()), min_size=1, max_size=12))
def test_whoever_is_not_driven_would_not_have_won(sets: list[tuple[float, float, bool, bool]]) -> None:
    trials = [trial(slot, score, replans=int(restless)) for slot, (score, _, restless, _) in enumerate(sets)]
    whole = {
        slot_key(slot): DriveTotals(score + more, int(upset), 0)  # a slower car is driven no better
        for slot, (score, more, _, upset) in enumerate(sets)
    }
    known = driven(trials, whole)
    holding = [one for one in trials if is_robust(one, whole)]
    winner = rank_trials(trials, known)[0]
    if holding:
        assert mean_merit(winner, known) == min(mean_merit(one, whole) or math.inf for one in holding)
    else:
        assert all(slot_key(one.slot) in known for one in trials if drive_totals(one.score, one.scenarios).is_clean)
    assert sorted(one.slot for one in rank_trials(trials, known)) == list(range(len(sets)))


def test_requirements_come_before_robustness_and_score() -> None:
    """Whoever meets them is first, then the least violation; the slower car is driven for those that may win."""
    met, better, worst = trial(0, 0.3), trial(1, 0.1)._replace(violation=0.2), trial(2, 0.05)._replace(violation=3.0)
    trials = [worst, better, met]
    calm = DriveTotals(0.1, 0, 0)
    assert [one.slot for one in find_open_trials(trials, {})] == [0]
    assert [one.slot for one in find_open_trials([worst, better], {})] == [1], "the least violation may still win"
    assert rank_trials(trials, {slot_key(1): calm, slot_key(2): calm}) == [met, better, worst]
    assert find_rejected_trials(trials, {}) == [], "a better score that violates a requirement was not passed over"
    assert find_best_trial(trials) == met and find_best_trial([worst, better]) == better


def test_a_trial_that_oscillates_in_the_slower_car_does_not_pass() -> None:
    first, second = trial(0, 0.1), trial(1, 0.2)
    slower = {"trial 1": DriveTotals(0.1, 0, 0, 2), "trial 2": DriveTotals(0.3, 0, 0)}
    assert [one.slot for one in rank_trials([first, second], slower)] == [1, 0]


def test_several_objectives_are_ranked_by_their_trade() -> None:
    """The scores say the contrary."""
    first, second = trial(0, 0.1)._replace(trade=0.9), trial(1, 0.5)._replace(trade=0.7)
    slower = {"trial 1": DriveTotals(0.1, 0, 0, trade=1.0), "trial 2": DriveTotals(0.6, 0, 0, trade=0.8)}
    assert find_best_trial([first, second]) == second and find_open_trials([first, second], {}) == [second, first]
    assert rank_trials([first, second], slower) == [second, first]
    assert mean_merit(second, slower) == pytest.approx(0.75)
    assert find_open_trials([first, second], {"trial 2": slower["trial 2"]}) == [], "0.9 is no better than 0.75"
