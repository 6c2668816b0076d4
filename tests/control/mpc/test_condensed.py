"""Condensed programs: their cost is that of the simulated plan, and two parts plan what Apollo's joint MPC would."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.control.contract import VehicleConstants
from tunefree_hil.control.lateral.lqr import gain_rows, lateral_model_constants
from tunefree_hil.control.lateral.mpc import continuous_model
from tunefree_hil.control.mpc.condensed import (
    UNIFORM_MOVES,
    LinearModel,
    PlanWeights,
    condense,
    cost_to_go,
    discretise,
    divide_horizon,
    start_ticks,
    tabulate,
)
from tunefree_hil.control.mpc.plan import program_at
from tunefree_hil.control.mpc.solver import MpcCriteria, QpProblem, QpSolver

DT_S = 0.01
CAR = VehicleConstants(front_stiffness_n_per_rad=115_000.0, rear_stiffness_n_per_rad=200_000.0)
LATERAL = lateral_model_constants(CAR)
# Apollo's weights and bounds (docs/reference/apollo.md): four lateral states, station, speed; angle, acceleration.
APOLLO_Q, APOLLO_R = (3.0, 0.0, 35.0, 0.0, 50.0, 10.0), (3.25, 1.0)
APOLLO_LOW, APOLLO_HIGH = (-0.5127, -6.0), (0.5127, 2.0)


@given(st.floats(0.02, 3.0), st.floats(0.01, 0.2))
def test_the_moves_fill_the_horizon(horizon_s: float, step_s: float) -> None:
    lengths = divide_horizon(horizon_s, step_s, DT_S)
    step = round(step_s / DT_S)
    assert sum(lengths) == step * max(1, round(horizon_s / (step * DT_S)))
    assert list(lengths) == sorted(lengths) and lengths[0] == step
    assert len(set(lengths)) == 1 or sum(lengths) > UNIFORM_MOVES * step
    assert start_ticks(lengths) == tuple(sum(lengths[:i]) for i in range(len(lengths)))


def test_the_default_horizon_and_apollos() -> None:
    assert divide_horizon(1.0, 0.01, DT_S) == (1, 1, 2, 2, 4, 4, 8, 8, 16, 16, 38)
    assert divide_horizon(0.1, 0.01, DT_S) == (1,) * 10


@pytest.mark.parametrize("speed_mps", [0.1, 3.0, 30.0])
def test_the_discrete_model_is_exact(speed_mps: float) -> None:
    a, b = continuous_model(speed_mps, LATERAL, 0.07)
    model, fine = discretise(a, b, DT_S), discretise(a, b, DT_S / 1000.0)
    x, input_rad = np.arange(1.0, 6.0), 0.3
    small = x
    for _ in range(1000):
        small = fine.a @ small + fine.b * input_rad
    assert np.allclose(model.a @ x + model.b * input_rad, small, rtol=1e-9)
    instant_s = 1e-8
    assert np.allclose((discretise(a, b, instant_s).a - np.eye(5)) / instant_s, a, rtol=1e-4, atol=1e-3)


def simulated_cost(model, weights, lengths, under_way, start, moves, last) -> float:
    """The cost of a plan by simulation: dead time first, then a tick at a time."""
    terminal = cost_to_go(model, weights) if weights.is_terminal_riccati else np.diag(weights.states)
    x = np.array(start)
    for command in under_way:
        x = model.a @ x + model.b * command
    total, before = 0.0, last
    inputs = [move for move, length in zip(moves, lengths, strict=True) for _ in range(length)]
    for k, command in enumerate(inputs):
        x = model.a @ x + model.b * command
        total += x @ (terminal if k == len(inputs) - 1 else np.diag(weights.states)) @ x + weights.move * command**2
    for move, length in zip(moves, lengths, strict=True):
        total += weights.move_rate * (move - before) ** 2 / (length * DT_S * DT_S)
        before = move
    return total


@given(
    st.sampled_from([1.0, 8.0, 25.0]),
    st.integers(0, 6),
    st.booleans(),
    st.sampled_from([(1, 1, 1), (1, 1, 2, 2, 5)]),
    st.integers(0, 10_000),
)
def test_the_cost_is_that_of_the_simulated_plan(
    speed_mps: float, dead_ticks: int, riccati: bool, lengths: tuple[int, ...], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    model = discretise(*continuous_model(speed_mps, LATERAL, 0.07), DT_S)
    weights = PlanWeights((0.5, 0.1, 2.0, 0.05, 0.0), 1.3, 0.002, riccati)
    program = condense(model, weights, lengths, dead_ticks, DT_S)
    start, under_way, last = rng.normal(size=5), rng.normal(size=dead_ticks), float(rng.normal())
    known = np.concatenate([start, under_way, [last]])
    costs = []
    for _ in range(2):
        moves = rng.normal(size=len(lengths))
        simulated = simulated_cost(model, weights, lengths, under_way, start, moves, last)
        condensed = moves @ program.hessian @ moves + 2.0 * moves @ program.linear @ known
        costs.append((simulated, condensed))
    (first, second) = costs
    assert first[0] - second[0] == pytest.approx(first[1] - second[1], rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("speed_mps", [2.0, 8.0, 20.0])
def test_a_plan_with_the_cost_to_go_is_the_lqr(speed_mps: float) -> None:
    """On the LQR's own model; it discretises in another way."""
    q = (0.05, 0.0, 1.0, 0.0)
    a, _ = continuous_model(speed_mps, LATERAL, 1.0)
    model = discretise(a[:4, :4], a[:4, 4], DT_S)
    program = condense(model, PlanWeights(q, 1.0, 0.0, True), (1,) * 5, 0, DT_S)
    schedule = {2.0: (1.0, 1.0), 8.0: (0.6, 0.6), 20.0: (0.1, 0.2)}[speed_mps]
    weights = (q[0] / schedule[0], q[1], q[2] / schedule[1], q[3])
    (expected,) = gain_rows([speed_mps], weights, CAR, DT_S, shipped=False)
    assert program.gain[:4] == pytest.approx(expected, rel=0.05, abs=1e-3)


def test_the_table_has_the_programs_and_is_linear_between() -> None:
    weights = PlanWeights((0.05, 0.0, 1.0, 0.0, 0.0), 1.0, 0.01, True)
    nodes, known = (5.0, 10.0), np.arange(7.0)
    programs = [
        condense(discretise(*continuous_model(v, LATERAL, 0.07), DT_S), weights, (1, 2), 1, DT_S) for v in nodes
    ]
    table = tabulate(nodes, programs)
    ends = [program_at(table, speed_mps, known) for speed_mps in (*nodes, 50.0)]
    assert np.array_equal(ends[1][0], ends[2][0]) and np.array_equal(ends[1][1], ends[2][1])
    middle = program_at(table, 7.5, known)
    assert np.allclose(middle[0], 0.5 * (ends[0][0] + ends[1][0]))
    assert np.allclose(middle[1], 0.5 * (ends[0][1] + ends[1][1]))
    assert np.linalg.solve(*ends[0]) == pytest.approx(np.linalg.solve(programs[0].hessian, programs[0].linear @ known))
    assert table.gains[0] == pytest.approx(programs[0].gain[0])


class JointMpc:
    """Apollo's form: six states, two inputs in turn, all in one program."""

    def __init__(self, lateral: LinearModel, longitudinal: LinearModel, steps: int) -> None:
        a, b = np.zeros((6, 6)), np.zeros((6, 2))
        a[:4, :4], a[4:, 4:] = lateral.a, longitudinal.a
        b[:4, 0], b[4:, 1] = lateral.b, longitudinal.b
        free, forced, q = np.eye(6), np.zeros((6, 2 * steps)), np.diag(APOLLO_Q)
        self.hessian, self.linear = np.diag(np.tile(APOLLO_R, steps)), np.zeros((2 * steps, 6))
        for k in range(steps):
            free, forced = a @ free, a @ forced
            forced[:, 2 * k : 2 * k + 2] += b
            self.hessian += forced.T @ q @ forced
            self.linear += forced.T @ q @ free
        self.low, self.high = np.tile(APOLLO_LOW, steps), np.tile(APOLLO_HIGH, steps)
        self.solver = QpSolver(
            np.eye(2 * steps),
            np.diag(1.0 / np.sqrt(np.diag(self.hessian))),
            MpcCriteria(tolerance=1e-9),
            is_timed=False,
        )

    def solve(self, start: np.ndarray) -> np.ndarray:
        problem = QpProblem(self.hessian, self.linear @ start, self.low, self.high)
        size = len(self.low)
        solution = self.solver.solve(problem, np.zeros(size), np.zeros(size))
        assert solution.is_solved
        return solution.values


@given(st.sampled_from([2.0, 10.0, 20.0]), st.integers(0, 10_000))
def test_two_plans_are_the_joint_plan_of_apollo(speed_mps: float, seed: int) -> None:
    """Ten steps of 0.01 s, with errors so large that bounds are active in many."""
    steps = 10
    a, _ = continuous_model(speed_mps, LATERAL, 1.0)
    models = (
        discretise(a[:4, :4], a[:4, 4], DT_S),
        discretise(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([0.0, -1.0]), DT_S),
    )
    start = np.random.default_rng(seed).normal(size=6) * (2.0, 2.0, 1.0, 1.0, 20.0, 10.0)
    joint = JointMpc(*models, steps).solve(start).reshape(steps, 2)
    parts = ((slice(0, 4), 0), (slice(4, 6), 1))
    for model, (states, place) in zip(models, parts, strict=True):
        weights = PlanWeights(APOLLO_Q[states], APOLLO_R[place], 0.0, False)
        program = condense(model, weights, (1,) * steps, 0, DT_S)
        basis = np.diag(1.0 / np.sqrt(np.diag(program.hessian)))
        solver = QpSolver(np.eye(steps), basis, MpcCriteria(tolerance=1e-9), is_timed=False)
        gradient = program.linear @ np.append(start[states], 0.0)
        low, high = np.full(steps, APOLLO_LOW[place]), np.full(steps, APOLLO_HIGH[place])
        alone = solver.solve(QpProblem(program.hessian, gradient, low, high), np.zeros(steps), np.zeros(steps))
        assert alone.is_solved and alone.values == pytest.approx(joint[:, place], abs=1e-6)
