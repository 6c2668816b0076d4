"""Riccati: doubling against scipy, recursion against doubling, the stop rule, elimination."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.bench.test_every_vehicle import first_benches
from tunefree_hil.base.kernel import buffer
from tunefree_hil.bench import load
from tunefree_hil.bench.controller import constants_of
from tunefree_hil.control import riccati
from tunefree_hil.control.contract import VehicleConstants
from tunefree_hil.control.lateral.lqr import HEADING_RATIO, LATERAL_RATIO, NODES_MPS, SCHEDULE_MPS, gain_rows, model

MKZ = VehicleConstants()
UNEQUAL = VehicleConstants(mass_kg=1600.0, front_axle_m=1.1, front_stiffness_n_per_rad=9e4)


@pytest.mark.parametrize("vehicle", [MKZ, UNEQUAL], ids=["mkz", "unequal"])
@pytest.mark.parametrize("weights", [(0.05, 0.0, 1.0, 0.0), (1.0, 0.1, 0.01, 0.001), (0.01, 0.001, 1.0, 0.1)])
def test_doubling_equals_scipy_at_all_nodes(vehicle, weights):
    for speed in NODES_MPS:
        a, b = model(speed, vehicle, 0.01)
        q = np.diag(weights).astype(float)
        gains, p, rounds = riccati.gain(a, b, q.ravel().tolist(), 1.0, shipped=False)
        flat_a, flat_b = np.reshape(a, (4, 4)), np.reshape(b, (4, 1))
        other = scipy.linalg.solve_discrete_are(flat_a, flat_b, q, np.eye(1))
        assert np.max(np.abs(np.reshape(p, (4, 4)) - other)) < 1e-10 * np.max(np.abs(other))
        expected = np.linalg.solve(1.0 + flat_b.T @ other @ flat_b, flat_b.T @ other @ flat_a).ravel()
        assert np.max(np.abs(np.array(gains) - expected)) < 1e-10
        assert rounds < 25
        assert np.max(np.abs(np.linalg.eigvals(flat_a - flat_b @ np.reshape(gains, (1, 4))))) < 1.0


@pytest.mark.parametrize("path", first_benches(), ids=lambda path: path.stem)
@settings(max_examples=2, deadline=None)
@given(logs=st.tuples(st.floats(-2.0, 0.0), st.floats(-3.0, -1.0), st.floats(-2.0, 0.0), st.floats(-3.0, -1.0)))
def test_gains_of_every_vehicle_at_all_nodes_are_scipys(path, logs):
    """With the gain scheduler's weights, over the box of Q."""
    vehicle = constants_of(load(path).vehicle)
    weights = tuple(10.0**value for value in logs)
    rows = gain_rows(NODES_MPS, weights, vehicle, 0.01, shipped=False)
    for speed, gains in zip(NODES_MPS, rows, strict=True):
        a, b = (np.reshape(flat, (4, -1)) for flat in model(speed, vehicle, 0.01))
        lateral, heading = (np.interp(speed, SCHEDULE_MPS, row) for row in (LATERAL_RATIO, HEADING_RATIO))
        p = scipy.linalg.solve_discrete_are(
            a, b, np.diag(np.multiply(weights, (lateral, 1.0, heading, 1.0))), np.eye(1)
        )
        expected = np.linalg.solve(1.0 + b.T @ p @ b, b.T @ p @ a).ravel()
        assert np.max(np.abs(np.array(gains) - expected)) < 1e-10


def test_recursion_without_cap_comes_to_the_same_solution():
    a, b = model(1.0, MKZ, 0.01)
    q = np.diag([0.05, 0.0, 1.0, 0.0]).ravel().tolist()
    _, converged, _ = riccati.gain(a, b, q, 1.0, shipped=False)
    p = buffer(16)
    rounds = riccati.recurse(p, a, b, q, 1.0, 4, 100000, 1e-9, buffer(16), buffer(4))
    assert rounds == 4174  # the count of docs/reference/apollo.md
    assert np.max(np.abs(np.array(p) - converged)) < 1e-5 * np.max(np.abs(converged))


@pytest.mark.parametrize(("speed", "rounds"), [(1.0, 150), (12.0, 150), (16.0, 134), (20.0, 126)])
def test_shipped_recursion_stops_where_apollo_stops(speed, rounds):
    ratio = {1.0: (1.0, 1.0), 12.0: (0.2, 0.4), 16.0: (0.15, 0.3), 20.0: (0.1, 0.2)}[speed]
    a, b = model(speed, MKZ, 0.01)
    q = np.diag([0.05 * ratio[0], 0.0, ratio[1], 0.0]).ravel().tolist()
    assert riccati.gain(a, b, q, 1.0, shipped=True)[2] == rounds


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.floats(-10.0, 10.0), min_size=9, max_size=9), st.lists(st.floats(-10.0, 10.0), min_size=3, max_size=3)
)
def test_elimination_solves(entries, right):
    matrix = np.reshape(entries, (3, 3)) + np.diag([0.0, 40.0, 40.0]) + np.roll(np.diag([25.0, 0.0, 0.0]), 1, axis=0)
    if abs(np.linalg.det(matrix)) < 1.0:
        return
    left, answer = matrix.ravel().tolist(), list(right)
    assert riccati.solve(left, answer, 3, 1)
    assert np.allclose(matrix @ answer, right, atol=1e-8)


def test_elimination_refuses_a_singular_matrix():
    assert not riccati.solve([1.0, 2.0, 2.0, 4.0], [1.0, 1.0], 2, 1)
