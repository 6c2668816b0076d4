"""A plan of moves from tick to tick: solved anew, or the last one carried on where there is no solution."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from tunefree_hil.base.maths import clamp, find_cell
from tunefree_hil.control.mpc.condensed import QpTable, start_ticks
from tunefree_hil.control.mpc.solver import MpcCriteria, QpProblem, QpSolver, QpStatus

SIZE_FLOOR = 1e-9
REACH_SHARE = 0.95  # so that a plan between bound and rate has room


class Planner(NamedTuple):
    """What solves the plans of a part: programs over speed, ticks of the moves, the tick at which each begins."""

    table: QpTable
    lengths: tuple[int, ...]
    starts: tuple[int, ...]
    solver: QpSolver
    criteria: MpcCriteria


class PlanBounds(NamedTuple):
    """Bounds of the moves, and of their differences to the move before: (n_moves,) and (n_moves - 1,)."""

    low: np.ndarray
    high: np.ndarray
    low_change: np.ndarray
    high_change: np.ndarray


class SolveCounts(NamedTuple):
    """Counts of a drive: ticks; those with an active bound, and without a solution; iterations of OSQP."""

    ticks: int = 0
    bounded: int = 0
    failed: int = 0
    iterations: int = 0
    most_iterations: int = 0


class PlanState(NamedTuple):
    """The last solution, how many ticks ago it was found, and the ticks in a row without one.

    The arrays are never changed in place.
    """

    moves: np.ndarray
    duals: np.ndarray
    age_ticks: int
    failed_ticks: int
    counts: SolveCounts


def make_planner(
    table: QpTable, lengths: Sequence[int], size: float, criteria: MpcCriteria, *, is_timed: bool
) -> Planner:
    """The planner of a table. size: a large input, in whose shares the accuracy of a solution is measured.

    OSQP solves for the changes from move to move: where many rates are at their bound, which is usual, it needs far
    fewer iterations than for the moves themselves.
    """
    moves = len(lengths)
    rows = np.vstack([np.eye(moves), (np.eye(moves) - np.eye(moves, k=-1))[1:]])
    sums = np.tril(np.ones((moves, moves)))
    curvature = np.diag(sums.T @ table.hessians.mean(axis=0) @ sums)
    basis = sums * (size / np.sqrt(np.maximum(curvature, SIZE_FLOOR)))
    solver = QpSolver(rows, basis, criteria, is_timed=is_timed)
    return Planner(table, tuple(lengths), start_ticks(lengths), solver, criteria)


def first_plan(planner: Planner) -> PlanState:
    """No move, before the first tick."""
    moves = len(planner.lengths)
    return PlanState(np.zeros(moves), np.zeros(2 * moves - 1), 0, 0, SolveCounts())


def next_plan(
    planner: Planner, state: PlanState, speed_mps: float, known: Sequence[float], bounds: PlanBounds
) -> PlanState:
    """Solve the program of this tick. Without a solution the last plan is carried on.

    known: the state now, the inputs under way from the oldest on, and the last input.
    """
    hessian, gradient = program_at(planner.table, speed_mps, np.asarray(known, dtype=float))
    low, high = np.concatenate([bounds.low, bounds.low_change]), np.concatenate([bounds.high, bounds.high_change])
    solution = planner.solver.solve(QpProblem(hessian, gradient, low, high), state.moves, state.duals)
    counts = state.counts
    counts = SolveCounts(
        counts.ticks + 1,
        counts.bounded + (solution.status is QpStatus.SOLVED),
        counts.failed + (not solution.is_solved),
        counts.iterations + solution.iterations,
        max(counts.most_iterations, solution.iterations),
    )
    if solution.is_solved:
        return PlanState(solution.values, solution.duals, 0, 0, counts)
    return PlanState(state.moves, state.duals, state.age_ticks + 1, state.failed_ticks + 1, counts)


def program_at(table: QpTable, speed_mps: float, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, F w) at a speed: linear between the speeds of the table, flat outside."""
    if len(table.nodes) == 1:
        return table.hessians[0], table.linears[0] @ known
    node, share = _cell(table, speed_mps)
    hessian = (1.0 - share) * table.hessians[node] + share * table.hessians[node + 1]
    return hessian, (1.0 - share) * (table.linears[node] @ known) + share * (table.linears[node + 1] @ known)


def _cell(table: QpTable, speed_mps: float) -> tuple[int, float]:
    nodes = table.nodes
    node = find_cell(nodes, speed_mps)
    return node, clamp((speed_mps - nodes[node]) / (nodes[node + 1] - nodes[node]), 0.0, 1.0)


def move_now(planner: Planner, state: PlanState) -> float:
    """The move of the plan that is due: of one that is carried on, the one after as many ticks as it is old."""
    place = 0
    while place + 1 < len(planner.starts) and planner.starts[place + 1] <= state.age_ticks:
        place += 1
    return float(state.moves[place])


def has_failed(planner: Planner, state: PlanState) -> bool:
    """Whether there was no solution for so many ticks that the vehicle has to be stopped."""
    return state.failed_ticks >= planner.criteria.max_failed_ticks


def bound_totals(last: float, bounds: tuple[float, float], reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(low, high) of the inputs over the moves, which `last`, the input now, can keep to.

    An input beyond a bound that has become narrower goes back to it almost as fast as the rate allows.

    Args:
        bounds: Of the input.
        reach: Largest change to each move from the move before, the first one from `last`.
    """
    back = REACH_SHARE * np.cumsum(reach)
    low, high = np.full(len(reach), bounds[0]), np.full(len(reach), bounds[1])
    if last < bounds[0]:
        low = np.minimum(bounds[0], last + back)
    elif last > bounds[1]:
        high = np.maximum(bounds[1], last - back)
    low[0], high[0] = max(low[0], last - reach[0]), min(high[0], last + reach[0])
    return low, high


def middle_distances_s(lengths: Sequence[int], dt_s: float) -> np.ndarray:
    """Seconds from the middle of each move to that of the next, shape (n_moves - 1,)."""
    ticks = np.asarray(lengths, dtype=float)
    return 0.5 * dt_s * (ticks[1:] + ticks[:-1])


def solve_counts(state: Any) -> dict[str, SolveCounts]:
    """The counts of the parts of a controller that plan, by the name of the part; empty where none does."""
    plans = {name: getattr(getattr(state, name, None), "plan", None) for name in ("lateral", "longitudinal")}
    return {name: plan.counts for name, plan in plans.items() if isinstance(plan, PlanState)}


def plan_failure_text(part: str, counts: SolveCounts) -> str:
    """A text for a drive with ticks without a solution."""
    share = f"{counts.failed} of {counts.ticks} ticks"
    return f"{part} part: no solution on {share}, at which the plan before was carried on"
