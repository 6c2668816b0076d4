"""Plans from tick to tick: bounds that can always be kept to, and what is applied without a solution."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.control.mpc.condensed import PlanWeights, condense, discretise, tabulate
from tunefree_hil.control.mpc.plan import (
    PlanBounds,
    Planner,
    PlanState,
    SolveCounts,
    bound_totals,
    first_plan,
    has_failed,
    make_planner,
    middle_distances_s,
    move_now,
    next_plan,
    plan_failure_text,
    solve_counts,
)
from tunefree_hil.control.mpc.solver import MpcCriteria

DT_S = 0.01
LENGTHS = (1, 2, 4)


@pytest.fixture
def planner() -> Planner:
    """Of the double integrator."""
    model = discretise(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([0.0, -1.0]), DT_S)
    program = condense(model, PlanWeights((1.0, 1.0), 1.0, 0.0, True), LENGTHS, 0, DT_S)
    return make_planner(tabulate((0.0,), [program]), LENGTHS, 1.0, MpcCriteria(max_failed_ticks=3), is_timed=False)


def bounds(width: float, low: float | None = None) -> PlanBounds:
    far = np.full(2, 100.0)
    return PlanBounds(np.full(3, -width if low is None else low), np.full(3, width), -far, far)


def test_a_tick_without_a_solution_carries_the_plan_on(planner: Planner) -> None:
    solved = next_plan(planner, first_plan(planner), 0.0, (1.0, 0.5, 0.0), bounds(100.0))
    assert solved.age_ticks == 0 and move_now(planner, solved) == solved.moves[0] != solved.moves[1]
    state, applied = solved, []
    for _ in range(9):
        state = next_plan(planner, state, 0.0, (1.0, 0.5, 0.0), bounds(1.0, low=2.0))
        applied.append(move_now(planner, state))
    moves = list(solved.moves)
    assert applied == [moves[1]] * 2 + [moves[2]] * 7  # the last move is held beyond the horizon
    assert (state.counts.ticks, state.counts.failed, state.failed_ticks) == (10, 9, 9)
    again = next_plan(planner, state, 0.0, (1.0, 0.5, 0.0), bounds(100.0))
    assert (again.age_ticks, again.failed_ticks, again.counts.failed) == (0, 0, 9)


def test_so_many_ticks_in_a_row_are_a_failure(planner: Planner) -> None:
    state, failures = first_plan(planner), []
    for _ in range(4):
        state = next_plan(planner, state, 0.0, (1.0, 0.5, 0.0), bounds(1.0, low=2.0))
        failures.append(has_failed(planner, state))
    assert failures == [False, False, True, True]


def test_active_bounds_and_iterations_are_counted(planner: Planner) -> None:
    state = next_plan(planner, first_plan(planner), 0.0, (1.0, 0.5, 0.0), bounds(100.0))
    state = next_plan(planner, state, 0.0, (1.0, 0.5, 0.0), bounds(0.1))
    counts = state.counts
    assert (counts.ticks, counts.bounded, counts.failed) == (2, 1, 0)
    assert counts.iterations == counts.most_iterations > 0
    assert state.moves == pytest.approx(np.full(3, 0.1), abs=1e-4)


@given(
    st.floats(-20.0, 20.0),
    st.floats(-10.0, 10.0),
    st.floats(0.0, 10.0),
    st.lists(st.floats(0.01, 5.0), min_size=1, max_size=12),
)
def test_the_bounds_can_always_be_kept_to(last: float, low: float, width: float, steps: list[float]) -> None:
    """By the input that goes to the nearest bound as fast as the rate allows."""
    reach = np.array(steps)
    lows, highs = bound_totals(last, (low, low + width), reach)
    value = last
    for k in range(len(reach)):
        value = min(max(min(max(value, low), low + width), value - reach[k]), value + reach[k])
        assert lows[k] - 1e-9 <= value <= highs[k] + 1e-9
    assert (lows <= highs + 1e-12).all()
    assert lows[0] >= last - reach[0] and highs[0] <= last + reach[0]
    if low <= last <= low + width:
        assert (lows >= low).all() and (highs <= low + width).all()


def test_distances_are_between_the_middles() -> None:
    assert middle_distances_s(LENGTHS, DT_S) == pytest.approx([0.015, 0.03])


def test_counts_are_read_from_parts_that_plan(planner: Planner) -> None:
    class Parts:
        lateral = PlanState(np.zeros(3), np.zeros(5), 0, 0, SolveCounts(4, 3, 2, 1, 1))
        longitudinal = 1.0

    class Holder:
        lateral = type("Part", (), {"plan": first_plan(planner)._replace(counts=SolveCounts(4, 3, 2, 1, 1))})()
        longitudinal = None

    assert solve_counts(Parts()) == {} == solve_counts(None)
    assert solve_counts(Holder()) == {"lateral": SolveCounts(4, 3, 2, 1, 1)}
    assert plan_failure_text("lateral", SolveCounts(4, 3, 2, 1, 1)).startswith("lateral part: no solution on 2 of 4")
