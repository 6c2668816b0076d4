"""Quadratic programs with OSQP: one structure, solved again and again, without memory of the solve before.

    min v' H v / 2 + f' v   subject to   low <= G v <= high

Where the minimum without bounds keeps to them it is the solution, exactly, and OSQP is not asked: on most ticks of a
drive no bound is active, and an answer of limited accuracy would shake the steering. Else OSQP (Stellato et al. 2020,
Math. Prog. Comp. 12, 637-672) solves it. Its step size begins anew at RHO and is adapted after fixed numbers of
iterations, its own scaling is off, and it starts from what the caller gives: the solution depends on the arguments
alone, not on the solves before and not on the time.
"""

from __future__ import annotations

import importlib
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from tunefree_hil.base.errors import InputError

RHO = 1.0  # first step size, for a mean diagonal of H and a norm of each row of 1
RHO_ITERATIONS = 25  # after so many iterations the step size is adapted
NUMBER_LIMIT = 1e12  # a larger number in the program is a diverged state


class MpcCriteria(NamedTuple):
    """Limits of the optimiser of an MPC in a control cycle."""

    # Most iterations of OSQP in a solve, more than four times the most in 500 programs with up to all bounds active.
    # The only limit in lockstep, where no wall time may decide.
    max_iterations: int = 4000
    # Iterations after which OSQP tests whether it is done.
    check_iterations: int = 5
    # Accuracy of a solution, in shares of the input's size: 1e-6 rad of road wheel, 1e-4 m/s2. The resolution of the
    # commands on the bus is coarser (0.1 degrees of steering wheel are 1e-4 rad of road wheel).
    tolerance: float = 1e-5
    # Seconds for a solve in real time: two of them fill 40 % of a control cycle of 10 ms.
    time_limit_s: float = 0.002
    # Ticks in a row without a solution after which the vehicle is stopped: 0.2 s, as without INS or chassis frames.
    max_failed_ticks: int = 20


class QpStatus(StrEnum):
    """How a solve ended."""

    FREE = "free"  # no bound is active
    SOLVED = "solved"
    INFEASIBLE = "infeasible"  # the bounds exclude one another
    ITERATION_LIMIT = "iteration_limit"
    TIME_LIMIT = "time_limit"
    FAILED = "failed"  # a number is not finite, or OSQP gave another answer


class QpSolution(NamedTuple):
    """values: the moves; duals: multipliers of the rows, to start the next solve from."""

    status: QpStatus
    values: np.ndarray
    duals: np.ndarray
    iterations: int

    @property
    def is_solved(self) -> bool:
        return self.status in (QpStatus.FREE, QpStatus.SOLVED)


class QpProblem(NamedTuple):
    """One program: H, f, and the bounds of the rows."""

    hessian: np.ndarray
    gradient: np.ndarray
    low: np.ndarray
    high: np.ndarray


def require_osqp(part: str) -> None:
    """Raise InputError where OSQP cannot be imported. part: 'lateral' or 'longitudinal', which needs it."""
    try:
        importlib.import_module("osqp")
    except ImportError as error:
        raise InputError(
            f"the {part} part 'mpc' needs OSQP, which is not installed here ({error})",
            code="no_osqp",
            key=f"controller.{part}",
            hint="pip install '.[mpc]' in the project's folder; the other parts work without",
        ) from error


class QpSolver:
    """Solves programs with the rows G (shape (n_rows, n)), each row of norm above 0.

    Args:
        rows: G.
        basis: Matrix T of shape (n, n), v = T z: OSQP solves for z. With it H should have a diagonal of about 1, and
            the rows that are often active together should be far from parallel.
        criteria: Limits of a solve.
        is_timed: Whether the time limit holds: only in real time.
    """

    def __init__(self, rows: np.ndarray, basis: np.ndarray, criteria: MpcCriteria, *, is_timed: bool) -> None:
        from scipy import sparse

        osqp = importlib.import_module("osqp")
        codes = osqp.SolverStatus
        self.rows, self._basis, self._inverse = rows, basis, np.linalg.inv(basis)
        scaled = rows @ basis
        self._norms = np.sqrt((scaled * scaled).sum(axis=1))
        self._upper = np.triu_indices(rows.shape[1])
        self._by_columns = np.lexsort(self._upper)  # the order of OSQP's matrices
        self._codes = {
            int(codes.OSQP_SOLVED): QpStatus.SOLVED,
            int(codes.OSQP_PRIMAL_INFEASIBLE): QpStatus.INFEASIBLE,
            int(codes.OSQP_PRIMAL_INFEASIBLE_INACCURATE): QpStatus.INFEASIBLE,
            int(codes.OSQP_MAX_ITER_REACHED): QpStatus.ITERATION_LIMIT,
            int(codes.OSQP_SOLVED_INACCURATE): QpStatus.ITERATION_LIMIT,
            int(codes.OSQP_TIME_LIMIT_REACHED): QpStatus.TIME_LIMIT,
        }
        count, n = rows.shape
        self._osqp = osqp.OSQP(algebra="builtin")
        self._osqp.setup(
            sparse.csc_matrix(np.triu(np.ones((n, n)) + n * np.eye(n))),  # given again for every solve
            np.zeros(n),
            sparse.csc_matrix(scaled / self._norms[:, None]),
            -np.ones(count),
            np.ones(count),
            verbose=False,
            scaling=0,
            rho=RHO,
            adaptive_rho=True,
            adaptive_rho_interval=RHO_ITERATIONS,
            warm_starting=True,
            polishing=False,
            eps_abs=criteria.tolerance,
            eps_rel=0.0,
            max_iter=criteria.max_iterations,
            check_termination=min(criteria.check_iterations, criteria.max_iterations),
            **({"time_limit": criteria.time_limit_s} if is_timed else {}),
        )

    def solve(self, problem: QpProblem, start: np.ndarray, duals: np.ndarray) -> QpSolution:
        """The solution of a program; start, duals: values and multipliers that are near it."""
        nothing = QpSolution(QpStatus.FAILED, start, duals, 0)
        size = float(np.abs(problem.gradient).max()) + float(np.abs(problem.low).max() + np.abs(problem.high).max())
        if not (size < NUMBER_LIMIT and np.isfinite(problem.hessian).all()):
            return nothing
        if bool((problem.low > problem.high).any()):
            return nothing._replace(status=QpStatus.INFEASIBLE)
        try:
            values = -np.linalg.solve(problem.hessian, problem.gradient)
        except np.linalg.LinAlgError:
            return nothing
        reached = self.rows @ values
        if bool(((problem.low <= reached) & (reached <= problem.high)).all()):
            return QpSolution(QpStatus.FREE, values, np.zeros(len(duals)), 0)
        return self._solve_bounded(problem, start, duals)

    def _solve_bounded(self, problem: QpProblem, start: np.ndarray, duals: np.ndarray) -> QpSolution:
        """The solution with OSQP, in z and with rows of norm 1."""
        solver, basis, norms = self._osqp, self._basis, self._norms
        hessian = basis.T @ problem.hessian @ basis
        size = float(hessian.diagonal().mean())
        solver.update_settings(rho=RHO)
        solver.update(
            Px=hessian[self._upper][self._by_columns] / size,
            q=basis.T @ problem.gradient / size,
            l=problem.low / norms,
            u=problem.high / norms,
        )
        solver.warm_start(x=self._inverse @ start, y=duals * norms / size)
        result = solver.solve(raise_error=False)
        status = self._codes.get(int(result.info.status_val), QpStatus.FAILED)
        iterations = int(result.info.iter)
        if status is not QpStatus.SOLVED:
            return QpSolution(status, start, duals, iterations)
        return QpSolution(status, basis @ np.asarray(result.x), np.asarray(result.y) * size / norms, iterations)
