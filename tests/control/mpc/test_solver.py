"""The solver: its answers fulfil the conditions of an optimum, and depend on its arguments alone."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.base.errors import InputError
from tunefree_hil.control.mpc.solver import MpcCriteria, QpProblem, QpSolver, QpStatus, require_osqp

N = 6
ROWS = np.vstack([np.eye(N), (np.eye(N) - np.eye(N, k=-1))[1:]])
ZEROS = np.zeros(N), np.zeros(len(ROWS))


def make_problem(seed: int, bound: float = 0.3, change: float = 0.1) -> QpProblem:
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(N, N))
    width = np.concatenate([np.full(N, bound), np.full(N - 1, change)])
    return QpProblem(factor @ factor.T + 0.1 * np.eye(N), rng.normal(size=N), -width, width)


def make_solver(**changes: float) -> QpSolver:
    return QpSolver(ROWS, 0.3 * np.tril(np.ones((N, N))), MpcCriteria(**{"tolerance": 1e-8, **changes}), is_timed=False)


@given(st.integers(0, 100_000), st.floats(0.01, 10.0), st.floats(0.01, 10.0))
def test_a_solution_fulfils_the_conditions_of_an_optimum(seed: int, bound: float, change: float) -> None:
    """Karush, Kuhn and Tucker: stationary, within the bounds, multipliers only at them and of the right sign."""
    problem = make_problem(seed, bound, change)
    solution = make_solver().solve(problem, *ZEROS)
    assert solution.is_solved
    slope = problem.hessian @ solution.values + problem.gradient + ROWS.T @ solution.duals
    reached = ROWS @ solution.values
    assert np.abs(slope).max() < 1e-5
    assert (reached <= problem.high + 1e-6).all() and (reached >= problem.low - 1e-6).all()
    for value, low, high, dual in zip(reached, problem.low, problem.high, solution.duals, strict=True):
        assert dual < 1e-5 or value > high - 1e-5
        assert dual > -1e-5 or value < low + 1e-5


def test_without_an_active_bound_the_solution_is_exact_and_osqp_is_not_asked() -> None:
    problem = make_problem(1, 100.0, 100.0)
    solution = make_solver(max_iterations=1).solve(problem, *ZEROS)
    assert (solution.status, solution.iterations) == (QpStatus.FREE, 0)
    assert solution.values == pytest.approx(-np.linalg.solve(problem.hessian, problem.gradient), rel=1e-12)


def test_the_answer_is_the_same_bits_whatever_was_solved_before() -> None:
    fresh, used = make_solver(tolerance=1e-4), make_solver(tolerance=1e-4)
    for seed in range(50):
        used.solve(make_problem(seed, 10.0 ** (seed % 5 - 3)), *ZEROS)
    used.solve(make_problem(3, 1e-3)._replace(low=np.full(len(ROWS), 1.0)), *ZEROS)  # crossed bounds
    for seed in (7, 8, 9):
        problem, start = make_problem(seed), np.full(N, 0.01 * seed)
        solutions = [solver.solve(problem, start, np.full(len(ROWS), 0.1)) for solver in (fresh, used)]
        assert solutions[0].iterations == solutions[1].iterations > 0
        assert solutions[0].values.tobytes() == solutions[1].values.tobytes()
        assert solutions[0].duals.tobytes() == solutions[1].duals.tobytes()
        fresh = make_solver(tolerance=1e-4)


def test_a_start_near_the_solution_saves_iterations() -> None:
    solver, problem = make_solver(), make_problem(5)
    cold = solver.solve(problem, *ZEROS)
    warm = solver.solve(problem, cold.values, cold.duals)
    assert warm.iterations < cold.iterations and warm.values == pytest.approx(cold.values, abs=1e-6)


def test_what_has_no_solution_says_why_and_gives_back_its_start() -> None:
    solver, problem, start = make_solver(), make_problem(2), np.full(N, 0.25)
    width = np.concatenate([np.full(N, 0.3), np.full(N - 1, 0.001)])
    apart = QpProblem(problem.hessian, problem.gradient, -width, width)
    apart.low[0], apart.high[1] = 0.2, -0.2  # the first two moves must be 0.4 apart, and may be 0.001
    cases = {
        QpStatus.INFEASIBLE: apart,
        QpStatus.FAILED: problem._replace(gradient=np.full(N, np.nan)),
    }
    for status, case in cases.items():
        solution = solver.solve(case, start, np.zeros(len(ROWS)))
        assert solution.status is status and not solution.is_solved
        assert np.array_equal(solution.values, start)
    crossed = problem._replace(low=problem.high + 1.0)
    assert solver.solve(crossed, start, np.zeros(len(ROWS))).status is QpStatus.INFEASIBLE
    indefinite = solver.solve(problem._replace(hessian=np.zeros((N, N))), start, np.zeros(len(ROWS)))
    assert indefinite.status is QpStatus.FAILED
    starved = make_solver(max_iterations=1).solve(problem, start, np.zeros(len(ROWS)))
    assert starved.status is QpStatus.ITERATION_LIMIT and np.array_equal(starved.values, start)
    assert solver.solve(problem, *ZEROS).is_solved, "a failure leaves nothing behind"


def test_the_time_limit_holds_in_real_time_only() -> None:
    criteria = MpcCriteria(tolerance=1e-12, max_iterations=1_000_000, time_limit_s=1e-9)
    problem = make_problem(4)
    timed = QpSolver(ROWS, 0.3 * np.eye(N), criteria, is_timed=True).solve(problem, *ZEROS)
    untimed = QpSolver(ROWS, 0.3 * np.eye(N), criteria, is_timed=False).solve(problem, *ZEROS)
    assert timed.status is QpStatus.TIME_LIMIT and untimed.status is not QpStatus.TIME_LIMIT


def test_without_osqp_the_part_and_the_extra_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    require_osqp("lateral")
    monkeypatch.setitem(sys.modules, "osqp", None)
    with pytest.raises(InputError, match="lateral part 'mpc' needs OSQP") as caught:
        require_osqp("lateral")
    assert (caught.value.code, caught.value.key) == ("no_osqp", "controller.lateral") and "[mpc]" in caught.value.hint
