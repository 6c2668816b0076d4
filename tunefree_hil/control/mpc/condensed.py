"""Condensed quadratic programs of a linear model: the cost of a plan of inputs as a function of these inputs alone.

The model is `x(k+1) = A x(k) + B u(k)`, one input, at the tick of the controller. With the states eliminated
(Maciejowski, Predictive Control with Constraints, 2002, 2.6 and 3.1), the cost of the moves v over the horizon is

    v' H v / 2 + v' F w,    w = (state now, inputs under way from the oldest on, last input)

The inputs under way are those that the dead time still keeps from acting: the state is first predicted over the dead
time. The moves are held over one tick or more, longer ones later (move blocking), so that a horizon of a hundred ticks
has about ten unknowns. The end of the horizon is weighted with the cost to go of the LQR (the solution of the Riccati
equation); without bounds, without a weight on the rate and with moves of one tick the plan is then that of an infinite
horizon, else nearly. Or it is weighted with the weights of the states alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from tunefree_hil.control import riccati

UNIFORM_MOVES = 10  # a horizon of at most so many steps has a move for each, as Apollo's MPC (docs/reference/apollo.md)


class LinearModel(NamedTuple):
    """x(k+1) = a x(k) + b u(k): a of shape (n, n), b of shape (n,)."""

    a: np.ndarray
    b: np.ndarray


class PlanWeights(NamedTuple):
    """Weights of a plan, per tick.

    Args:
        states: Diagonal of the weight of the states, shape (n,).
        move: Of the input.
        move_rate: Of the rate of the input, per second.
        is_terminal_riccati: The end of the horizon has the cost to go of the LQR, else the weight of the states.
    """

    states: Sequence[float]
    move: float
    move_rate: float
    is_terminal_riccati: bool


class CondensedQp(NamedTuple):
    """H of shape (n_moves, n_moves) and F of shape (n_moves, n_states + dead ticks + 1), and the LQR-like gain.

    gain: first row of H^-1 F: the first move without bounds is minus gain times w.
    """

    hessian: np.ndarray
    linear: np.ndarray
    gain: np.ndarray


def divide_horizon(horizon_s: float, step_s: float, dt_s: float) -> tuple[int, ...]:
    """Ticks of each move: uniform up to UNIFORM_MOVES steps, else 1, 1, 2, 2, 4, 4, ... steps up to the horizon."""
    step = max(1, round(step_s / dt_s))
    steps = max(1, round(horizon_s / (step * dt_s)))
    if steps <= UNIFORM_MOVES:
        return (step,) * steps
    lengths: list[int] = []
    size = 1
    while steps > 0:
        for _ in range(2):
            lengths.append(min(size, steps))
            steps -= lengths[-1]
            if steps == 0:
                break
        size *= 2
    if lengths[-1] < lengths[-2]:  # the rest joins the last full move
        rest = lengths.pop()
        lengths[-1] += rest
    return tuple(step * length for length in lengths)


def start_ticks(lengths: Sequence[int]) -> tuple[int, ...]:
    """The tick at which each move begins."""
    return tuple(accumulate(lengths[:-1], initial=0))


def discretise(a: np.ndarray, b: np.ndarray, dt_s: float) -> LinearModel:
    """The model at the tick of x' = a x + b u with the input held: exact at any stiffness, unlike Tustin or Euler."""
    from scipy.linalg import expm  # here, as only a controller with this part needs it

    n = len(a)
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n] = a * dt_s, b * dt_s
    discrete = expm(augmented)
    return LinearModel(discrete[:n, :n].copy(), discrete[:n, n].copy())


def cost_to_go(model: LinearModel, weights: PlanWeights) -> np.ndarray:
    """The solution P of the discrete algebraic Riccati equation."""
    n = len(model.b)
    q = np.diag(np.asarray(weights.states, dtype=float))
    solution = riccati.gain(model.a.ravel().tolist(), model.b.tolist(), q.ravel().tolist(), weights.move, False)
    return np.array(solution.p).reshape(n, n)


def condense(
    model: LinearModel, weights: PlanWeights, lengths: Sequence[int], dead_ticks: int, dt_s: float
) -> CondensedQp:
    """The quadratic program of a horizon divided into moves, for a state whose input acts `dead_ticks` later."""
    n, moves = len(model.b), len(lengths)
    q = np.diag(np.asarray(weights.states, dtype=float))
    last = cost_to_go(model, weights) if weights.is_terminal_riccati else q
    free, forced = np.eye(n), np.zeros((n, moves))
    hessian, linear = np.zeros((moves, moves)), np.zeros((moves, n))
    total = sum(lengths)
    tick = 0
    for move, length in enumerate(lengths):
        for _ in range(length):
            free = model.a @ free
            forced = model.a @ forced
            forced[:, move] += model.b
            tick += 1
            weight = last if tick == total else q
            hessian += forced.T @ weight @ forced
            linear += forced.T @ weight @ free
    hessian += weights.move * np.diag(np.asarray(lengths, dtype=float))
    rate = weights.move_rate / (np.asarray(lengths, dtype=float) * dt_s * dt_s)
    change = np.eye(moves) - np.eye(moves, k=-1)
    hessian += change.T @ (rate[:, None] * change)
    before = np.zeros((moves, 1))
    before[0, 0] = -rate[0]
    hessian = 0.5 * (hessian + hessian.T)
    whole = np.hstack([linear @ _over_dead_time(model, dead_ticks), before])
    return CondensedQp(hessian, whole, np.linalg.solve(hessian, whole)[0])


def _over_dead_time(model: LinearModel, dead_ticks: int) -> np.ndarray:
    """(A^d, A^(d-1) B, ..., A B, B): the state after the dead time from the state now and the inputs under way."""
    n = len(model.b)
    columns = [model.b]
    for _ in range(dead_ticks - 1):
        columns.append(model.a @ columns[-1])
    power = np.linalg.matrix_power(model.a, dead_ticks)
    under_way = np.array(columns[::-1]).T if dead_ticks else np.zeros((n, 0))
    return np.hstack([power, under_way])


class QpTable(NamedTuple):
    """Condensed programs over speed, each scaled to a first diagonal element of 1; linear between the speeds.

    Args:
        nodes: Speeds, ascending, shape (n_nodes,); one for a model that does not depend on speed.
        hessians: Shape (n_nodes, n_moves, n_moves).
        linears: Shape (n_nodes, n_moves, n_parameters).
        gains: Gain on the first state without bounds, shape (n_nodes,).
    """

    nodes: tuple[float, ...]
    hessians: np.ndarray
    linears: np.ndarray
    gains: tuple[float, ...]


def tabulate(nodes: Sequence[float], programs: Sequence[CondensedQp]) -> QpTable:
    """The table of one program for each speed."""
    scales = np.array([1.0 / program.hessian[0, 0] for program in programs])[:, None, None]
    return QpTable(
        tuple(nodes),
        np.array([program.hessian for program in programs]) * scales,
        np.array([program.linear for program in programs]) * scales,
        tuple(float(program.gain[0]) for program in programs),
    )
